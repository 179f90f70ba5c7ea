"""Fitting of size models to labelled boxes."""
