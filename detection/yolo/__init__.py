"""The YOLO detector: output layouts and their decoders, letterbox and input format."""
