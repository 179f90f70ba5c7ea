"""Doubt about what the user gave, by everything in a drive that has a scale."""
