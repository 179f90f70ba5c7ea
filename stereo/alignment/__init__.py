"""Alignment: systematic disparity and row errors of a rig, estimated and corrected."""
