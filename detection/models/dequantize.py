"""INT8 networks in float, for devices that would run each rounding as a separate operator."""

from pathlib import Path

import numpy as np
import onnx
from onnx import numpy_helper


def float_network(path: Path) -> bytes | None:
    """The network without rounding, with its weights in float.

    None = it has no rounding, it rounds in another way than quantizers for onnxruntime do (rounded
    inputs of operators, INT8 weights, scales of float32 as initializers), or an output is rounded.
    """
    model = onnx.load(str(path))
    tensors = {tensor.name: tensor for tensor in model.graph.initializer}
    kept, source = [], dict[str, str]()
    for node in model.graph.node:
        if node.op_type.startswith("QLinear") or node.op_type.endswith("Integer"):
            return None
        if node.op_type not in ("QuantizeLinear", "DequantizeLinear"):
            kept.append(node)
            continue
        is_weight, parameters = node.input[0] in tensors, node.input[1:]
        if (
            any(name not in tensors for name in parameters)
            or tensors[parameters[0]].data_type != onnx.TensorProto.FLOAT
        ):
            return None
        if not is_weight:
            source[node.output[0]] = source.get(node.input[0], node.input[0])
        elif node.op_type == "QuantizeLinear":
            return None
        else:
            weight, scale, *zero = (
                numpy_helper.to_array(tensors[name]).astype(np.float32) for name in node.input
            )
            axis = next(
                (attribute.i for attribute in node.attribute if attribute.name == "axis"), 1
            )
            shape = (
                [-1 if i == axis % weight.ndim else 1 for i in range(weight.ndim)]
                if scale.ndim
                else []
            )
            weight = (weight - (zero[0].reshape(shape) if zero else 0)) * scale.reshape(shape)
            model.graph.initializer.append(
                numpy_helper.from_array(weight.astype(np.float32), node.output[0])
            )
    if len(kept) == len(model.graph.node) or any(
        output.name in source for output in model.graph.output
    ):
        return None
    for node in kept:
        node.input[:] = [source.get(name, name) for name in node.input]
    del model.graph.node[:], model.graph.value_info[:]
    model.graph.node.extend(kept)
    return bytes(model.SerializeToString())
