"""Ranging methods, one file each."""
