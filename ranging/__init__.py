"""Identities and geometry in, metres out."""
