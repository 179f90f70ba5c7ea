"""Modules that all packages may import: array aliases, files, options, errors, statistics and
per-track state.
"""
