"""Workloads that measure accuracy."""
