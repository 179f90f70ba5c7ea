"""Workloads that measure collision warnings, with and without images."""
