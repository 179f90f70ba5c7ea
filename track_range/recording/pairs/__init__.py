"""Pairs of videos: pairing by time, alignment and checks."""
