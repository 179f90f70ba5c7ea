"""Training of detectors (extra `train`: PyTorch): what comes out is an .onnx file that any detector option takes."""
