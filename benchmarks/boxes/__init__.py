"""Drives without images: boxes and distances with the errors of the packaged detector and of the
stereo matcher.
"""
