"""Lens models: the relation of viewing directions to points of the normalised image plane."""
