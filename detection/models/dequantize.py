"""INT8 networks in float, for devices that would run each rounding as a separate operator."""

from collections.abc import Mapping, Sequence
from pathlib import Path

import numpy as np
import onnx
from onnx import numpy_helper

_ROUNDING = ("QuantizeLinear", "DequantizeLinear")


def float_network(path: Path) -> bytes | None:
    """The network without rounding, with its weights in float.

    None = it has no rounding, it rounds in another way than quantizers for onnxruntime do (rounded
    inputs of operators, INT8 weights, scales of float32 as initializers), or an output is rounded.
    """
    model = onnx.load(str(path))
    graph = model.graph
    tensors = {tensor.name: tensor for tensor in graph.initializer}
    kept = [node for node in graph.node if node.op_type not in _ROUNDING]
    rounding = [node for node in graph.node if node.op_type in _ROUNDING]
    has_integer_operators = any(_is_integer_operator(node) for node in kept)
    are_known = all(_is_known(node, tensors) for node in rounding)
    if not rounding or has_integer_operators or not are_known:
        return None
    of_weights = [node for node in rounding if node.input[0] in tensors]
    graph.initializer.extend([_float_weight(node, tensors) for node in of_weights])
    unrounded = _unrounded([node for node in rounding if node.input[0] not in tensors])
    if any(output.name in unrounded for output in graph.output):
        return None
    for node in kept:
        node.input[:] = [unrounded.get(name, name) for name in node.input]
    del graph.node[:], graph.value_info[:]
    graph.node.extend(kept)
    return bytes(model.SerializeToString())


def _is_integer_operator(node: onnx.NodeProto) -> bool:
    return bool(node.op_type.startswith("QLinear") or node.op_type.endswith("Integer"))


def _is_known(node: onnx.NodeProto, tensors: Mapping[str, onnx.TensorProto]) -> bool:
    """Whether an operator rounds a value, or returns a weight stored as INT8, with a scale of
    float32.
    """
    is_weight = node.input[0] in tensors
    if is_weight and node.op_type == "QuantizeLinear":
        return False
    parameters = node.input[1:]
    if any(name not in tensors for name in parameters):
        return False
    return bool(tensors[parameters[0]].data_type == onnx.TensorProto.FLOAT)


def _unrounded(rounding: Sequence[onnx.NodeProto]) -> dict[str, str]:
    """The value that each rounded value comes from, by name."""
    values = dict[str, str]()
    for node in rounding:
        value = node.input[0]
        values[node.output[0]] = values.get(value, value)
    return values


def _float_weight(
    node: onnx.NodeProto, tensors: Mapping[str, onnx.TensorProto]
) -> onnx.TensorProto:
    """The weight that a DequantizeLinear returns: (INT8 - zero point) * scale, the latter two per
    tensor or along an axis.
    """
    weight, scale, *zero = (
        numpy_helper.to_array(tensors[name]).astype(np.float32) for name in node.input
    )
    axis = next((attribute.i for attribute in node.attribute if attribute.name == "axis"), 1)
    shape = list[int]()
    if scale.ndim and weight.ndim:
        shape = [1] * weight.ndim
        shape[axis % weight.ndim] = -1
    if zero:
        weight = weight - zero[0].reshape(shape)
    weight = weight * scale.reshape(shape)
    return numpy_helper.from_array(weight.astype(np.float32), node.output[0])
