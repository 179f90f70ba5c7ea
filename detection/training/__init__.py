"""Training of detectors with PyTorch (extra `train`); the result is an .onnx file that can be used
as a detector.
"""
