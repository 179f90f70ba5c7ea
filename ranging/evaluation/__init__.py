"""Errors of distances against ground truth."""
