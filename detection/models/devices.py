"""Devices that networks run on: onnxruntime's execution providers, and the packages that each
requires.
"""

from collections.abc import Mapping
from typing import Literal, NamedTuple

Device = Literal["auto", "cpu", "cuda", "tensorrt", "openvino", "coreml", "directml"]


class Accelerator(NamedTuple):
    """An accelerator (a device other than the CPU), and what running networks on it requires."""

    provider: str  # onnxruntime's name of the execution provider
    needs: str  # what to install
    # module that registers the provider with any onnxruntime; "" = the provider is built in
    plugin: str = ""


_NVIDIA = "onnxruntime-gpu[cuda,cudnn] in place of onnxruntime"
ACCELERATORS: Mapping[str, Accelerator] = {
    "cuda": Accelerator("CUDAExecutionProvider", _NVIDIA),
    "tensorrt": Accelerator("TensorrtExecutionProvider", f"{_NVIDIA}, and NVIDIA's TensorRT"),
    "openvino": Accelerator(
        "OpenVINOExecutionProvider", "onnxruntime-ep-openvino", "onnxruntime_ep_openvino"
    ),
    "coreml": Accelerator("CoreMLExecutionProvider", "onnxruntime on macOS"),
    "directml": Accelerator(
        "DmlExecutionProvider", "onnxruntime-directml in place of onnxruntime, on Windows"
    ),
}
