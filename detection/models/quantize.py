"""Smaller and faster networks: static INT8 (QDQ) and FP16 copies of an ONNX detector.

    q = clip(round(x / scale) + zero, 0, 255)        x ~ (q - zero) * scale

Weights have one scale per output channel (signed bytes), activations one per tensor (unsigned bytes: signed ones took
1.6 to 2.7 times as long). It spans from the mean of the images' smallest values to the mean of their largest: rare
extremes are clipped and the rest is finer, which took away 30 to 60 % of the disagreement with the float network that
the smallest and largest of all leave. (A percentile did as well on YOLOX-nano, in eight times the time.)

What stays in float decides the accuracy:

- the last convolutions and all that follows: one tensor there holds pixels (0..640) beside scores (0..1);
- convolutions beside a tensor whose channels differ so much in range that one scale drowns the quiet ones in rounding
  (YOLOX-nano's stem and the depthwise convolution after it: these two, quantised, halve its average precision);
- what comes before the first quantised convolution.

INT8 wants a CPU with VNNI (or ARM's dot product): older ones add pairs of products in 16 bits, which is less of a gain
and saturates. FP16 is for GPUs: a CPU computes in float32 between conversions.
"""

from __future__ import annotations

import itertools
from collections.abc import Iterable, Iterator
from pathlib import Path

import numpy as np
import onnx
import onnx.version_converter
from onnxruntime.quantization import CalibrationDataReader, CalibrationMethod, QuantFormat, QuantType, quantize_static
from onnxruntime.quantization.onnx_model import ONNXModel
from onnxruntime.quantization.shape_inference import quant_pre_process
from onnxruntime.transformers.float16 import convert_float_to_float16

from track_range.detection.models.onnx_session import ModelError, OnnxSession, Runtime
from track_range.detection.models.writing import silent_conversion, written_whole
from track_range.foundation.arrays import FloatArray32

_PER_CHANNEL_OPSET = 13
"""The first ONNX operator set whose DequantizeLinear knows one scale per channel."""

_N_NOISE_BLOBS = 4
"""Images on which the rounding noise of every tensor is measured before calibration."""

_MAX_NOISE_SHARE = 0.1
"""Rounding noise over a channel's variance, mean of the channels, above which a convolution stays in float. At most
0.05 in every tensor of YOLOv5n, YOLOv4-tiny and YOLOX-nano but the two that ruin the last: 0.21 and 0.26."""

_BETWEEN = frozenset("Add Concat LeakyRelu MaxPool Mul Resize Sigmoid Slice".split())
"""Operators that are quantised too where they lie between quantised convolutions, so that bytes flow through."""

_QUANTISED = frozenset("ConvInteger DequantizeLinear DynamicQuantizeLinear QLinearConv QuantizeLinear".split())


def quantize_int8(path: Path, out: Path, *, blobs: Iterable[FloatArray32]) -> None:
    """Write an INT8 copy of the network at `path`, calibrated on `blobs`: (1, 3, H, W) each, as the network wants them.

    Inputs, outputs and metadata stay as they are. The blobs are read once, one by one: 30 to 100 images such as the
    network will see, in mixed order, since the first few also tell which layers stay in float.

    Raises:
        ModelError: no usable float network with convolutions to quantise, or no blobs, or blobs that it does not take.
    """
    model = _float_model(path)
    stream = iter(blobs)
    first = list(itertools.islice(stream, _N_NOISE_BLOBS))
    _check_blobs(path, first)
    with written_whole(out) as folder:
        with silent_conversion(path, "quantised"):
            prepared = _prepared(model, folder)
        wide = _wide_tensors(prepared, first, folder)
        names = _quantisable(prepared.graph, wide)
        if not names:
            raise ModelError(f"{path}: no convolution but the last ones could be quantised; try FP16 instead.")
        reader = _BlobReader(_input_name(prepared.graph), itertools.chain(first, stream))
        with silent_conversion(path, "quantised"):
            result = _quantised(prepared, names, reader, folder)
        _save(result, model, folder / out.name)


def convert_fp16(path: Path, out: Path) -> None:
    """Write a copy of the network at `path` with weights and arithmetic in FP16, which halves its size.

    Inputs and outputs stay float32, as does all after the last convolutions: FP16 counts pixels above 512 by halves.

    Raises:
        ModelError: no usable float network with convolutions.
    """
    model = _float_model(path)
    half = _copy(model)
    _name_nodes(half.graph)
    inner = _before(half.graph, _layers(half.graph)) | _layers(half.graph)
    tail = [node.name for node in half.graph.node if node.name not in inner]
    with written_whole(out) as folder:
        with silent_conversion(path, "converted to FP16"):
            half = convert_float_to_float16(half, keep_io_types=True, node_block_list=tail)
            half = _without_roundings(half)
        _save(half, model, folder / out.name)


