"""TelemetryTrack, which all readers of telemetry return, and its construction from samples."""
