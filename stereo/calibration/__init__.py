"""Calibration of one camera or a stereo rig from images of boards."""
