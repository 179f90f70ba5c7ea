"""Benchmarks: named workloads that print tables and optionally write JSON; README.md says how to run
them.
"""
