"""Counts and speeds at lines and in zones of a camera that stands still."""
