"""What the cameras of a drive record: faults, the playback detector, image and label files."""
