"""The live page and window."""
