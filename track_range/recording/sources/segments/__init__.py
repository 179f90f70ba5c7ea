"""Recordings in several files, as dashcams write them."""
