"""Benchmarks: named workloads, each a printed table and, on demand, JSON. Figures and protocol: README.md beside."""
