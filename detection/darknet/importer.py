"""Import of Darknet networks (cfg and weights) as ONNX files: YOLOv3, YOLOv4 and their tiny versions.

The outputs are the inputs of the [yolo] layers, [1, A (5 + classes), rows, columns], in the cfg's order and named after
their strides (`head_s32`, ...). `detection.yolo.decoders.HeadDecoder` decodes them into boxes; the class names, anchors
and scale_x_y that it needs are written to the file's metadata (`detection.models.metadata`).

    [net]  images [1, 3, H, W], RGB / 255  -->  Conv, MaxPool, Resize, Concat, Slice, Add  -->  head_s32, head_s16, ...
"""

from __future__ import annotations

import json
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import singledispatch
from pathlib import Path
from typing import Any

import numpy as np
import onnx
from onnx import TensorProto, helper, numpy_helper

from track_range.detection.darknet.layers import (
    ACTIVATIONS,
    IMAGE,
    Convolution,
    Layer,
    MaxPool,
    Network,
    Route,
    Shape,
    Shortcut,
    Upsample,
)
from track_range.detection.darknet.network import read_network
from track_range.detection.darknet.weights import read_convolutions
from track_range.detection.models.onnx_session import ModelError
from track_range.detection.models.writing import atomic_output, conversion_errors

_OPSET = 13
_IR_VERSION = 8
"""ONNX operator set and file format, both of 2021, which onnxruntime 1.20 and TensorRT 8 support."""

_PRODUCER = "track-range"
_STRETCH_NOTE = (
    "Without letter_box=1 in the cfg, Darknet resizes images without preserving their aspect ratio; the imported model "
    "preserves it (letterbox centred-128). Use --letterbox stretch for Darknet's behaviour."
)


@dataclass(frozen=True, slots=True, kw_only=True)
class ImportedModel:
    """Summary of an imported network.

    Attributes:
        family: "yolov3", "yolov3-tiny", "yolov4" or "yolov4-tiny", inferred from the structure.
        input_hw: (height, width) of the input in pixels.
        n_layers: number of sections of the cfg without [net].
        n_parameters: number of values in the weights file, including batch norm.
        notes: notes for the user.
    """

    family: str
    input_hw: tuple[int, int]
    n_layers: int
    n_parameters: int
    notes: tuple[str, ...]


def import_darknet(cfg: Path, weights: Path, out: Path, *, names: Sequence[str]) -> ImportedModel:
    """Write the network of `cfg` and `weights` to the ONNX file `out`, atomically.

    Args:
        cfg: Darknet's description of the network.
        weights: Darknet's weights file.
        out: the file to write.
        names: class names in the network's order.

    Raises:
        ModelError: `cfg` or `weights` cannot be read or do not match, the network has unsupported layers or options, or
            the number of names differs from the number of classes.
    """
    network = read_network(cfg)
    n_classes = network.heads[0][1].n_classes
    if len(names) != n_classes:
        raise ModelError(f"{cfg}: expected {n_classes} class names in the network's order, got {len(names)}.")
    family = _family(network)
    model = _model(network, weights, {"family": family, **_metadata(network, names)})
    with atomic_output(out) as folder, conversion_errors(cfg, "written as ONNX"):
        onnx.checker.check_model(model, full_check=True)
        onnx.save(model, folder / out.name)
    return ImportedModel(
        family=family,
        input_hw=network.input_shape[1:],
        n_layers=len(network.layers),
        n_parameters=network.n_values,
        notes=(_STRETCH_NOTE,) if network.letter_box is None else (),
    )


def _family(network: Network) -> str:
    """The family: YOLOv4 has mish activations, YOLOv4-tiny grouped routes, YOLOv3-tiny two heads."""
    operations = [layer.operation for layer in network.layers]
    if any(isinstance(operation, Route) and operation.groups > 1 for operation in operations):
        return "yolov4-tiny"
    if any(isinstance(operation, Convolution) and operation.activation == "mish" for operation in operations):
        return "yolov4"
    return "yolov3-tiny" if len(network.heads) == 2 else "yolov3"


def _metadata(network: Network, names: Sequence[str]) -> dict[str, str]:
    heads = [head for _, head in network.heads]
    return {
        "names": json.dumps(list(names), ensure_ascii=False),
        "anchors": json.dumps([head.anchors_px for head in heads]),
        "scale_x_y": json.dumps([head.scale_x_y for head in heads]),
        "letterbox": "stretch" if network.letter_box == 0 else "centred-128",
        "colours": "rgb",
        "divisor": "255",
    }


def _model(network: Network, weights: Path, metadata: Mapping[str, str]) -> onnx.ModelProto:
    heads = _head_names(network)
    graph = _Graph(network, heads)
    convolutions = read_convolutions(weights, network)
    for index, layer in enumerate(network.layers):
        if isinstance(layer.operation, Convolution):
            kernel, bias = next(convolutions)
            graph.constant(f"weights_{index}", kernel)
            graph.constant(f"bias_{index}", bias)
        _write(layer.operation, graph, index, layer)
    outputs = [_value(name, network.layers[source].shape) for source, name in heads.items()]
    body = helper.make_graph(
        graph.nodes, "darknet", [_value("images", network.input_shape)], outputs, graph.initializers
    )
    opset = helper.make_opsetid("", _OPSET)
    model = helper.make_model(body, opset_imports=[opset], ir_version=_IR_VERSION, producer_name=_PRODUCER)
    helper.set_model_props(model, dict(metadata))
    return model


