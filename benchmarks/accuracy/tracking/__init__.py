"""Workloads that compare trackers and their parts, and trackers of other packages."""
