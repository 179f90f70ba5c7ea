"""YOLO detectors: output layouts, decoders, letterbox and input format."""
