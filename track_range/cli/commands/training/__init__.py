"""`track-range train`, `track-range anchors` and `track-range pseudo-label`."""
