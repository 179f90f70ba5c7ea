"""Cameras, rigs, rectification and frames."""
