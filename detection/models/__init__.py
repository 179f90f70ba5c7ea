"""Models: the catalogue, downloads, metadata, the ONNX session and quantization."""
