"""Doubt about values that the user gave, from everything in a drive that has a scale."""
