"""Cameras of a recording: calibration files, focal lengths of known cameras, pairs without
calibration.
"""
