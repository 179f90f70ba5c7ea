"""Small ONNX networks for tests: networks with constant outputs, and a detector of a bright
rectangle."""

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


def write_outputs(path, outputs, *, inputs=None, metadata=None):
    """Write a network with constant `outputs`, arrays by name: integers as int64, other numbers as
    float32.

    Args:
        outputs: array of each output, in the network's order.
        inputs: shape of each input by name, with texts for variable sizes; [N, 2] is int64, others
            are float32.
    """
    inputs = inputs or {"images": (1, 3, 64, 64)}
    values = {
        name: np.asarray(array, np.int64 if np.asarray(array).dtype.kind in "iu" else np.float32)
        for name, array in outputs.items()
    }
    nodes = [helper.make_node("Identity", [f"{name}_value"], [name]) for name in values]
    weights = [numpy_helper.from_array(array, f"{name}_value") for name, array in values.items()]
    return _save(
        path,
        helper.make_graph(nodes, "constant", _infos(inputs), _output_infos(values), weights),
        metadata,
    )


def write_dfine(path, logits, boxes, *, inputs, n_selected):
    """Write a network with constant logits (N, C) and boxes (N, 4) and the postprocessing that
    D-FINE's exporter adds.

    DFINEPostProcessor.forward: boxes scaled to orig_target_sizes, the `n_selected` best pairs of
    query and class.
    """
    n_classes = logits.shape[1]
    constants = {
        "logits": logits[None].astype(np.float32),
        "cxcywh": boxes[None].astype(np.float32),
        "half": np.float32(0.5),
        "flat": np.array([1, -1]),
        "k": np.array([n_selected]),
        "n_classes": np.array(n_classes),
        "middle": np.array([1]),
        "last": np.array([2]),
        "wide": np.array([1, 1, 4]),
    }
    nodes = [
        helper.make_node("Split", ["cxcywh", "split"], ["centre", "size"], axis=2),
        helper.make_node("Mul", ["size", "half"], ["half_size"]),
        helper.make_node("Sub", ["centre", "half_size"], ["low"]),
        helper.make_node("Add", ["centre", "half_size"], ["high"]),
        helper.make_node("Concat", ["low", "high"], ["fractions"], axis=2),
        helper.make_node("Cast", ["orig_target_sizes"], ["sizes"], to=TensorProto.FLOAT),
        helper.make_node("Concat", ["sizes", "sizes"], ["scale_row"], axis=1),
        helper.make_node("Unsqueeze", ["scale_row", "middle"], ["scale"]),
        helper.make_node("Mul", ["fractions", "scale"], ["scaled"]),
        helper.make_node("Sigmoid", ["logits"], ["probabilities"]),
        helper.make_node("Reshape", ["probabilities", "flat"], ["pairs"]),
        helper.make_node("TopK", ["pairs", "k"], ["scores", "index"], axis=1),
        helper.make_node("Mod", ["index", "n_classes"], ["labels"]),
        helper.make_node("Div", ["index", "n_classes"], ["query"]),
        helper.make_node("Unsqueeze", ["query", "last"], ["query_column"]),
        helper.make_node("Expand", ["query_column", "wide"], ["query_columns"]),
        helper.make_node("GatherElements", ["scaled", "query_columns"], ["boxes"], axis=1),
    ]
    weights = [numpy_helper.from_array(value, name) for name, value in constants.items()]
    weights.append(numpy_helper.from_array(np.array([2, 2]), "split"))
    outputs = {
        "labels": np.zeros((1, n_selected), np.int64),
        "boxes": np.zeros((1, n_selected, 4)),
        "scores": np.zeros((1, n_selected)),
    }
    return _save(
        path,
        helper.make_graph(nodes, "d-fine", _infos(inputs), _output_infos(outputs), weights),
        None,
    )


def _infos(inputs):
    numbers = {2: TensorProto.INT64}
    return [
        helper.make_tensor_value_info(name, numbers.get(len(shape), TensorProto.FLOAT), shape)
        for name, shape in inputs.items()
    ]


def _output_infos(values):
    return [
        helper.make_tensor_value_info(
            name, TensorProto.INT64 if array.dtype.kind in "iu" else TensorProto.FLOAT, array.shape
        )
        for name, array in values.items()
    ]


def write_rectangle_finder(path, *, side_px, grey, metadata=None):
    """Write a YOLOv5-like network of one class: its first row is the box of what is brighter than
    `grey` (0..1).

    The brightness above the padding's grey is the fraction of a pixel that the rectangle covers, so
    that its sums are width and height, and its centroid is the centre.
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
            helper.make_node(
                "ReduceSum", [f"weighted_{axis}", "all_axes"], [f"moment_{axis}"], keepdims=1
            ),
            helper.make_node("Div", [f"moment_{axis}", f"size_{axis}"], [f"centre_{axis}"]),
        ]
    nodes += [
        helper.make_node(
            "Concat", ["centre_x", "centre_y", "size_x", "size_y", "score"], ["box"], axis=3
        ),
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


def write_mean_network(path, *, input_shape, split_at_row=None):
    """Features (batch, 6): mean of each channel over the upper half of the input, then over the
    lower half."""
    height = split_at_row or input_shape[2]
    constants = {
        name: np.array([value])
        for name, value in (("0", 0), ("half", height // 2), ("all", height), ("2", 2))
    }
    nodes = []
    for name, start, end in (("upper", "0", "half"), ("lower", "half", "all")):
        nodes.append(helper.make_node("Slice", ["images", start, end, "2"], [f"{name}_half"]))
        nodes.append(
            helper.make_node("ReduceMean", [f"{name}_half"], [name], axes=[2, 3], keepdims=0)
        )
    nodes.append(helper.make_node("Concat", ["upper", "lower"], ["features"], axis=1))
    image = helper.make_tensor_value_info("images", TensorProto.FLOAT, input_shape)
    features = helper.make_tensor_value_info("features", TensorProto.FLOAT, [input_shape[0], 6])
    weights = [numpy_helper.from_array(value, name) for name, value in constants.items()]
    model = helper.make_model(
        helper.make_graph(nodes, "means", [image], [features], weights),
        opset_imports=[helper.make_opsetid("", 13)],
    )
    model.ir_version = 9
    onnx.save(model, path)
    return path
