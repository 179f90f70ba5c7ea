"""Scores of tracks against ground truth, by the benchmarks' rules."""
