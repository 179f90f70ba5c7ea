"""Models: the catalogue, downloads, metadata, the ONNX session and quantization.

Every module that imports onnxruntime is in this package, which disables its telemetry first: onnxruntime would write a
device id and a database of events into the user's cache and look up a host to upload them to.
"""

import os

os.environ.setdefault("ORT_DISABLE_TELEMETRY", "1")