def _float_model(path: Path) -> onnx.ModelProto:
    """The network, if onnxruntime takes it and it computes in float32."""
    OnnxSession(path, Runtime(device="cpu"))  # tells in plain words what is wrong with a file
    model = onnx.load(path)
    types = {tensor.data_type for tensor in model.graph.initializer}
    types |= {value.type.tensor_type.elem_type for value in model.graph.input}
    operators = {node.op_type for node in model.graph.node}
    if operators & _QUANTISED:
        raise ModelError(f"{path}: already quantised; start from the float32 network.")
    if types & {onnx.TensorProto.FLOAT16, onnx.TensorProto.BFLOAT16}:
        raise ModelError(f"{path}: already in 16-bit floats; start from the float32 network.")
    if "Conv" not in operators:
        raise ModelError(f"{path}: no convolutions, so nothing would become smaller or faster.")
    return model


def _check_blobs(path: Path, blobs: list[FloatArray32]) -> None:
    if not blobs:
        raise ModelError(f"{path}: no images to calibrate on; give some such as the network will see.")
    session = OnnxSession(path, Runtime(device="cpu"))
    for blob in blobs:
        session.run(blob)


def _input_name(graph: onnx.GraphProto) -> str:
    """The image input's name; files of before 2019 list the weights among the inputs too."""
    weights = {tensor.name for tensor in graph.initializer}
    return str(next(value.name for value in graph.input if value.name not in weights))


def _name_nodes(graph: onnx.GraphProto) -> None:
    """Give every node a name of its own; exporters may leave them empty, but the converters go by them."""
    for index, node in enumerate(graph.node):
        node.name = f"{node.op_type}_{index}"


def _layers(graph: onnx.GraphProto) -> set[str]:
    """Names of the convolutions, less those of one 1x1 output channel such as the weighted mean in YOLOv8's decoder."""
    weights = {tensor.name: tuple(tensor.dims) for tensor in graph.initializer}
    lone = {name for name, dims in weights.items() if dims[:1] == (1,) and set(dims[2:]) == {1}}
    return {node.name for node in graph.node if node.op_type == "Conv" and node.input[1] not in lone}


def _inner_layers(graph: onnx.GraphProto) -> set[str]:
    """The convolutions that others follow."""
    return _layers(graph) & _before(graph, _layers(graph))


def _before(graph: onnx.GraphProto, marks: set[str]) -> set[str]:
    """Names of the nodes whose results reach a marked one; the graph is in order, as ONNX asks."""
    needed: set[str] = set()
    found: set[str] = set()
    for node in reversed(graph.node):
        if needed.intersection(node.output):
            found.add(node.name)
        if node.name in found or node.name in marks:
            needed.update(node.input)
    return found


def _after(graph: onnx.GraphProto, marks: set[str]) -> set[str]:
    """Names of the nodes that a marked one's result reaches, sizes computed from its shape left out."""
    reached: set[str] = set()
    found: set[str] = set()
    for node in graph.node:
        if reached.intersection(node.input) and node.op_type not in ("Shape", "Size"):
            found.add(node.name)
        if node.name in found or node.name in marks:
            reached.update(node.output)
    return found


def _prepared(model: onnx.ModelProto, folder: Path) -> onnx.ModelProto:
    """The network with batch norms folded, shapes inferred and an operator set that knows scales per channel."""
    if max(entry.version for entry in model.opset_import if entry.domain in ("", "ai.onnx")) < _PER_CHANNEL_OPSET:
        model = onnx.version_converter.convert_version(model, _PER_CHANNEL_OPSET)
    source, target = folder / "source.onnx", folder / "prepared.onnx"
    onnx.save(model, source)
    quant_pre_process(str(source), str(target), skip_symbolic_shape=True)
    prepared = onnx.load(target)
    _name_nodes(prepared.graph)
    return prepared