def _head_names(network: Network) -> dict[int, str]:
    """Names of the outputs by the index of their layer, in the cfg's order."""
    names: dict[int, str] = {}
    for source, _ in network.heads:
        stride_px = round(network.input_shape[2] / network.layers[source].shape[2])
        name = f"head_s{stride_px}"
        names[source] = f"{name}_{len(names)}" if name in names.values() else name
    return names


def _value(name: str, shape: Shape) -> onnx.ValueInfoProto:
    return helper.make_tensor_value_info(name, TensorProto.FLOAT, (1, *shape))


class _Graph:
    """ONNX graph under construction: nodes, constants, and the output tensor of each layer."""

    def __init__(self, network: Network, heads: Mapping[int, str]) -> None:
        self.nodes: list[onnx.NodeProto] = []
        self.initializers: list[onnx.TensorProto] = []
        self._layers = network.layers
        self._names = dict(heads)
        self._tensors = {IMAGE: "images"}

    def constant(self, name: str, values: object) -> str:
        """Add a constant and return its name."""
        self.initializers.append(numpy_helper.from_array(np.asarray(values), name))
        return name

    def tensor(self, source: int) -> str:
        """Name of the output tensor of the layer `source`, or of the image."""
        return self._tensors[source]

    def inputs(self, layer: Layer) -> list[str]:
        return [self.tensor(source) for source in layer.sources]

    def n_channels(self, source: int) -> int:
        return self._layers[source].shape[0]

    def name(self, index: int) -> str:
        """Assign and return the name of the output tensor of layer `index`."""
        self._tensors[index] = self._names.get(index, f"layer_{index}")
        return self._tensors[index]

    def alias(self, index: int, tensor: str) -> None:
        """Make `tensor` the output of layer `index`."""
        self._tensors[index] = tensor

    def node(self, operator: str, inputs: Sequence[str], output: str, **attributes: Any) -> str:
        self.nodes.append(helper.make_node(operator, inputs, [output], name=output, **attributes))
        return output

    def activated(self, operator: str, inputs: Sequence[str], index: int, activation: str, **attributes: Any) -> None:
        """Add layer `index` as an operator and its activation."""
        function, output = ACTIVATIONS[activation], self.name(index)
        if not function.operators:
            self.node(operator, inputs, output, **attributes)
            return
        before = tensor = self.node(operator, inputs, f"{output}_linear", **attributes)
        slope = {} if function.alpha is None else {"alpha": function.alpha}
        for step in function.operators:
            is_last = step == function.operators[-1] and not function.is_gate
            tensor = self.node(step, [tensor], output if is_last else f"{output}_{step.lower()}", **slope)
        if function.is_gate:
            self.node("Mul", [before, tensor], output)


@singledispatch
def _write(operation: object, graph: _Graph, index: int, layer: Layer) -> None:
    """Add one layer to the graph; dropout and [yolo] pass their input through."""
    graph.alias(index, graph.inputs(layer)[0])


@_write.register
def _(operation: Convolution, graph: _Graph, index: int, layer: Layer) -> None:
    graph.activated(
        "Conv",
        [*graph.inputs(layer), f"weights_{index}", f"bias_{index}"],
        index,
        operation.activation,
        kernel_shape=[operation.size] * 2,
        strides=operation.stride_yx,
        pads=[operation.pad] * 4,
        group=operation.groups,
    )


@_write.register
def _(operation: MaxPool, graph: _Graph, index: int, layer: Layer) -> None:
    before = operation.padding // 2
    pads = [before] * 2 + [operation.padding - before] * 2
    size = [operation.size] * 2
    graph.node(
        "MaxPool", graph.inputs(layer), graph.name(index), kernel_shape=size, strides=operation.stride_yx, pads=pads
    )


@_write.register
def _(operation: Upsample, graph: _Graph, index: int, layer: Layer) -> None:
    scales = graph.constant(f"scales_{index}", np.array([1, 1, operation.stride, operation.stride], np.float32))
    options = {"mode": "nearest", "coordinate_transformation_mode": "asymmetric", "nearest_mode": "floor"}
    graph.node("Resize", [*graph.inputs(layer), "", scales], graph.name(index), **options)


@_write.register
def _(operation: Route, graph: _Graph, index: int, layer: Layer) -> None:
    tensors = graph.inputs(layer)
    if operation.groups > 1:
        tensors = [
            _channels(graph, operation, source, f"fraction_{index}_{i}") for i, source in enumerate(layer.sources)
        ]
    if len(tensors) == 1:
        graph.alias(index, tensors[0])
    else:
        graph.node("Concat", tensors, graph.name(index), axis=1)


def _channels(graph: _Graph, operation: Route, source: int, name: str) -> str:
    """Add a slice of the channels of one source that a grouped route selects, and return its name."""
    n_channels = graph.n_channels(source) // operation.groups
    start = operation.group_id * n_channels
    bounds = {"start": start, "end": start + n_channels, "axis": 1}
    constants = [graph.constant(f"{name}_{key}", np.array([value], np.int64)) for key, value in bounds.items()]
    return graph.node("Slice", [graph.tensor(source), *constants], name)


@_write.register
def _(operation: Shortcut, graph: _Graph, index: int, layer: Layer) -> None:
    tensors = graph.inputs(layer)
    operator = "Add" if len(tensors) == 2 else "Sum"
    graph.activated(operator, tensors, index, operation.activation)
