"""Readers of label and box files."""
