"""Inputs of a fleet: clips from folders, patterns and manifests."""
