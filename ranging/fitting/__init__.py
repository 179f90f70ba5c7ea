"""Fitting of size models to labelled boxes with known distances."""
