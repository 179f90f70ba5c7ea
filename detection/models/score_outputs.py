"""Copies of ONNX detectors with calibrated scores: s' = sigma(a_c logit(s) + b_c) for each class c.

Where the network computes its scores as s = sigma(x), the copy computes sigma(a_c x + b_c), which costs two operations
per score; where something else follows the sigmoid, it computes the logit of the outputs. A calibrated copy can be
calibrated again.
"""

from __future__ import annotations

import itertools
from collections.abc import Sequence
from pathlib import Path

import numpy as np
import onnx
from onnx import helper, numpy_helper

from track_range.detection.models.onnx_session import ModelError, OnnxSession, Runtime
from track_range.detection.models.writing import atomic_output
from track_range.foundation.arrays import FloatArray

_SMALLEST = 1e-6  # distance from 0 and 1 of a score whose logit is computed; in half precision, its resolution


def write_calibrated(
    path: Path, out: Path, *, score_outputs: Sequence[int], slope: FloatArray, offset: FloatArray
) -> None:
    """Write a copy of the network at `path` with calibrated scores; ModelError if it cannot be read, written or loaded.

    `score_outputs` are outputs (B, n, C) of scores of n cells and C classes, all in float32 or in float16; `slope` (C,)
    is a_c and `offset` (C,) b_c.
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
    for output in outputs:
        _calibrate(graph, output.name, prefix)
    used = {name for node in graph.node for name in node.input}
    constants = {"slope": slope, "offset": offset, "low": smallest, "high": 1 - smallest, "one": 1}
    graph.initializer.extend(
        numpy_helper.from_array(np.asarray(value, dtype), prefix + name)
        for name, value in constants.items()
        if prefix + name in used
    )
    with atomic_output(out) as folder:
        onnx.save(model, folder / out.name)
        OnnxSession(folder / out.name, Runtime(device="cpu"))  # raises a ModelError if it cannot be loaded


def _calibrate(graph: onnx.GraphProto, output: str, prefix: str) -> None:
    """Insert the nodes that calibrate one output behind the node that computes it."""
    index = next(i for i, node in enumerate(graph.node) if output in node.output)
    own = f"{prefix}{output}_"
    for node in graph.node:
        for names in (node.input, node.output):
            names[:] = [own + "uncalibrated" if name == output else name for name in names]
    nodes = []
    if graph.node[index].op_type == "Sigmoid":
        logits = graph.node[index].input[0]
    else:
        logits = own + "logits"
        nodes = [
            helper.make_node("Max", [own + "uncalibrated", prefix + "low"], [own + "above"]),
            helper.make_node("Min", [own + "above", prefix + "high"], [own + "inside"]),
            helper.make_node("Sub", [prefix + "one", own + "inside"], [own + "rest"]),
            helper.make_node("Div", [own + "inside", own + "rest"], [own + "odds"]),
            helper.make_node("Log", [own + "odds"], [logits]),
        ]
    nodes += [
        helper.make_node("Mul", [logits, prefix + "slope"], [own + "scaled"]),
        helper.make_node("Add", [own + "scaled", prefix + "offset"], [own + "shifted"]),
        helper.make_node("Sigmoid", [own + "shifted"], [output]),
    ]
    for i, node in enumerate(nodes, start=index + 1):
        node.name = own + node.op_type
        graph.node.insert(i, node)


def _unused_prefix(graph: onnx.GraphProto) -> str:
    """A prefix that no tensor of the graph has, also in a copy that is calibrated again."""
    names = {name for node in graph.node for name in (*node.input, *node.output)}
    prefixes = (f"calibration{i}_" for i in itertools.count())
    return next(prefix for prefix in prefixes if not any(name.startswith(prefix) for name in names))
