"""OnnxNetwork: one ONNX network loaded by onnxruntime on a device, with errors as one sentence;
OnnxSession: one with an image as its input.
"""

from __future__ import annotations

import hashlib
import math
import mmap
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt

from track_range.detection.models.devices import Device
from track_range.detection.models.file_kinds import other_kind
from track_range.detection.models.providers import first_line, open_session
from track_range.foundation.arrays import FloatArray32
from track_range.foundation.errors import Note, UserError
from track_range.foundation.files.input_files import check_regular, quoted, real_path, shortened

_MAX_MODEL_BYTES = 2**31  # protobuf's limit
_MAX_SIDE = 8192  # of the input in any dimension
_MAX_VALUES = 2**28  # of the input: 1 GB of float32

_INPUT_TYPES = ("tensor(float)", "tensor(float16)", "tensor(uint8)")
# input [batch, 2] of RT-DETR, D-FINE, DEIM: size to which boxes are scaled
TARGET_SIZES = "orig_target_sizes"
_SIZE_TYPES = {"tensor(int64)": np.int64, "tensor(int32)": np.int32, "tensor(float)": np.float32}
_LOCATION_KEY = b"location"  # of the path of external data in ONNX files
_FAILED = "running the network failed"


class ModelError(UserError):
    """Unusable model; the message gives the reason and what to do."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Runtime:
    """Device and threads that a network runs on."""

    device: Device = "auto"  # "auto" = CUDA if available, else the CPU
    n_threads: int = 0  # number of CPU threads; 0 = one per core


class OnnxNetwork:
    """A network with any inputs, ready to run; ModelError if the file is no network.

    `input_infos` and `output_infos` are onnxruntime's, with `name`, `shape` (texts or None where
    the size varies) and `type` such as "tensor(float)"; `device` is the device in use.
    """

    def __init__(self, path: Path, runtime: Runtime | None = None) -> None:
        self.path = path
        self.notes: tuple[str, ...] = ()
        self._runtime = runtime = runtime or Runtime()
        check_model_file(path)
        with _library_errors(path, "not a usable ONNX model"):
            self._session, self.device, reason = open_session(
                path, runtime.device, runtime.n_threads
            )
        self._n_threads, self._has_run = runtime.n_threads, False
        if reason and runtime.device != "auto":
            self.notes = (
                Note(
                    f"--device {runtime.device} is not available ({reason}); using {self.device}.",
                    "device-not-available",
                    "warning",
                    "detector",
                ),
            )
        self.input_infos: Sequence[Any] = self._session.get_inputs()
        self.output_infos: Sequence[Any] = self._session.get_outputs()
        self.metadata: Mapping[str, str] = dict(self._session.get_modelmeta().custom_metadata_map)

    def __reduce__(self) -> tuple[Any, ...]:
        return type(self), (self.path, self._runtime)

    def run_inputs(self, inputs: dict[str, npt.NDArray[Any]]) -> list[npt.NDArray[Any]]:
        """The outputs for all inputs by name; a device that fails in the first run is replaced by
        the CPU.
        """
        with _library_errors(self.path, _FAILED):
            try:
                outputs: list[npt.NDArray[Any]] = self._session.run(None, inputs)
            except Exception as error:  # onnxruntime has dozens of unrelated types
                if self._has_run or self.device == "cpu":
                    raise
                self.notes = (
                    f"--device {self.device} failed in its first run "
                    f"({first_line(error, self.path)}); using the CPU.",
                )
                self._session, self.device, _ = open_session(self.path, "cpu", self._n_threads)
                outputs = self._session.run(None, inputs)
        self._has_run = True
        return outputs

    def sha256(self) -> str:
        """SHA-256 of the model file in hexadecimal, so that a run can be repeated with the same
        weights.
        """
        with self.path.open("rb") as file:
            return hashlib.file_digest(file, "sha256").hexdigest()


class OnnxSession(OnnxNetwork):
    """A network with one image input, ready to run; ModelError if the file is no such network.

    Its images are (batch, 3, height, width) for all networks: they are transposed for an input
    whose channels are last, reduced to the first channel for an input of a single channel, rounded
    for an input of uint8, and a single image for an input without a batch.

    DETR-like networks may have the input `orig_target_sizes` as well; it is the size of the image
    input, so that boxes are in pixels of that input. `input_shape` has None for dimensions of
    variable size.
    """

    def __init__(self, path: Path, runtime: Runtime | None = None) -> None:
        super().__init__(path, runtime)
        self._input, self._size_input = _checked_inputs(path, self.input_infos)
        shape = tuple(d if isinstance(d, int) else None for d in self._input.shape)
        self._has_batch = len(shape) == 4
        shape = shape if self._has_batch else (1, *shape)  # torchvision's input is one image
        self.has_channels_last = shape[1] not in (1, 3) and shape[3] in (1, 3)
        self.input_shape = (shape[0], shape[3], *shape[1:3]) if self.has_channels_last else shape
        self.n_channels = 1 if self.input_shape[1] == 1 else 3
        self.has_integer_input = self._input.type == "tensor(uint8)"
        self.input_dtype = np.float16 if self._input.type == "tensor(float16)" else np.float32
        self.has_target_sizes = self._size_input is not None

    def inputs(self, blob: npt.NDArray[Any]) -> dict[str, npt.NDArray[Any]]:
        """All inputs by name, for an input blob (batch, 3, height, width) of the network's type."""
        inputs: dict[str, npt.NDArray[Any]] = {self._input.name: self.as_input(blob)}
        if self._size_input is not None:
            n, _, height, width = blob.shape
            inputs[self._size_input.name] = np.array(
                [[width, height]] * n, _SIZE_TYPES[self._size_input.type]
            )
        return inputs

    def as_input(self, blob: npt.NDArray[Any]) -> npt.NDArray[Any]:
        """The network's input for a blob (batch, 3, height, width): `blob` itself if it has this
        form.
        """
        if self.n_channels == 1:
            blob = blob[:, :1]
        if self.has_channels_last:
            blob = blob.transpose(0, 2, 3, 1)
        if self.has_integer_input:
            blob = np.clip(np.rint(blob), 0, 255).astype(np.uint8)
        return np.ascontiguousarray(blob if self._has_batch else blob[0])

    def run(self, blob: FloatArray32) -> list[FloatArray32]:
        """The outputs as float32, in the file's order, for one input blob (batch, 3, height,
        width).
        """
        outputs = self.run_inputs(self.inputs(blob.astype(self.input_dtype, copy=False)))
        return [np.asarray(output, np.float32) for output in outputs]

    def bound(self, input_hw: tuple[int, int]) -> BoundNetwork:
        """The network with buffers for one image of this size; one trial run determines the
        outputs' shapes.
        """
        return BoundNetwork(self, input_hw)


