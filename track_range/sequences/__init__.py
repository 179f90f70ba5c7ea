"""Labelled sequences: finding and tracking them."""
