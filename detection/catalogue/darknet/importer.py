"""Import of Darknet networks (cfg and weights) as ONNX files: YOLOv3, YOLOv4 and their tiny versions.

The outputs are the inputs of the [yolo] layers, [1, A (5 + classes), rows, columns], in the cfg's order and named after
their strides (`head_s32`, ...). `detection.yolo.decoders.anchored` decodes them into boxes; the class names, anchors
and scale_x_y that it needs are written to the file's metadata (`detection.yolo.metadata`).

    [net]  images [1, 3, H, W], RGB / 255  -->  Conv, MaxPool, Resize, Concat, Slice, Add  -->  head_s32, head_s16, ...

Reader of Darknet's weights files: a header and the float32 values of every convolution in the cfg's order.

    int32 major, minor, revision; number of training images: uint64 from version 0.2, uint32 before
    per convolution: bias[F], with batch norm also scale[F], mean[F], variance[F], then weights[F, C / groups, k, k]

All values are little-endian. Batch norm is folded into the convolution, in float64:

    a = scale / sqrt(variance + epsilon)        weights' = a weights        bias' = bias - a mean

with epsilon = 0.00001 as in AlexeyAB's `fuse_conv_batchnorm` (network.c), with which YOLOv4 was trained. Redmon's
Darknet uses sqrt(variance) + 0.000001 and OpenCV sqrt(variance + 0.000001); the difference matters only for channels
with a tiny variance.
"""

import json
import os
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt
import onnx
from onnx import TensorProto, helper, numpy_helper

from track_range.detection.catalogue.darknet.network import (
    ACTIVATIONS,
    IMAGE,
    Convolution,
    MaxPool,
    Network,
    Route,
    Shortcut,
    Upsample,
    read_network,
)
from track_range.detection.models.onnx_session import ModelError
from track_range.detection.models.writing import atomic_output, conversion_errors
from track_range.foundation.arrays import FloatArray32
from track_range.foundation.files.input_files import open_regular, readable

_EPSILON = 0.00001
_VERSION_BYTES = 12  # three version numbers at the start of the file
_MAX_VERSION = 999  # Darknet transposes the weights of files with larger ones
_BYTES_PER_VALUE = 4


def read_convolutions(path: Path, network: Network) -> Iterator[tuple[FloatArray32, FloatArray32]]:
    """Weights (F, C / groups, k, k) and bias (F,) of each convolution of `network`, including its
    batch norm.

    ModelError if the file cannot be read, does not have the network's number of values, or has
    values that are not finite.
    """
    values = _values(path, network.n_values)
    for index, layer in enumerate(network.layers):
        if isinstance(layer.operation, Convolution):
            own, values = np.split(values, [layer.operation.n_values])
            with np.errstate(all="ignore"):  # overflow is reported below
                weights, bias = _folded(layer.operation, own.astype(np.float64))
            if not (np.isfinite(weights).all() and np.isfinite(bias).all()):
                raise ModelError(
                    f"{path}: the weights of layer {index} are not finite; the training diverged, "
                    "or the file does not belong to this cfg."
                )
            yield weights, bias


def _values(path: Path, n_expected: int) -> npt.NDArray[np.float32]:
    with open_regular(path, ModelError, "Darknet weights") as file, readable(path, ModelError):
        n_bytes = os.fstat(file.fileno()).st_size
        version = np.frombuffer(
            file.read(_VERSION_BYTES).ljust(_VERSION_BYTES, b"\0"), "<i4"
        ).tolist()
        if not all(0 <= part <= _MAX_VERSION for part in version):
            raise ModelError(
                f"{path}: expected Darknet weights, whose first numbers are a version such as 0, "
                f"2, 5, got {', '.join(map(str, version))}; download or copy the file again."
            )
        header_bytes = _VERSION_BYTES + (8 if version[0] * 10 + version[1] >= 2 else 4)
        if n_bytes < header_bytes:
            raise ModelError(
                f"{path}: expected Darknet weights with a header of {header_bytes} bytes, got "
                f"{n_bytes} bytes."
            )
        n_values, rest_bytes = divmod(n_bytes - header_bytes, _BYTES_PER_VALUE)
        if n_values != n_expected or rest_bytes:
            rest = f" and {rest_bytes} bytes" if rest_bytes else ""
            raise ModelError(
                f"{path}: expected {n_expected:,} values for this cfg, got {n_values:,}{rest}; "
                "download or copy the file again, or specify the cfg that it was trained with."
            )
        file.seek(header_bytes)
        return np.frombuffer(file.read(n_values * _BYTES_PER_VALUE), "<f4")


