"""Evaluation of distances and closing speeds against ground truth."""
