"""Cameras and stereo: calibration, rectification, disparity, alignment."""
