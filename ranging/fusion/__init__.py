"""Fusion of the distances of several methods into one."""
