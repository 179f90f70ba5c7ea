"""Readers of telemetry inside video files; `embedded` in `embedded.py` tries them."""
