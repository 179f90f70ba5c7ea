"""Doubt about what the program was told, by everything in a drive that has a scale."""
