"""What comes in: files, folders, bags, streams, telemetry and calibration files, as frames."""
