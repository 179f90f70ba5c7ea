"""Quantization of ONNX detectors: static INT8 (QDQ) and FP16 copies.

    q = clip(round(x / scale) + zero_point, 0, 255)        x ~ (q - zero_point) * scale

Weights are signed bytes with one scale per output channel, activations unsigned bytes with one scale per tensor (signed
bytes took 1.6 to 2.7 times as long). The range of an activation extends from the mean of the images' minima to the mean
of their maxima. Clipping the extremes reduces the disagreement with the float network by 30 to 60 %, compared with the
range of all values. (A percentile was equally accurate on YOLOX-nano, but took eight times as long.)

These parts stay in float, which determines the accuracy:

- the last convolutions and everything after them, where one tensor contains both pixels (0..640) and scores (0..1);
- convolutions with an input or output whose channels differ so much in range that the rounding of a common scale
  exceeds the values of the smaller channels (YOLOX-nano's stem and the depthwise convolution after it: quantising these
  two halves its average precision);
- everything before the first quantised convolution.

Rounded weights and clipped activations shift the mean of a convolution's output. Each bias is corrected by that shift,
layer by layer in the network's order, measured on some of the images, as in Nagel et al., Data-Free Quantization
Through Weight Equalization and Bias Correction, ICCV 2019, section 4.2.

INT8 requires a CPU with VNNI (or ARM's dot product): older CPUs add pairs of products in 16 bits, which saturates and
is hardly faster. FP16 is for GPUs; a CPU converts to float32 and back.
"""

import copy
import itertools
from collections.abc import Callable, Iterable, Iterator, Sequence
from contextlib import suppress
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt
import onnx
import onnx.numpy_helper
import onnx.version_converter
from onnxruntime.quantization import (
    CalibrationDataReader,
    CalibrationMethod,
    QuantFormat,
    QuantType,
    quantize_static,
)
from onnxruntime.quantization.onnx_model import ONNXModel
from onnxruntime.quantization.shape_inference import quant_pre_process
from onnxruntime.transformers.float16 import convert_float_to_float16

from track_range.detection.formats.image_labels.labelled_images import (
    ImageFileError,
    images_in,
    read_image,
)
from track_range.detection.models.onnx_session import ModelError, OnnxSession, Runtime
from track_range.detection.models.writing import atomic_output, silent_conversion
from track_range.foundation.arrays import FloatArray, FloatArray32, Image

_PER_CHANNEL_OPSET = 13  # the first in which DequantizeLinear supports one scale per channel
N_CALIBRATION = 60  # number of images for calibration of the value ranges of the layers
# images on which the rounding noise of every tensor is measured before the calibration
_N_NOISE_BLOBS = 4

MAX_NOISE_RATIO = 0.1
"""Largest `_noise_ratio` of the inputs and outputs of a quantised convolution. The ratio is at most
0.05 for all tensors of YOLOv5n, YOLOv4-tiny and YOLOX-nano, except two of YOLOX-nano (0.21 and
0.26) whose quantization halves its average precision."""

_N_BIAS_BLOBS = 32  # images on which the shift of a convolution's output is measured
# quantised between convolutions
_BETWEEN = frozenset("Add Concat LeakyRelu MaxPool Mul Resize Sigmoid Slice".split())
_QUANTISED = frozenset(
    "ConvInteger DequantizeLinear DynamicQuantizeLinear QLinearConv QuantizeLinear".split()
)


def quantize_int8(
    path: Path,
    out: Path,
    *,
    blobs: Iterable[FloatArray32],
    progress: Callable[[int, int], None] = lambda _done, _total: None,
    max_noise_ratio: float = MAX_NOISE_RATIO,
    corrects_biases: bool = True,
) -> None:
    """Write an INT8 copy of the network at `path`, with the same inputs, outputs and metadata.

    `blobs` are calibration inputs (1, 3, H, W), 30 to 100 images typical of the network's use in
    random order, which are read once, one by one; the first blobs also determine which layers stay
    in float, and the corrections of the biases, for which the network is run once per convolution
    (a minute for YOLOv5n at 640 x 640). `progress` is called with the number of convolutions whose
    bias is corrected, and their total number. `max_noise_ratio`: largest ratio of the noise of
    quantization to the variance of a tensor that is quantised; `corrects_biases`: whether mean
    outputs become those of the original.

    ModelError: not a usable float32 network with convolutions to quantise, no blobs, or blobs of
    the wrong shape.
    """
    model = _float_model(path)
    session = OnnxSession(path, Runtime(device="cpu"))
    stream = iter(blobs)
    first = list(itertools.islice(stream, _N_NOISE_BLOBS))
    if not first:
        raise ModelError(
            f"{path}: there are no calibration images; specify images typical of the network's use."
        )
    for blob in first:  # raises a ModelError for a wrong shape
        session.run(blob)
    with atomic_output(out) as folder:
        with silent_conversion(path, "quantised"):
            prepared = _prepared(model, folder)
        names = _quantisable(prepared, first, folder, max_noise_ratio)
        if not names:
            raise ModelError(
                f"{path}: no convolution can be quantised without losing accuracy; "
                "try FP16 instead."
            )
        reader = _BlobReader(session, itertools.chain(first, stream))
        with silent_conversion(path, "quantised"):
            result = _quantised(prepared, names, reader, folder)
        if corrects_biases:
            _correct_biases(prepared, result, reader.first, folder, progress)
        _save(result, model, folder / out.name)


