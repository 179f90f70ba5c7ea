"""Pixels in, image-space findings out, never metres."""
