"""Benchmarks: named workloads that print tables and optionally write JSON; README.md has protocols
and results.
"""
