"""Disparity of boxes and of whole images."""
