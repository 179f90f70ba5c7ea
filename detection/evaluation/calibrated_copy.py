"""Copies of ONNX detectors with calibrated scores: s' = sigma(a_c logit(s) + b_c) for each class c.

Where the network computes its scores as s = sigma(x), the copy computes sigma(a_c x + b_c), which
costs two operations per score. Where another operation follows the sigmoid, the copy computes the
logit of the outputs. A calibrated copy can be calibrated again.
"""

import itertools
from collections.abc import Sequence
from pathlib import Path

import numpy as np
import onnx
from onnx import helper, numpy_helper

from track_range.detection.classes import ROAD_CLASSES, map_to_road_classes
from track_range.detection.evaluation.score_fit import BACKGROUND_SCORE, LOWEST_SCORE, ScoreFit
from track_range.detection.models.onnx_session import ModelError, OnnxSession, Runtime
from track_range.detection.models.writing import atomic_output
from track_range.detection.yolo.detector import YoloDetector
from track_range.foundation.arrays import FloatArray
from track_range.foundation.files.output_files import OutputError, write_bytes

# distance from 0 and 1 of a score whose logit is computed; in half precision, its resolution
_SMALLEST = 1e-6


def score_outputs(detector: YoloDetector) -> tuple[int, ...]:
    """Indices of the network's outputs that are class scores; ModelError if scores are not separate
    outputs.
    """
    if detector.model.score_outputs:
        return detector.model.score_outputs
    raise ModelError(
        f"{detector.session.path}: expected a detector with separate outputs for the class scores, "
        f"such as RoadNet, found {detector.model.layout}; export it with separate outputs if its "
        "exporter can."
    )


def check_attributes(model: Path, out: Path) -> bytes | None:
    """The attributes beside the model, `MODEL.yaml`, or None; OutputError if the copy at `out` has
    other attributes.
    """
    source, target = model.with_suffix(".yaml"), out.with_suffix(".yaml")
    content = source.read_bytes() if source.is_file() else None
    if target.is_file() and target.read_bytes() != content:
        raise OutputError(
            f"{target}: expected no file, or the attributes of {model.name}, found other "
            "attributes; choose another --out."
        )
    return content


def write_calibrated_copy(
    detector: YoloDetector, fit: ScoreFit, out: Path, *, images: Path
) -> None:
    """Write a copy of a detector with scores calibrated on `images`, and its attributes; ModelError
    if this fails.
    """
    known = detector.known_class_id
    background = fit.probability(np.full(len(known), BACKGROUND_SCORE), known)
    if background.max() > LOWEST_SCORE:
        name = ROAD_CLASSES[known[background.argmax()]]
        raise ModelError(
            f"{images}: expected scores that are clearly higher for detections that match a label, "
            f"but with the scores of {name}, background would get a probability of "
            f"{background.max():.2f}; check the labels, or give more images."
        )
    model = detector.session.path
    content = check_attributes(model, out)
    road_class = map_to_road_classes(detector.model.names)
    slope, offset = (  # classes that are no road classes have the shared coefficients
        np.where(road_class < 0, shared, own[road_class])
        for shared, own in zip(fit.shared, (fit.slope, fit.offset), strict=True)
    )
    write_calibrated(model, out, score_outputs=score_outputs(detector), slope=slope, offset=offset)
    if content is not None:
        write_bytes(out.with_suffix(".yaml"), content)


def write_calibrated(
    path: Path, out: Path, *, score_outputs: Sequence[int], slope: FloatArray, offset: FloatArray
) -> None:
    """Write a copy of the network at `path` with calibrated scores; ModelError if it cannot be
    read, written or loaded.

    `score_outputs` are outputs (B, n, C) of scores of n cells and C classes, all in float32 or in
    float16; `slope` (C,) is a_c and `offset` (C,) b_c.
    """
    try:
        model = onnx.load(path)
    except Exception as error:  # onnx and protobuf raise unrelated types
        raise ModelError(
            f"{path}: this is not a readable ONNX model ({type(error).__name__})."
        ) from error
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
        # raises a ModelError if it cannot be loaded
        OnnxSession(folder / out.name, Runtime(device="cpu"))


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
