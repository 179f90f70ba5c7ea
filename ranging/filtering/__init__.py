"""Filters over time: distance, closing speed, time to collision, passing offset."""
