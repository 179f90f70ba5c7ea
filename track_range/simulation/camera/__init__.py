"""Recording of a simulated drive: camera faults, simulated detections, image and label files."""
