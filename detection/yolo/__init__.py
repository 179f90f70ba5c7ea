"""YOLO detectors: metadata, output layouts, decoders, letterbox and input format."""
