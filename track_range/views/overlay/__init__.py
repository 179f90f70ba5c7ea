"""Overlay and disparity videos: drawing of results on frames."""
