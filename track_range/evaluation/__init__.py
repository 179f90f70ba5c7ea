"""Evaluation of runs, tracks, events, stereo and detectors against labelled data."""
