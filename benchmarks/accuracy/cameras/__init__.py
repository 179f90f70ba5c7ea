"""Cameras: calibration, focal length, horizon, mounting and motion."""
