"""Calibration from board images, alignment of a rig, and evaluation of stereo matchers."""
