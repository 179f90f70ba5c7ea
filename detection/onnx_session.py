"""OnnxSession: one ONNX network loaded by onnxruntime, with its device, threads and errors in plain words.

Thread spinning is off: on a shared machine two spinning threads are slower than one that sleeps.
"""

from __future__ import annotations

import hashlib
from collections.abc import Mapping
from pathlib import Path
from typing import Any, Literal

import numpy as np
import numpy.typing as npt
import onnxruntime as ort

Device = Literal["auto", "cpu", "cuda", "tensorrt"]
FloatArray32 = npt.NDArray[np.float32]

_PROVIDERS: Mapping[str, tuple[str, ...]] = {
    "cpu": (),
    "cuda": ("CUDAExecutionProvider",),
    "tensorrt": ("TensorrtExecutionProvider", "CUDAExecutionProvider"),
}


class ModelError(Exception):
    """A model that cannot be used; the message says why and what to do."""


class OnnxSession:
    """A network with one image input, ready to run.

    Attributes:
        path: the model's file.
        input_shape: the image input's shape; a dimension that the model leaves open is None.
        metadata: what the exporter wrote into the file; often nothing.
        device: "cpu", "cuda" or "tensorrt", what it runs on in the end.
        notes: sentences for the user, such as a device that was not to be had.
    """

    def __init__(self, path: Path, *, device: Device = "auto", n_threads: int = 0) -> None:
        """Load the model; `n_threads` 0 = one per core.

        Raises:
            ModelError: there is no such file, or it is no ONNX network with an image input.
        """
        self.path = path
        self.notes: tuple[str, ...] = ()
        self._session = self._load(device, n_threads)
        self.device = _device_of(self._session.get_providers())
        if device in ("cuda", "tensorrt") and self.device != device:
            self.notes = (
                f"--device {device} is not to be had here (not built in, or its libraries are missing): "
                f"running on {self.device}.",
            )
        inputs = self._session.get_inputs()
        if len(inputs) != 1 or len(inputs[0].shape) != 4:
            shapes = ", ".join(f"{i.name} {i.shape}" for i in inputs)
            raise ModelError(f"{path}: one input [batch, 3, height, width] wanted, found: {shapes}.")
        self._input = inputs[0]
        self.input_shape = tuple(d if isinstance(d, int) else None for d in self._input.shape)
        self.metadata: Mapping[str, str] = dict(self._session.get_modelmeta().custom_metadata_map)

    def _load(self, device: Device, n_threads: int) -> Any:
        if not self.path.is_file():
            raise ModelError(f"{self.path}: no such model file.")
        options = ort.SessionOptions()
        options.intra_op_num_threads = n_threads
        options.inter_op_num_threads = 1
        options.log_severity_level = 4  # a failure is told once, by us
        options.add_session_config_entry("session.intra_op.allow_spinning", "0")
        try:
            return ort.InferenceSession(str(self.path), options, providers=_providers(device))
        except Exception as error:  # onnxruntime raises a dozen unrelated types for a broken file
            reason = str(error).splitlines()[0]
            raise ModelError(f"{self.path}: not a usable ONNX model ({reason}).") from error

    @property
    def input_dtype(self) -> type[np.floating[Any]]:
        """The image input's number type."""
        return np.float16 if self._input.type == "tensor(float16)" else np.float32

    def run(self, blob: FloatArray32) -> list[FloatArray32]:
        """The outputs, as float32, in the file's order, for one input blob (batch, 3, height, width).

        Raises:
            ModelError: the network fails on this input.
        """
        try:
            outputs = self._session.run(None, {self._input.name: blob.astype(self.input_dtype, copy=False)})
        except Exception as error:  # as above
            raise self._failure(error) from error
        return [np.asarray(output, np.float32) for output in outputs]

    def bound(self, input_hw: tuple[int, int]) -> BoundNetwork:
        """The network with buffers for one image of this size; one trial run tells the outputs' true shapes.

        Raises:
            ModelError: the network does not take this size.
        """
        return BoundNetwork(self, input_hw)

    def _failure(self, error: Exception) -> ModelError:
        return ModelError(f"{self.path}: the network failed ({str(error).splitlines()[0]}).")

    def sha256(self) -> str:
        """The model file's checksum, so that a run can be repeated with the very same weights."""
        with self.path.open("rb") as file:
            return hashlib.file_digest(file, "sha256").hexdigest()


class BoundNetwork:
    """A network bound to buffers of its own (onnxruntime's io binding): a run copies and allocates nothing.

    Attributes:
        blob: (1, 3, height, width) the input, float32 or float16 as the network wants; fill it, then `run`.
        output_shapes: names and shapes of the outputs, in the file's order.
    """

    def __init__(self, session: OnnxSession, input_hw: tuple[int, int]) -> None:
        self._owner = session
        self.blob = np.zeros((1, 3, *input_hw), session.input_dtype)
        network, name = session._session, session._input.name
        try:
            outputs = network.run(None, {name: self.blob})
        except Exception as error:  # onnxruntime raises a dozen unrelated types
            raise session._failure(error) from error
        self._buffers = [np.empty_like(np.asarray(output), order="C") for output in outputs]
        names = [output.name for output in network.get_outputs()]
        self.output_shapes = {key: buffer.shape for key, buffer in zip(names, self._buffers, strict=True)}
        self._binding = network.io_binding()
        self._binding.bind_cpu_input(name, self.blob)
        for key, buffer in zip(names, self._buffers, strict=True):
            self._binding.bind_output(key, "cpu", 0, buffer.dtype, buffer.shape, buffer.ctypes.data)

    def run(self) -> list[FloatArray32]:
        """The outputs for what `blob` holds, as float32, in the file's order; overwritten by the next run.

        Raises:
            ModelError: the network fails on this input.
        """
        try:
            self._owner._session.run_with_iobinding(self._binding)
        except Exception as error:  # as above
            raise self._owner._failure(error) from error
        return [buffer.astype(np.float32, copy=False) for buffer in self._buffers]


def _providers(device: Device) -> list[str]:
    wanted = _PROVIDERS["cuda" if device == "auto" else device]
    there = ort.get_available_providers()
    return [*(name for name in wanted if name in there), "CPUExecutionProvider"]


def _device_of(providers: list[str]) -> str:
    first = providers[0]
    return {"TensorrtExecutionProvider": "tensorrt", "CUDAExecutionProvider": "cuda"}.get(first, "cpu")
