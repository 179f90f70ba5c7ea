"""A network that takes a given time, and a detector with it that returns stored boxes.

It shows what a run takes where the network is fast, as on a GPU. The network consists of
layers of pooling; everything around it is that of a YOLOv5 network.
"""

from __future__ import annotations

import time
from collections.abc import Callable, Sequence
from itertools import cycle, pairwise
from pathlib import Path
from typing import Any

import numpy as np
import onnx
from onnx import TensorProto, helper, numpy_helper

from track_range.detection.catalogue.lookup import DEFAULT_MODEL, find_model
from track_range.detection.detections import Detections
from track_range.detection.models.onnx_session import OnnxSession, Runtime
from track_range.detection.yolo.detector import YoloDetector, YoloSettings
from track_range.foundation.arrays import Image
from track_range.run.options.opened import DetectorOptions

INPUT_HW = 320, 608  # as of the packaged detector for videos of 16:9
N_CLASSES = 80
_ANCHORS_PER_CELL, _STRIDES_PX = 3, (8, 16, 32)  # of YOLOv5
_MOST_LAYERS, _N_TIMED, _N_TRIED = 400, 50, 3  # layers at most; timed runs; numbers of layers


def write_network(path: Path, ms: float) -> float:
    """Write the network whose time on one thread of a CPU is nearest to `ms`, and return its time
    in ms.
    """
    n_layers, step_ms = 0, 0.0
    for _ in range(_N_TRIED):
        _write(path, n_layers)
        taken_ms = time_ms(path)
        if n_layers == 0:
            _write(path, 10)
            step_ms = (time_ms(path) - taken_ms) / 10
        n_layers = min(max(n_layers + round((ms - taken_ms) / step_ms), 0), _MOST_LAYERS)
    _write(path, n_layers)
    return time_ms(path)


def time_ms(path: Path) -> float:
    """Median processor time of a run of the network on one thread of a CPU."""
    network = OnnxSession(path, Runtime(device="cpu", n_threads=1)).bound(INPUT_HW)
    times_s = []
    for _ in range(_N_TIMED):
        start_s = time.thread_time()
        network.run()
        times_s.append(time.thread_time() - start_s)
    return 1e3 * float(np.median(times_s))


def _write(path: Path, n_layers: int) -> None:
    """Write a network with a number of layers, which finds nothing."""
    height, width = INPUT_HW
    n_cells = sum((height // stride) * (width // stride) for stride in _STRIDES_PX)
    rows = np.zeros((1, _ANCHORS_PER_CELL * n_cells, 5 + N_CLASSES), np.float32)
    layers = ["images", *(f"layer{number}" for number in range(n_layers))]
    nodes = [
        helper.make_node("MaxPool", [source], [target], kernel_shape=[3, 3], pads=[1] * 4)
        for source, target in pairwise(layers)
    ]
    nodes += [
        helper.make_node("ReduceMean", [layers[-1]], ["mean"], keepdims=0),
        helper.make_node("Mul", ["mean", "zero"], ["zeros"]),
        helper.make_node("Add", ["rows", "zeros"], ["output"]),
    ]
    graph = helper.make_graph(
        nodes,
        "pooling",
        [helper.make_tensor_value_info("images", TensorProto.FLOAT, (1, 3, *INPUT_HW))],
        [helper.make_tensor_value_info("output", TensorProto.FLOAT, rows.shape)],
        [
            numpy_helper.from_array(rows, "rows"),
            numpy_helper.from_array(np.zeros(1, np.float32), "zero"),
        ],
    )
    opset = helper.make_opsetid("", 17)
    onnx.save(helper.make_model(graph, opset_imports=[opset], ir_version=8), str(path))


class StoredBoxes(YoloDetector):
    """The detector of a file, whose boxes are replaced by stored ones, frame after frame."""

    def __init__(self, path: Path, frames: Sequence[Detections], **keywords: Any) -> None:
        super().__init__(path, YoloSettings(), **keywords)
        self._frames = cycle(frames)

    def prepared(self, image: Image) -> Callable[[], Detections]:
        """Does all that the network's own boxes need, and returns the stored ones."""
        detect, stored = super().prepared(image), next(self._frames)

        def detected() -> Detections:
            detect()
            return stored

        return detected


class OpenedStoredBoxes:
    """Opens `StoredBoxes` for a run, in the place of the detector in the file."""

    def __init__(self, frames: Sequence[Detections]) -> None:
        self._frames = frames

    def __call__(self, path: Path, options: DetectorOptions) -> StoredBoxes:
        runtime = Runtime(device=options.device, n_threads=options.threads)
        return StoredBoxes(path, self._frames, runtime=runtime)


def packaged_boxes(images: Sequence[Image]) -> list[Detections]:
    """The boxes of the packaged detector in images."""
    detector = YoloDetector(find_model(DEFAULT_MODEL).path, runtime=Runtime(n_threads=1))
    return [detector.detect(image) for image in images]
