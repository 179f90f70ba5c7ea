"""Workloads that measure time and memory."""
