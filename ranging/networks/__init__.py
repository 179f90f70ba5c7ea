"""Depth networks of one camera and stereo networks, in ONNX files of the user: images ->
DenseMap.
"""
