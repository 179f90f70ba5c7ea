"""Other projects' trackers, run on the same detections."""
