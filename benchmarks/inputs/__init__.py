"""Drives and sequences that benchmarks run on."""
