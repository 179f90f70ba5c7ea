"""Boxes of each frame in, identities out."""
