"""Labelled sequences and images: finding them, tracking, and the evaluation of tracks and
detectors.
"""
