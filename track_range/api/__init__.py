"""Python API: detector, tracker and calibration files for separate use, and evaluations."""
