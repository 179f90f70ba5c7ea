"""Simulation of road drives recorded by a stereo pair, with exact ground truth."""
