"""Readers and writers of rig files."""
