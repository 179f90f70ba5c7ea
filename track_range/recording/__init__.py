"""Input: files, folders, bags, streams, telemetry and calibration files, read as frames."""
