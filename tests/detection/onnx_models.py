"""Small ONNX networks for tests: networks with constant outputs, and a detector of a bright rectangle."""

import numpy as np
import onnx
from onnx import TensorProto, helper, numpy_helper


def write_model(path, *outputs, metadata=None, input_shape=(1, 3, 64, 64), is_half=False):
    """Write a network that outputs the given arrays for any input."""
    number = TensorProto.FLOAT16 if is_half else TensorProto.FLOAT
    dtype = np.float16 if is_half else np.float32
    image = helper.make_tensor_value_info("images", number, input_shape)
    nodes = [
        helper.make_node("ReduceMean", ["images"], ["mean"], keepdims=0),
        helper.make_node("Mul", ["mean", "zero"], ["zeros"]),
    ]
    weights = [numpy_helper.from_array(np.zeros(1, dtype), "zero")]
    infos = []
    for i, array in enumerate(outputs):
        nodes.append(helper.make_node("Add", [f"rows{i}", "zeros"], [f"output{i}"]))
        weights.append(numpy_helper.from_array(array.astype(dtype), f"rows{i}"))
        infos.append(helper.make_tensor_value_info(f"output{i}", number, array.shape))
    graph = helper.make_graph(nodes, "constant", [image], infos, weights)
    return _save(path, graph, metadata)


def write_rectangle_finder(path, *, side_px, grey, metadata=None):
    """Write a YOLOv5-like network of one class: its first row is the box of what is brighter than `grey` (0..1).

    The brightness above the padding's grey is the fraction of a pixel that the rectangle covers, so that its sums are
    width and height, and its centroid is the centre.
    """
    n_rows = 3 * sum((side_px // stride) ** 2 for stride in (8, 16, 32))
    centres = np.arange(side_px, dtype=np.float32) + 0.5
    constants = {
        "grey": np.float32([grey]),
        "contrast": np.float32([1 - grey]),
        "x": centres.reshape(1, 1, 1, -1),
        "y": centres.reshape(1, 1, -1, 1),
        "score": np.ones((1, 1, 1, 2), np.float32),
        "empty_rows": np.zeros((1, n_rows - 1, 6), np.float32),
        "row_shape": np.array([1, 1, 6]),
        "all_axes": np.array([1, 2, 3]),
    }
    nodes = [
        helper.make_node("ReduceMean", ["images"], ["mean"], axes=[1]),
        helper.make_node("Sub", ["mean", "grey"], ["above"]),
        helper.make_node("Div", ["above", "contrast"], ["share"]),
        helper.make_node("Relu", ["share"], ["covered"]),
        helper.make_node("ReduceMax", ["covered"], ["columns"], axes=[2]),
        helper.make_node("ReduceMax", ["covered"], ["rows"], axes=[3]),
    ]
    for profile, axis in (("columns", "x"), ("rows", "y")):
        nodes += [
            helper.make_node("ReduceSum", [profile, "all_axes"], [f"size_{axis}"], keepdims=1),
            helper.make_node("Mul", [profile, axis], [f"weighted_{axis}"]),
            helper.make_node("ReduceSum", [f"weighted_{axis}", "all_axes"], [f"moment_{axis}"], keepdims=1),
            helper.make_node("Div", [f"moment_{axis}", f"size_{axis}"], [f"centre_{axis}"]),
        ]
    nodes += [
        helper.make_node("Concat", ["centre_x", "centre_y", "size_x", "size_y", "score"], ["box"], axis=3),
        helper.make_node("Reshape", ["box", "row_shape"], ["row"]),
        helper.make_node("Concat", ["row", "empty_rows"], ["output0"], axis=1),
    ]
    image = helper.make_tensor_value_info("images", TensorProto.FLOAT, (1, 3, side_px, side_px))
    output = helper.make_tensor_value_info("output0", TensorProto.FLOAT, (1, n_rows, 6))
    weights = [numpy_helper.from_array(value, name) for name, value in constants.items()]
    return _save(path, helper.make_graph(nodes, "rectangle", [image], [output], weights), metadata)


def _save(path, graph, metadata):
    model = helper.make_model(graph, opset_imports=[helper.make_opsetid("", 13)])
    model.ir_version = 9
    helper.set_model_props(model, metadata or {})
    onnx.save(model, path)
    return path