def check_model_file(path: Path) -> tuple[Path, ...]:
    """The files of external data of an ONNX file, checked: it has at most 2 GB, and they are in its
    folder; else ModelError.
    """
    check_regular(path, ModelError, "an ONNX model", max_bytes=_MAX_MODEL_BYTES)
    if path.stat().st_size == 0:
        raise ModelError(f"{path}: expected an ONNX model, got an empty file.")
    if kind := other_kind(path):
        raise ModelError(f"{path}: expected an ONNX network, found {kind}.")
    with path.open("rb") as file, mmap.mmap(file.fileno(), 0, access=mmap.ACCESS_READ) as content:
        if content.find(_LOCATION_KEY) < 0:
            return ()
    import onnx

    # not part of onnxruntime
    from onnx.external_data_helper import _get_all_tensors, uses_external_data

    with _library_errors(path, "not a readable ONNX model"):
        model = onnx.load(str(path), load_external_data=False)
        external = [tensor for tensor in _get_all_tensors(model) if uses_external_data(tensor)]
        locations = {
            entry.value
            for tensor in external
            for entry in tensor.external_data
            if entry.key == "location"
        }
    folder = real_path(path).parent
    for location in sorted(locations):
        if folder not in real_path(folder / location).parents:
            raise ModelError(
                f"{path}: expected its weights in the same folder, found a reference to "
                f"{quoted(location)}."
            )
        check_regular(folder / location, ModelError, f"weights of {path.name}")
    return tuple(folder / location for location in sorted(locations))