def _wide_tensors(model: onnx.ModelProto, blobs: list[FloatArray32], folder: Path) -> set[str]:
    """Names of the convolutions' inputs and outputs that one scale per tensor would drown in rounding noise."""
    layers = _inner_layers(model.graph)
    nodes = [node for node in model.graph.node if node.name in layers]
    tensors = list(dict.fromkeys(name for node in nodes for name in (node.input[0], node.output[0])))
    if not tensors:
        return set()
    probe = _copy(model)
    del probe.graph.output[:]
    float32 = onnx.TensorProto.FLOAT
    probe.graph.output.extend(onnx.helper.make_tensor_value_info(name, float32, None) for name in tensors)
    onnx.save(probe, folder / "probe.onnx")
    session = OnnxSession(folder / "probe.onnx", Runtime(device="cpu"))
    noise = np.mean([[_noise_share(values) for values in session.run(blob)] for blob in blobs], axis=0)
    return {name for name, share in zip(tensors, noise, strict=True) if share > _MAX_NOISE_SHARE}


def _noise_share(values: FloatArray32) -> float:
    """Rounding noise of one byte per value over each channel's variance, at most 1; the mean of the channels.

    `values` is (N, C, ...). The noise of a scale s is s^2 / 12, but never more than the variance of what it drowns.
    """
    scale = (max(float(values.max()), 0.0) - min(float(values.min()), 0.0)) / 255
    variance = values.var(axis=(0, *range(2, values.ndim)), dtype=np.float64)
    return float(np.minimum(scale**2 / 12 / np.maximum(variance, 1e-12), 1.0).mean())


def _quantisable(graph: onnx.GraphProto, wide: set[str]) -> list[str]:
    """Names of the convolutions to quantise, and of the operators between them that let bytes through.

    None of them touches a wide tensor: a float convolution between bytes would be quantised after all, by onnxruntime
    while it loads the network, and with one scale for all its weights.
    """
    free = {node.name for node in graph.node if not wide.intersection([*node.input, *node.output])}
    layers = _inner_layers(graph) & free
    between = _before(graph, _layers(graph)) & _after(graph, layers) & free
    return [
        node.name for node in graph.node if node.name in layers or (node.op_type in _BETWEEN and node.name in between)
    ]


class _BlobReader(CalibrationDataReader):  # type: ignore[misc]  # onnxruntime ships no types
    """Hands blobs to onnxruntime's calibration one by one."""

    def __init__(self, name: str, blobs: Iterator[FloatArray32]) -> None:
        self._name, self._blobs = name, blobs

    def get_next(self) -> dict[str, FloatArray32] | None:
        """The next input by name; None after the last."""
        blob = next(self._blobs, None)
        return None if blob is None else {self._name: blob}


def _quantised(model: onnx.ModelProto, names: list[str], reader: _BlobReader, folder: Path) -> onnx.ModelProto:
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
        extra_options={"CalibMovingAverage": True},  # over all blobs at once: their plain mean
    )
    return onnx.load(target)


def _without_roundings(model: onnx.ModelProto) -> onnx.ModelProto:
    """The converter's network without its casts to FP16 and straight back, and with each cast once.

    Between nodes that stay in float32 it puts such a pair, and one of the same name for each reader of a tensor.
    """
    half, full = onnx.TensorProto.FLOAT16, onnx.TensorProto.FLOAT
    halved = {node.output[0]: node.input[0] for node in model.graph.node if _is_cast(node, half)}
    nodes = {node.output[0]: node for node in model.graph.node}
    for node in nodes.values():
        if _is_cast(node, full) and node.input[0] in halved:
            node.op_type = "Identity"
            node.input[0] = halved[node.input[0]]
            del node.attribute[:]
    read = {name for node in nodes.values() for name in node.input} | {value.name for value in model.graph.output}
    kept = [node for node in nodes.values() if read.intersection(node.output)]
    result = _copy(model)
    del result.graph.node[:]
    result.graph.node.extend(kept)
    _name_nodes(result.graph)
    ONNXModel(result).topological_sort()
    return result


def _copy(model: onnx.ModelProto) -> onnx.ModelProto:
    result = onnx.ModelProto()
    result.CopyFrom(model)
    return result


def _is_cast(node: onnx.NodeProto, to: int) -> bool:
    return node.op_type == "Cast" and any(entry.name == "to" and entry.i == to for entry in node.attribute)


def _save(model: onnx.ModelProto, original: onnx.ModelProto, target: Path) -> None:
    """Write a converted network with the original's metadata."""
    del model.metadata_props[:]
    model.metadata_props.extend(original.metadata_props)
    onnx.save(model, target)
