"""Readers of telemetry in files beside a video."""
