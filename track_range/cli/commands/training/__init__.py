"""`track-range train` and `track-range anchors`."""