def _checked_inputs(path: Path, inputs: Sequence[Any]) -> tuple[Any, Any | None]:
    images = [i for i in inputs if len(i.shape) in (3, 4)]
    sizes = [
        i for i in inputs if i.name == TARGET_SIZES and len(i.shape) == 2 and i.type in _SIZE_TYPES
    ]
    if len(images) != 1 or len(inputs) != 1 + len(sizes):
        shapes = shortened(", ".join(f"{i.name} {i.shape}" for i in inputs), 100)
        advice = (
            "export without other inputs and postprocessing"
            if len(inputs) > 1
            else "choose another model"
        )
        raise ModelError(
            f"{path}: expected one input [batch, 3, height, width], and at most {TARGET_SIZES} "
            f"[batch, 2] of int64, got {shapes}; {advice}."
        )
    (image,) = images
    lengths = [length for length in image.shape if isinstance(length, int)]
    if (
        min(lengths, default=1) < 1
        or max(lengths, default=1) > _MAX_SIDE
        or math.prod(lengths) > _MAX_VALUES
    ):
        raise ModelError(
            f"{path}: expected an input [batch, 3, height, width] of 1 to {_MAX_SIDE} pixels a "
            f"side and at most {_MAX_VALUES:,} values, got {shortened(str(image.shape))}."
        )
    if image.type not in _INPUT_TYPES:
        raise ModelError(
            f"{path}: expected an input of the type {' or '.join(_INPUT_TYPES)}, got {image.type}."
        )
    return image, sizes[0] if sizes else None


@contextmanager
def _library_errors(path: Path, problem: str) -> Iterator[None]:
    """Context of a library that may raise dozens of unrelated types for a broken file; all become
    ModelError.
    """
    try:
        yield
    except Exception as error:
        line = first_line(error, path)
        advice = (
            "; export the network without TensorRT's non-maximum suppression"
            if "_TRT" in line
            else ""
        )
        raise ModelError(f"{path}: {problem} ({line}){advice}.") from error


class BoundNetwork:
    """A network with bound buffers (onnxruntime's IOBinding), so that a run neither copies nor
    allocates arrays.

    On a GPU, binding an input copies it there, so that each run binds it.
    """

    def __init__(self, session: OnnxSession, input_hw: tuple[int, int]) -> None:
        self._owner = session
        self.blob = np.zeros((1, 3, *input_hw), session.input_dtype)  # input of the next run
        batch = session.input_shape[0]
        if batch not in (None, 1):
            raise ModelError(
                f"{session.path}: expected batch size 1 or a variable size, got {batch}; export "
                "with batch size 1."
            )
        inputs = session.inputs(self.blob)
        outputs = session.run_inputs(inputs)
        network = session._session  # after the first run, which may have replaced it
        self._buffers = [np.empty_like(np.asarray(output), order="C") for output in outputs]
        names = [output.name for output in network.get_outputs()]
        named = dict(zip(names, self._buffers, strict=True))
        # in the file's order
        self.output_shapes = {key: buffer.shape for key, buffer in named.items()}
        self.integer_outputs = frozenset(
            key for key, buffer in named.items() if buffer.dtype.kind in "iu"
        )
        self._binding = network.io_binding()
        self._image_name = session._input.name
        for key, array in inputs.items():
            self._binding.bind_cpu_input(key, array)
        self._bound_inputs = inputs  # the binding refers to their memory
        self._is_bound = all(
            buffer.size for buffer in self._buffers
        )  # other sizes of outputs are not known before a run
        for key, buffer in zip(names, self._buffers, strict=True) if self._is_bound else ():
            self._binding.bind_output(key, "cpu", 0, buffer.dtype, buffer.shape, buffer.ctypes.data)

    def run(self, blob: npt.NDArray[Any] | None = None) -> list[FloatArray32]:
        """The outputs as float32, in the file's order, for `blob` or the attribute; the next run
        overwrites them.
        """
        source = self._owner.as_input(self.blob if blob is None else blob)
        if self._owner.device != "cpu" or self._bound_inputs[self._image_name] is not source:
            self._binding.bind_cpu_input(self._image_name, source)
            self._bound_inputs[self._image_name] = source
        with _library_errors(self._owner.path, _FAILED):
            if self._is_bound:
                try:
                    self._owner._session.run_with_iobinding(self._binding)
                # a suppression returns another number of boxes for each image
                except RuntimeError as error:
                    if "shape" not in str(error):
                        raise
                    self._is_bound = False
            if not self._is_bound:
                outputs = self._owner._session.run(None, self._bound_inputs)
                return [np.asarray(output, np.float32) for output in outputs]
        return [buffer.astype(np.float32, copy=False) for buffer in self._buffers]
