"""Trackers of other packages, run on the same detections."""
