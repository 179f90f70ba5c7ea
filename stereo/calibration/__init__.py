"""Calibration of one camera and of a pair from pictures of boards."""
