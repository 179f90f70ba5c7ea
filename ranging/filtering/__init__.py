"""Filters over time: distance, closing speed, time to collision, lateral offset when passing."""