def convert_fp16(path: Path, out: Path) -> None:
    """Write a copy of the network at `path` with weights and arithmetic in FP16, which halves its
    size.

    Inputs, outputs and everything after the last convolutions stay float32, because FP16 has a
    resolution of only half a pixel above 512. ModelError: not a usable float32 network with
    convolutions.
    """
    model = _float_model(path)
    half = copy.deepcopy(model)
    _name_nodes(half.graph)
    convolutions = _convolutions(half.graph)
    inner = _before(half.graph, convolutions) | convolutions
    tail = [node.name for node in half.graph.node if node.name not in inner]
    with atomic_output(out) as folder:
        with silent_conversion(path, "converted to FP16"):
            half = convert_float_to_float16(half, keep_io_types=True, node_block_list=tail)
            _remove_redundant_casts(half)
        _save(half, model, folder / out.name)


def calibration_images(folder: Path, measured: frozenset[Path]) -> tuple[list[Path], list[Path]]:
    """Images for calibration, and other images; labelled images are used for calibration only if
    all are labelled.
    """
    paths = images_in(folder)
    pool = [path for path in paths if path not in measured] or paths
    n = min(N_CALIBRATION, len(paths) // 2)
    if n == 0:
        raise ModelError(
            f"{folder}: expected at least 2 images for calibration and comparison "
            f"({2 * N_CALIBRATION} recommended), found {len(paths)}."
        )
    drawn = [pool[i] for i in np.random.default_rng(0).permutation(len(pool))]
    return drawn[:n], drawn[n:] or [path for path in paths if path not in drawn[:n]]


def input_blobs(
    input_blob: Callable[[Image], FloatArray32], paths: Sequence[Path]
) -> Iterator[FloatArray32]:
    """Inputs of a network for the images, with a detector's function that prepares an image;
    damaged images are skipped.
    """
    for path in paths:
        with suppress(ImageFileError):
            yield input_blob(read_image(path))


def _float_model(path: Path) -> onnx.ModelProto:
    """The network at `path`, after a check that onnxruntime can load it and that it computes in
    float32.
    """
    # raises a ModelError if the file is not a usable network
    OnnxSession(path, Runtime(device="cpu"))
    model = onnx.load(path)
    types = {tensor.data_type for tensor in model.graph.initializer}
    types |= {value.type.tensor_type.elem_type for value in model.graph.input}
    operators = {node.op_type for node in model.graph.node}
    if operators & _QUANTISED:
        raise ModelError(f"{path}: expected a float32 network, got a quantised network.")
    if types & {onnx.TensorProto.FLOAT16, onnx.TensorProto.BFLOAT16}:
        raise ModelError(f"{path}: expected a float32 network, got a network with 16-bit floats.")
    if "Conv" not in operators:
        raise ModelError(
            f"{path}: expected a network with convolutions, found none; there is "
            "nothing to quantise."
        )
    return model


def _name_nodes(graph: onnx.GraphProto) -> None:
    """Give every node a unique name: the converters identify nodes by name, but exporters may omit
    it.
    """
    for index, node in enumerate(graph.node):
        node.name = f"{node.op_type}_{index}"


def _convolutions(graph: onnx.GraphProto) -> set[str]:
    """Names of the convolutions, except 1x1 with one output channel (the weighted mean in YOLOv8's
    decoder).
    """
    weights = {tensor.name: tuple(tensor.dims) for tensor in graph.initializer}
    excluded = {name for name, dims in weights.items() if dims[:1] == (1,) and set(dims[2:]) == {1}}
    return {
        node.name for node in graph.node if node.op_type == "Conv" and node.input[1] not in excluded
    }


def _before(graph: onnx.GraphProto, names: set[str]) -> set[str]:
    """Names of the nodes from which a node in `names` can be reached; ONNX graphs are in
    topological order.
    """
    needed: set[str] = set()
    predecessors: set[str] = set()
    for node in reversed(graph.node):
        if needed.intersection(node.output):
            predecessors.add(node.name)
        if node.name in predecessors or node.name in names:
            needed.update(node.input)
    return predecessors


def _after(graph: onnx.GraphProto, names: set[str]) -> set[str]:
    """Names of the nodes that can be reached from a node in `names`, not through the shape of a
    tensor.
    """
    reached: set[str] = set()
    successors: set[str] = set()
    for node in graph.node:
        if reached.intersection(node.input) and node.op_type not in ("Shape", "Size"):
            successors.add(node.name)
        if node.name in successors or node.name in names:
            reached.update(node.output)
    return successors


def _prepared(model: onnx.ModelProto, folder: Path) -> onnx.ModelProto:
    """A copy with folded batch norms, inferred shapes, an opset with scales per channel, a bias per
    convolution.
    """
    if (
        max(entry.version for entry in model.opset_import if entry.domain in ("", "ai.onnx"))
        < _PER_CHANNEL_OPSET
    ):
        model = onnx.version_converter.convert_version(model, _PER_CHANNEL_OPSET)
    source, target = folder / "source.onnx", folder / "prepared.onnx"
    onnx.save(model, source)
    quant_pre_process(str(source), str(target), skip_symbolic_shape=True)
    prepared = onnx.load(target)
    graph = prepared.graph
    _name_nodes(graph)
    constants = {tensor.name: tensor for tensor in graph.initializer}
    used: set[str] = set()
    for node in graph.node:
        if node.op_type != "Conv" or node.input[1] not in constants:
            continue
        bias = node.input[2] if len(node.input) > 2 else ""
        if not bias:
            values = np.zeros(constants[node.input[1]].dims[0], np.float32)
        elif bias in used and bias in constants:
            values = onnx.numpy_helper.to_array(constants[bias])
        else:
            used.add(bias)
            continue
        graph.initializer.append(onnx.numpy_helper.from_array(values, f"{node.name}_bias"))
        node.input[2:] = [f"{node.name}_bias"]
    return prepared


def _quantisable(
    model: onnx.ModelProto, blobs: list[FloatArray32], folder: Path, max_noise_ratio: float
) -> list[str]:
    """Names of the convolutions to quantise and of the operators between them that can be
    quantised.

    None of them has a noisy tensor as input or output: a float convolution between quantised
    tensors would be quantised by onnxruntime when it loads the network, with one scale for all its
    weights.
    """
    nodes, convolutions = model.graph.node, _convolutions(model.graph)
    before_convolutions = _before(model.graph, convolutions)
    inner = [node for node in nodes if node.name in convolutions & before_convolutions]
    tensors = list(
        dict.fromkeys(name for node in inner for name in (node.input[0], node.output[0]))
    )
    if not tensors:
        return []
    session = _probe(model, tensors, folder)
    noise = np.mean(
        [[_noise_ratio(values) for values in session.run(blob)] for blob in blobs], axis=0
    )
    noisy = {name for name, ratio in zip(tensors, noise, strict=True) if ratio > max_noise_ratio}
    quiet = {node.name for node in nodes if not noisy.intersection([*node.input, *node.output])}
    chosen = {node.name for node in inner} & quiet
    between = before_convolutions & _after(model.graph, chosen) & quiet
    return [
        node.name
        for node in nodes
        if node.name in chosen or (node.op_type in _BETWEEN and node.name in between)
    ]


def _probe(model: onnx.ModelProto, tensors: Sequence[str], folder: Path) -> OnnxSession:
    probe = copy.deepcopy(model)
    del probe.graph.output[:]
    float32 = onnx.TensorProto.FLOAT
    probe.graph.output.extend(
        onnx.helper.make_tensor_value_info(name, float32, None) for name in tensors
    )
    onnx.save(probe, folder / "probe.onnx")
    return OnnxSession(folder / "probe.onnx", Runtime(device="cpu"))


def _noise_ratio(values: FloatArray32) -> float:
    """Ratio of rounding noise to signal of `values` (N, C, ...) at 8 bits, in [0, 1].

    mean over channels c of min(s^2 / 12 / var(c), 1), with the scale s = (max - min) / 255 of the
    whole tensor
    """
    scale = (max(float(values.max()), 0.0) - min(float(values.min()), 0.0)) / 255
    variance = values.var(axis=(0, *range(2, values.ndim)), dtype=np.float64)
    return float(np.minimum(scale**2 / 12 / np.maximum(variance, 1e-12), 1.0).mean())


class _BlobReader(CalibrationDataReader):  # type: ignore[misc]  # onnxruntime ships no types
    """Adapter from an iterator of blobs to onnxruntime's calibration; `first` has the first
    `_N_BIAS_BLOBS` blobs.
    """

    def __init__(self, session: OnnxSession, blobs: Iterator[FloatArray32]) -> None:
        self._session, self._blobs = session, blobs
        self.first: list[FloatArray32] = []

    def get_next(self) -> dict[str, npt.NDArray[Any]] | None:
        blob = next(self._blobs, None)
        if blob is None:
            return None
        if len(self.first) < _N_BIAS_BLOBS:
            self.first.append(blob)
        return self._session.inputs(blob)


def _quantised(
    model: onnx.ModelProto, names: list[str], reader: _BlobReader, folder: Path
) -> onnx.ModelProto:
    source, target = folder / "named.onnx", folder / "quantised.onnx"
    onnx.save(model, source)
    quantize_static(
        str(source),
        str(target),
        reader,
        quant_format=QuantFormat.QDQ,
        op_types_to_quantize=["Conv", *sorted(_BETWEEN)],
        nodes_to_quantize=names,
        per_channel=True,
        activation_type=QuantType.QUInt8,
        weight_type=QuantType.QInt8,
        calibrate_method=CalibrationMethod.MinMax,
        # all blobs are one batch, so this is their mean
        extra_options={"CalibMovingAverage": True},
    )
    return onnx.load(target)


def _correct_biases(
    original: onnx.ModelProto,
    quantised: onnx.ModelProto,
    blobs: Sequence[FloatArray32],
    folder: Path,
    progress: Callable[[int, int], None],
) -> None:
    """Add to each bias of `quantised` the difference of the convolution's mean output, per channel,
    from `original`.

    b' = b + E[y] - E[y_q]: in the network's order, so that y_q already has the corrections of the
    layers before it. Biases that are not constant stay as they are.
    """
    constants = {tensor.name: tensor for tensor in quantised.graph.initializer}
    producers = {node.output[0]: node for node in quantised.graph.node}
    names = _convolutions(original.graph)
    outputs = {node.name: node.output[0] for node in original.graph.node if node.name in names}
    expected = dict(
        zip(outputs, _mean_outputs(original, [*outputs.values()], blobs, folder), strict=True)
    )
    nodes = [node for node in quantised.graph.node if node.name in outputs and len(node.input) > 2]
    for index, node in enumerate(nodes):
        progress(index, len(nodes))
        bias, step = node.input[2], np.ones(1)
        source = producers.get(bias)
        # of integers, step and zero point
        if source is not None and source.op_type == "DequantizeLinear":
            bias, step = source.input[0], onnx.numpy_helper.to_array(constants[source.input[1]])
        if bias in constants:
            (mean,) = _mean_outputs(quantised, node.output, blobs, folder)
            values = onnx.numpy_helper.to_array(constants[bias])
            total = values + (expected[node.name] - mean) / step
            if values.dtype.kind == "i":
                limits = np.iinfo(values.dtype)
                total = np.clip(np.rint(total), limits.min, limits.max)
            constants[bias].CopyFrom(onnx.numpy_helper.from_array(total.astype(values.dtype), bias))


def _mean_outputs(
    model: onnx.ModelProto, tensors: Sequence[str], blobs: Sequence[FloatArray32], folder: Path
) -> list[FloatArray]:
    """Mean of each tensor (N, C, ...) over all but its channels: (C,) each."""
    session = _probe(model, tensors, folder)
    sums = [np.zeros(1)] * len(tensors)
    for blob in blobs:
        means = [
            values.mean(axis=(0, *range(2, values.ndim)), dtype=np.float64)
            for values in session.run(blob)
        ]
        sums = [old + new for old, new in zip(sums, means, strict=True)]
    return [total / len(blobs) for total in sums]


def _remove_redundant_casts(model: onnx.ModelProto) -> None:
    """Remove pairs of casts to FP16 and back, and duplicated casts.

    The converter inserts such pairs between nodes that stay in float32, and one cast per consumer
    of a tensor, all with the same name.
    """

    def is_cast(node: onnx.NodeProto, to: int) -> bool:
        return node.op_type == "Cast" and any(
            entry.name == "to" and entry.i == to for entry in node.attribute
        )

    nodes = {node.output[0]: node for node in model.graph.node}
    halved = {
        name: node.input[0]
        for name, node in nodes.items()
        if is_cast(node, onnx.TensorProto.FLOAT16)
    }
    for node in nodes.values():
        if is_cast(node, onnx.TensorProto.FLOAT) and node.input[0] in halved:
            node.op_type = "Identity"
            node.input[0] = halved[node.input[0]]
            del node.attribute[:]
    read = {name for node in nodes.values() for name in node.input} | {
        value.name for value in model.graph.output
    }
    kept = [copy.deepcopy(node) for node in nodes.values() if read.intersection(node.output)]
    del model.graph.node[:]
    model.graph.node.extend(kept)
    _name_nodes(model.graph)
    ONNXModel(model).topological_sort()


def _save(model: onnx.ModelProto, original: onnx.ModelProto, target: Path) -> None:
    del model.metadata_props[:]
    model.metadata_props.extend(original.metadata_props)
    onnx.save(model, target)
