"""Disparity of boxes and of entire images."""