def _folded(
    operation: Convolution, values: npt.NDArray[np.float64]
) -> tuple[FloatArray32, FloatArray32]:
    n_filters = operation.n_filters
    columns, weights = np.split(values, [operation.n_values - operation.n_weights])
    bias, *norm = columns.reshape(-1, n_filters)
    shape = (n_filters, operation.n_channels // operation.groups, operation.size, operation.size)
    weights = weights.reshape(shape)
    if norm:
        scale, mean, variance = norm
        factor = scale / np.sqrt(variance + _EPSILON)
        weights, bias = weights * factor[:, None, None, None], bias - factor * mean
    return weights.astype(np.float32), bias.astype(np.float32)


_OPSET, _IR_VERSION = 13, 8  # of ONNX, both of 2021, which onnxruntime 1.20 and TensorRT 8 support
_STRETCH_NOTE = (
    "Without letter_box=1 in the cfg, Darknet resizes images without preserving their aspect "
    "ratio; the imported model preserves it (letterbox centred-128). Use --letterbox stretch for "
    "Darknet's behaviour."
)


@dataclass(frozen=True, slots=True, kw_only=True)
class ImportedModel:
    """Summary of an imported network."""

    family: str  # "yolov3", "yolov3-tiny", "yolov4" or "yolov4-tiny", inferred from the structure
    input_hw: tuple[int, int]  # (height, width) of the input in pixels
    n_layers: int  # number of sections of the cfg without [net]
    n_parameters: int  # number of values in the weights file, including batch norm
    notes: tuple[str, ...]


def import_darknet(cfg: Path, weights: Path, out: Path, *, names: Sequence[str]) -> ImportedModel:
    """Write the network of `cfg` and `weights` to the ONNX file `out`; `names` are in the network's
    order.

    Raises ModelError: `cfg` or `weights` cannot be read or do not match, the network has
    unsupported layers or options, or the number of names differs from the number of classes.
    """
    network = read_network(cfg)
    n_classes = network.heads[0][1].n_classes
    if len(names) != n_classes:
        raise ModelError(
            f"{cfg}: expected {n_classes} class names in the network's order, got {len(names)}."
        )
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
    """The family: YOLOv4 has mish activations, YOLOv4-tiny grouped routes, YOLOv3-tiny two
    heads.
    """
    operations = [layer.operation for layer in network.layers]
    if any(isinstance(operation, Route) and operation.groups > 1 for operation in operations):
        return "yolov4-tiny"
    if any(
        isinstance(operation, Convolution) and operation.activation == "mish"
        for operation in operations
    ):
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
    names: dict[int, str] = {}  # of the outputs, by the index of their layer
    for source, _ in network.heads:
        name = f"head_s{round(network.input_shape[2] / network.layers[source].shape[2])}"
        names[source] = f"{name}_{len(names)}" if name in names.values() else name
    graph = _Graph(network, names)
    convolutions = read_convolutions(weights, network)
    for index, layer in enumerate(network.layers):
        if isinstance(layer.operation, Convolution):
            for name, values in zip(("weights", "bias"), next(convolutions), strict=True):
                graph.constant(f"{name}_{index}", values)
        graph.add_layer(index)
    shapes = {
        "images": network.input_shape,
        **{name: network.layers[i].shape for i, name in names.items()},
    }
    image, *outputs = (
        helper.make_tensor_value_info(name, TensorProto.FLOAT, (1, *shape))
        for name, shape in shapes.items()
    )
    body = helper.make_graph(graph.nodes, "darknet", [image], outputs, graph.initializers)
    opset = helper.make_opsetid("", _OPSET)
    model = helper.make_model(
        body, opset_imports=[opset], ir_version=_IR_VERSION, producer_name="track-range"
    )
    helper.set_model_props(model, dict(metadata))
    return model


class _Graph:
    """ONNX graph under construction: nodes, constants, and the output tensor of each layer."""

    def __init__(self, network: Network, names: Mapping[int, str]) -> None:
        self.nodes: list[onnx.NodeProto] = []
        self.initializers: list[onnx.TensorProto] = []
        self._layers, self._names = network.layers, names
        self._tensors = {IMAGE: "images"}

    def constant(self, name: str, values: object) -> str:
        self.initializers.append(numpy_helper.from_array(np.asarray(values), name))
        return name

    def add_layer(self, index: int) -> None:
        """Add one layer; dropout, [yolo] and routes of one source pass their input through."""
        layer, name = self._layers[index], self._names.get(index, f"layer_{index}")
        operation, inputs = layer.operation, [self._tensors[source] for source in layer.sources]
        self._tensors[index] = name
        if isinstance(operation, Convolution):
            self._activated(
                "Conv",
                [*inputs, f"weights_{index}", f"bias_{index}"],
                name,
                operation.activation,
                kernel_shape=[operation.size] * 2,
                strides=operation.stride_yx,
                pads=[operation.pad] * 4,
                group=operation.groups,
            )
        elif isinstance(operation, MaxPool):
            before = operation.padding // 2
            pads, size = [before] * 2 + [operation.padding - before] * 2, [operation.size] * 2
            self._node(
                "MaxPool", inputs, name, kernel_shape=size, strides=operation.stride_yx, pads=pads
            )
        elif isinstance(operation, Upsample):
            scales = self.constant(
                f"scales_{index}", np.array([1, 1, operation.stride, operation.stride], np.float32)
            )
            options = {
                "mode": "nearest",
                "coordinate_transformation_mode": "asymmetric",
                "nearest_mode": "floor",
            }
            self._node("Resize", [*inputs, "", scales], name, **options)
        elif isinstance(operation, Shortcut):
            self._activated(
                "Add" if len(inputs) == 2 else "Sum", inputs, name, operation.activation
            )
        else:
            if isinstance(operation, Route) and operation.groups > 1:
                inputs = [
                    self._part(operation, source, f"share_{index}_{i}")
                    for i, source in enumerate(layer.sources)
                ]
            if len(inputs) == 1:
                self._tensors[index] = inputs[0]
            else:
                self._node("Concat", inputs, name, axis=1)

    def _node(self, operator: str, inputs: Sequence[str], output: str, **attributes: Any) -> str:
        self.nodes.append(helper.make_node(operator, inputs, [output], name=output, **attributes))
        return output

    def _activated(
        self, operator: str, inputs: Sequence[str], output: str, activation: str, **attributes: Any
    ) -> None:
        function = ACTIVATIONS[activation]
        if not function.operators:
            self._node(operator, inputs, output, **attributes)
            return
        before = tensor = self._node(operator, inputs, f"{output}_linear", **attributes)
        slope = {} if function.alpha is None else {"alpha": function.alpha}
        for step in function.operators:
            is_last = step == function.operators[-1] and not function.is_gate
            tensor = self._node(
                step, [tensor], output if is_last else f"{output}_{step.lower()}", **slope
            )
        if function.is_gate:
            self._node("Mul", [before, tensor], output)

    def _part(self, operation: Route, source: int, name: str) -> str:
        """Add the slice of the channels of one source that a grouped route selects."""
        n_channels = self._layers[source].shape[0] // operation.groups
        start = operation.group_id * n_channels
        bounds = {"start": start, "end": start + n_channels, "axis": 1}
        constants = [
            self.constant(f"{name}_{key}", np.array([value], np.int64))
            for key, value in bounds.items()
        ]
        return self._node("Slice", [self._tensors[source], *constants], name)
