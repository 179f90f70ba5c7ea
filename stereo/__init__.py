"""Cameras, and what two of them see."""
