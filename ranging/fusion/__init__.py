"""Fusion of several methods into one distance."""
