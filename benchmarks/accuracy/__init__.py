"""Workloads that measure accuracy, by what they measure."""
