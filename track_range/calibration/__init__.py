"""Images and reference pairs for calibration and alignment."""
