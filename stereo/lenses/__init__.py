"""Lens models, one file each."""
