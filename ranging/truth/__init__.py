"""Labelled boxes and their true distances, and the errors of distances against them."""
