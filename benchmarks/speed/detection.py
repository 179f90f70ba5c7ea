"""Time of each detector at each input size: preprocessing, inference and postprocessing, on one and two threads.

Protocol: the frames of a real drive, decoded beforehand; each model, size and number of threads is a row, and rows
alternate frame by frame, so that variations of the machine affect all alike. Medians over all frames and rounds. `pre`
is resizing, padding and channel order into the network's bound input; `post` is reading the outputs, non-maximum
suppression and conversion to image coordinates. OpenCV uses one thread. Goals: pre + post at most 3 ms per 1242 x 375
frame at 640, and at most 8 % of inference.
"""

from __future__ import annotations

import argparse
import time
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import av
import cv2
import numpy as np
from rich import box
from rich.console import Console
from rich.table import Table

from benchmarks.inputs.drives import REAL_DATA
from track_range.detection.models.onnx_session import Runtime
from track_range.detection.yolo.detector import YoloDetector, YoloSettings
from track_range.foundation.arrays import FloatArray, Image

SIZES_PX = (320, 416, 640)
"""Input sizes of networks with a dynamic input."""


@dataclass(frozen=True, slots=True)
class _Row:
    """One line of the table: a detector, and its (frames * rounds, 3) times in ms."""

    name: str
    n_threads: int
    detector: YoloDetector
    times_ms: list[list[float]]

    def median_ms(self) -> FloatArray:
        """(3,) median times of pre, inference and post in ms."""
        return np.asarray(np.median(self.times_ms, axis=0))


def add_options(parser: argparse.ArgumentParser) -> None:
    """Add the options of this workload."""
    models = [REAL_DATA / "models" / f"{name}.onnx" for name in _DETECTORS]
    parser.add_argument("--models", type=Path, nargs="+", default=models, help="ONNX files")
    video = REAL_DATA / "kitti_stereo" / "0003" / "left.mp4"
    parser.add_argument("--video", type=Path, default=video, help="video with the frames")
    parser.add_argument("--frames", type=int, default=16, help="number of frames, from the first on")
    parser.add_argument("--rounds", type=int, default=3, help="number of passes over the frames")
    parser.add_argument("--threads", type=int, nargs="+", default=[1, 2], help="numbers of threads")


_DETECTORS = (
    "yolov5n_coco_640",
    "yolov5n_coco_dyn",
    "yolov4tiny_voc_416",
    "yolox_nano_416",
    "nanodet_m_416",
    "picodet_s_416",
)


def measure(options: argparse.Namespace) -> dict[str, Any]:
    """Time all rows, print the table, and return its figures (milliseconds per frame)."""
    cv2.setNumThreads(1)
    frames = _frames(options.video, options.frames)
    rows = [row for n in options.threads for path in options.models for row in _rows(path, n)]
    for row in rows:
        row.detector.detect(frames[0])
    for _ in range(options.rounds):
        for frame in frames:
            for row in rows:
                row.times_ms.append(_timed_ms(row.detector, frame))
    figures = [_figures(row) for row in rows]
    _print(figures, frames[0].shape[:2])
    return {"frames": len(frames), "rounds": options.rounds, "image_hw": list(frames[0].shape[:2]), "rows": figures}


def _frames(video: Path, n: int) -> list[Image]:
    with av.open(str(video)) as reader:
        pairs = zip(reader.decode(video=0), range(n), strict=False)
        return [np.asarray(frame.to_ndarray(format="bgr24"), np.uint8) for frame, _ in pairs]


def _rows(path: Path, n_threads: int) -> list[_Row]:
    """One row for a network with a fixed input; for a dynamic one a rectangular and a square input of each size."""
    fixed = YoloDetector(path, runtime=Runtime(device="cpu", n_threads=n_threads))
    if None not in fixed.session.input_shape[2:]:
        return [_Row(path.stem, n_threads, fixed, [])]
    settings = [YoloSettings(size_px=size, is_square=square) for size in SIZES_PX for square in (False, True)]
    return [
        _Row(path.stem, n_threads, YoloDetector(path, option, runtime=Runtime(device="cpu", n_threads=n_threads)), [])
        for option in settings
    ]


def _timed_ms(detector: YoloDetector, frame: Image) -> list[float]:
    start_s = time.perf_counter()
    detector.fill(frame)
    filled_s = time.perf_counter()
    outputs = detector.infer()
    inferred_s = time.perf_counter()
    detector.decode(outputs)
    done_s = time.perf_counter()
    return [1e3 * (filled_s - start_s), 1e3 * (inferred_s - filled_s), 1e3 * (done_s - inferred_s)]


def _figures(row: _Row) -> dict[str, Any]:
    pre, inference, post = row.median_ms().tolist()
    height, width = row.detector.input_hw
    return {
        "model": row.name,
        "family": row.detector.model.family,
        "threads": row.n_threads,
        "input_hw": [height, width],
        "pre_ms": pre,
        "inference_ms": inference,
        "post_ms": post,
        "total_ms": pre + inference + post,
        "overhead_fraction": (pre + post) / inference,
    }


def _print(figures: list[dict[str, Any]], image_hw: tuple[int, ...]) -> None:
    title = f"Detection of {image_hw[1]} x {image_hw[0]} frames, median ms per frame"
    table = Table(title=title, box=box.SIMPLE_HEAD, padding=0, title_justify="left")
    for heading in ("model", "threads", "input", "pre", "infer.", "post", "total", "(pre+post)\n/infer."):
        table.add_column(heading, no_wrap=True, overflow="fold", justify="left" if heading == "model" else "right")
    for row in figures:
        height, width = row["input_hw"]
        numbers = (f"{row[f'{stage}_ms']:.2f}" for stage in ("pre", "inference", "post", "total"))
        fraction = f"{100 * row['overhead_fraction']:.1f} %"
        table.add_row(row["model"], str(row["threads"]), f"{width}x{height}", *numbers, fraction)
    Console().print(table)
