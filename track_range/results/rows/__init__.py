"""Rows of a run, one per track and frame: the declaration of their columns."""
