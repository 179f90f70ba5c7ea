"""Drives and sequences for benchmarks."""
