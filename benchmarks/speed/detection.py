"""Time of each detector at each input size: preprocessing, inference and postprocessing, on one and two threads.

Protocol: the frames of a real drive, decoded beforehand; each model, size and number of threads is a row, and rows
alternate frame by frame, so that variations of the machine affect all alike. Medians over all frames and rounds, ms.
`pre` is resizing, padding and channel order into the network's bound input; `post` is reading the outputs, non-maximum
suppression and conversion to image coordinates. OpenCV uses one thread. Goals: pre + post at most 3 ms per 1242 x 375
frame at 640, and at most 8 % of inference.
"""

from __future__ import annotations

import time
from argparse import Namespace
from itertools import pairwise
from pathlib import Path

import cv2
import numpy as np

from benchmarks.harness import Figures, option, workload
from benchmarks.inputs.drives import REAL_DATA, decoded
from track_range.detection.models.onnx_session import Runtime
from track_range.detection.yolo.detector import YoloDetector, YoloSettings
from track_range.foundation.arrays import Image

SIZES_PX = (320, 416, 640)
"""Input sizes of networks with a dynamic input."""

MODELS = "yolov5n_coco_640 yolov5n_coco_dyn yolov4tiny_voc_416 yolox_nano_416 nanodet_m_416 picodet_s_416".split()


@workload(
    option("--models", default=tuple(REAL_DATA / f"models/{name}.onnx" for name in MODELS), help="ONNX files"),
    option("--video", default=REAL_DATA / "kitti_stereo/0003/left.mp4", help="video with the frames"),
    option("--frames", default=16, help="number of frames, from the first on"),
    option("--rounds", default=3, help="number of passes over the frames"),
    option("--threads", default=(1, 2), help="numbers of threads"),
)
def detection(options: Namespace) -> Figures:
    cv2.setNumThreads(1)
    frames = decoded(options.video, options.frames)
    detectors: dict[str, YoloDetector] = {}
    for n_threads in options.threads:
        for path in options.models:
            for detector in _detectors(path, n_threads):
                height, width = detector.input_hw
                detectors[f"{path.stem} {width}x{height}, {n_threads} threads"] = detector
    for detector in detectors.values():
        detector.detect(frames[0])
    times_ms: dict[str, list[list[float]]] = {name: [] for name in detectors}
    for _ in range(options.rounds):
        for frame in frames:
            for name, detector in detectors.items():
                times_ms[name].append(_timed_ms(detector, frame))
    figures: Figures = {}
    for name, detector in detectors.items():
        pre, inference, post = np.median(times_ms[name], axis=0).tolist()
        times = {"pre_ms": pre, "inference_ms": inference, "post_ms": post, "total_ms": pre + inference + post}
        figures[name] = {"family": detector.model.family, **times, "overhead_fraction": (pre + post) / inference}
    return {"frames": len(frames), "image_hw": list(frames[0].shape[:2]), "detectors": figures}


def _detectors(path: Path, n_threads: int) -> list[YoloDetector]:
    """One detector for a network with a fixed input; for a dynamic one a rectangular and a square one of each size."""
    runtime = Runtime(device="cpu", n_threads=n_threads)
    fixed = YoloDetector(path, runtime=runtime)
    if None not in fixed.session.input_shape[2:]:
        return [fixed]
    settings = [YoloSettings(size_px=size, is_square=square) for size in SIZES_PX for square in (False, True)]
    return [YoloDetector(path, option, runtime=runtime) for option in settings]


def _timed_ms(detector: YoloDetector, frame: Image) -> list[float]:
    """Times of pre, inference and post."""
    times_s = [time.perf_counter()]
    detector.fill(frame)
    times_s.append(time.perf_counter())
    outputs = detector.infer()
    times_s.append(time.perf_counter())
    detector.decode(outputs)
    times_s.append(time.perf_counter())
    return [1e3 * (end_s - start_s) for start_s, end_s in pairwise(times_s)]
