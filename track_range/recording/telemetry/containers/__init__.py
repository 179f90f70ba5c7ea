"""Readers of telemetry inside video files; `embedded` in `telemetry/found.py` tries them."""
