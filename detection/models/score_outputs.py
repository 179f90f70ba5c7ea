"""Copies of ONNX detectors with calibrated scores: s' = sigma(a_c logit(s) + b_c) for each class c.

Where the network computes its scores as s = sigma(x), the copy computes sigma(a_c x + b_c), which costs two operations
per score; where something else follows the sigmoid, it computes the logit of the outputs. A calibrated copy can be
calibrated again.
"""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

import numpy as np
import onnx
from onnx import helper, numpy_helper

from track_range.detection.models.onnx_session import ModelError
from track_range.detection.models.writing import atomic_output
from track_range.foundation.arrays import FloatArray

_SMALLEST = 1e-6
"""Smallest distance from 0 and 1 of a score whose logit is computed; in half precision, its resolution."""


def write_calibrated(
    path: Path, out: Path, *, score_outputs: Sequence[int], slope: FloatArray, offset: FloatArray
) -> None:
    """Write a copy of the network at `path` with calibrated scores.

    Args:
        path: the network, which is not changed unless `out` is the same file.
        out: the file to write.
        score_outputs: indices of the outputs (B, n, C) that are scores of n cells and C classes, at least one, all in
            float32 or all in float16.
        slope: (C,) a_c.
        offset: (C,) b_c.

    Raises:
        ModelError: the file cannot be read, or the copy cannot be written.
    """
    try:
        model = onnx.load(path)
    except Exception as error:  # onnx and protobuf raise unrelated types
        raise ModelError(f"{path}: not a readable ONNX model ({type(error).__name__}).") from error
    graph = model.graph
    outputs = [graph.output[index] for index in score_outputs]
    dtype = helper.tensor_dtype_to_np_dtype(outputs[0].type.tensor_type.elem_type)
    smallest = max(_SMALLEST, float(np.finfo(dtype).eps))
    prefix = _unused_prefix(graph)
    constants = {"slope": slope, "offset": offset, "low": smallest, "high": 1 - smallest, "one": 1}
    graph.initializer.extend(
        numpy_helper.from_array(np.asarray(value, dtype), prefix + name) for name, value in constants.items()
    )
    for output in outputs:
        _calibrate(graph, output.name, prefix)
    with atomic_output(out) as folder:
        onnx.save(model, folder / out.name)


def _calibrate(graph: onnx.GraphProto, output: str, prefix: str) -> None:
    """Insert the nodes that calibrate one output."""
    producer = next(node for node in graph.node if output in node.output)
    own = f"{prefix}{output}_"
    logits = own + "logits"
    nodes = []
    if producer.op_type == "Sigmoid":
        logits = producer.input[0]
        producer.output[:] = [own + "uncalibrated"]
    else:
        _rename(graph, output, own + "scores")
        nodes += [
            helper.make_node("Clip", [own + "scores", prefix + "low", prefix + "high"], [own + "inside"]),
            helper.make_node("Sub", [prefix + "one", own + "inside"], [own + "rest"]),
            helper.make_node("Div", [own + "inside", own + "rest"], [own + "odds"]),
            helper.make_node("Log", [own + "odds"], [logits]),
        ]
    nodes += [
        helper.make_node("Mul", [logits, prefix + "slope"], [own + "scaled"]),
        helper.make_node("Add", [own + "scaled", prefix + "offset"], [own + "shifted"]),
        helper.make_node("Sigmoid", [own + "shifted"], [output]),
    ]
    for node in nodes:
        node.name = own + node.op_type
    graph.node.extend(nodes)


def _rename(graph: onnx.GraphProto, old: str, new: str) -> None:
    """Rename a tensor in all nodes."""
    for node in graph.node:
        for names in (node.input, node.output):
            names[:] = [new if name == old else name for name in names]


def _unused_prefix(graph: onnx.GraphProto) -> str:
    """A prefix that no tensor of the graph has, also in a copy that is calibrated again."""
    names = {name for node in graph.node for name in (*node.input, *node.output)}
    return next(
        prefix for i in range(len(names) + 1) if not any(n.startswith(prefix := f"calibration{i}_") for n in names)
    )
