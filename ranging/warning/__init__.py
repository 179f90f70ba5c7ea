"""Collision warning: probability of contact of each track, and the alarm with hysteresis."""
