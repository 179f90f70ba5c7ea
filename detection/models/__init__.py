"""Networks in ONNX files: the session on a device, and quantization.

Every module that imports onnxruntime is in this package, which disables its telemetry first.
"""

from track_range.foundation.library_telemetry import disable_telemetry

disable_telemetry()
