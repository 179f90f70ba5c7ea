"""Far road users by the size of the detector's input and with a second pass around the horizon:
recall by distance, precision, errors of the heights, and processor time.

Images are 1920x1080 px: simulated ones, and videos with KITTI labels, such as PandaSet's front
cameras. Counted are whole road users at least half visible; a box is true if its IoU is 0.5 or
more, with a class that detectors confuse with it. Boxes are false that have an IoU below 0.4 with
every label, also of hidden road users; only boxes from 36 px count, since labels end at 25 px.
"""

from __future__ import annotations

import time
from argparse import Namespace
from collections.abc import Callable, Iterator
from functools import partial
from pathlib import Path
from typing import NamedTuple

import cv2
import numpy as np

from benchmarks.harness import Figures, option, workload
from track_range.detection.boxes import iou
from track_range.detection.catalogue.lookup import DEFAULT_MODEL, find_model
from track_range.detection.classes import (
    ROAD_CLASSES,
    SAME_OBJECT_GROUP,
    road_class_id,
    road_class_of,
)
from track_range.detection.detections import Detections
from track_range.detection.formats.video_labels.kitti import KittiLabels, read_kitti
from track_range.detection.models.onnx_session import Runtime
from track_range.detection.yolo.detector import YoloDetector, YoloSettings
from track_range.detection.yolo.far_pass import FarPass
from track_range.foundation.arrays import FloatArray, Image
from track_range.simulation.render.renderer import Renderer, kitti_like_rig
from track_range.simulation.world.scenarios import make_scenario
from track_range.simulation.world.truth import label_scene

_SCENARIOS = ("town", "crossing", "queue", "crossing-adult", "city")
_TIMES_S = (0.0, 2.0, 4.0)  # frames of a simulated drive
_BANDS_M = ((0, 20), (20, 40), (40, 60), (60, 80), (80, 100), (100, 140))
_CLASSES = ("person", "car", "truck")
_LOWEST_PX = 36.0  # height from which boxes count for the precision
_SCORES = (0.1, 0.4)  # of a run, and the usual one from which a track starts
_SIZES: dict[str, int | None] = {"usual": None, "960": 960, "1280": 1280, "1920": 1920}

Detect = Callable[[Image], Detections]


class _Labelled(NamedTuple):
    """An image and its labels; `is_first` = of another video than the last one."""

    image: Image
    labels: KittiLabels
    is_first: bool


@workload(
    option("--video", type=Path, action="append", default=[], help="video, beside simulation"),
    option("--labels", type=Path, action="append", default=[], help="KITTI labels of each video"),
    option("--seed", default=9200, help="first seed of the simulated drives"),
    option("--seeds", default=4, help="number of drives of each of five scenarios; 0 = none"),
    option("--step", default=1, help="every n-th frame of the videos"),
)
def far_pass(options: Namespace) -> Figures:
    """Recall by distance, precision and processor time by the size of the input."""
    sources: dict[str, Callable[[], Iterator[_Labelled]]] = {}
    if options.seeds:
        sources["simulation"] = list(_simulated(options.seed, options.seeds)).__iter__
    for video, labels in zip(options.video, options.labels, strict=True):
        name = f"{video.parent.name}/{video.stem}"  # left.mp4 of several drives
        sources[name] = partial(_recorded, video, labels, options.step)
    return {
        name: {way: _measured(images(), *_opened(way)) for way in (*_SIZES, "far pass")}
        for name, images in sources.items()
    }


def _opened(way: str) -> tuple[YoloDetector, bool]:
    """The detector of a way, and whether a second pass is added."""
    settings = YoloSettings(size_px=_SIZES.get(way))
    path, runtime = find_model(DEFAULT_MODEL).path, Runtime(n_threads=1)
    return YoloDetector(path, settings, runtime=runtime), way == "far pass"


def _simulated(first_seed: int, n_seeds: int) -> Iterator[_Labelled]:
    rig = kitti_like_rig(width_px=1920, height_px=1080)
    for scenario in _SCENARIOS:
        for seed in range(first_seed, first_seed + n_seeds):
            scene = make_scenario(scenario, seed=seed, seconds=_TIMES_S[-1] + 1)
            renderer, labels = Renderer(scene, rig), label_scene(scene, _TIMES_S, camera=rig.left)
            for frame, time_s in enumerate(_TIMES_S):
                yield _Labelled(
                    renderer.render(time_s), labels.select(labels.frame == frame), frame == 0
                )


def _recorded(video: Path, path: Path, step: int) -> Iterator[_Labelled]:
    labels, capture = read_kitti(path), cv2.VideoCapture(str(video))
    frame = 0
    while (read := capture.read())[0]:
        if frame % step == 0:
            yield _Labelled(
                np.asarray(read[1], np.uint8), labels.select(labels.frame == frame), frame == 0
            )
        frame += 1


def _measured(images: Iterator[_Labelled], network: YoloDetector, has_pass: bool) -> Figures:
    """The figures of one way to detect."""
    far_pass, n_images, processor_s = FarPass(network, 1), 0, 0.0
    counted, found = [], []
    for image, labels, is_first in images:
        if is_first:
            far_pass = FarPass(network, 1)
        start_s = time.process_time()
        detections = network.detect(image)
        if has_pass:
            detections = far_pass.completed(detections, image, float(n_images))
        processor_s += time.process_time() - start_s
        n_images += 1
        counted.append(_of_labels(labels, detections))
        found.append(_of_boxes(labels, detections))
    return {
        "ms_per_image": round(1000 * processor_s / n_images, 1),
        "recall": _recall(np.concatenate(counted)),
        "precision": _precision(np.concatenate(found)),
    }


def _of_labels(labels: KittiLabels, detections: Detections) -> FloatArray:
    """(N, 4) class, distance in m, score of the box and log of the ratio of the heights of each
    label that counts; without a box, the score is 0.
    """
    names = [road_class_of(name) or "" for name in labels.kitti_type.tolist()]
    is_counted = np.isin(names, ROAD_CLASSES)
    is_counted &= (labels.occluded <= 1) & (labels.truncated <= 0.02) & labels.has_3d_box
    rows = np.flatnonzero(is_counted)
    class_id = np.array([road_class_id(names[row]) for row in rows], np.int64)
    counted = np.stack([class_id, labels.location_m[rows, 2], *np.zeros((2, len(rows)))], axis=1)
    if not len(detections):
        return counted
    boxes_px = labels.xyxy_px[rows]
    is_same = SAME_OBJECT_GROUP[class_id][:, None] == SAME_OBJECT_GROUP[detections.class_id]
    score = np.where(is_same & (iou(boxes_px, detections.xyxy_px) >= 0.5), detections.score, 0.0)
    best_px = detections.xyxy_px[score.argmax(axis=1)]
    ratio = (best_px[:, 3] - best_px[:, 1]) / (boxes_px[:, 3] - boxes_px[:, 1])
    counted[:, 2], counted[:, 3] = score.max(axis=1), np.log(ratio)
    return counted


def _of_boxes(labels: KittiLabels, detections: Detections) -> FloatArray:
    """(M, 3) class, score, and whether the box is false."""
    is_user = SAME_OBJECT_GROUP[detections.class_id] <= SAME_OBJECT_GROUP[road_class_id("car")]
    height_px = detections.xyxy_px[:, 3] - detections.xyxy_px[:, 1]
    boxes = detections.select(is_user & (height_px >= _LOWEST_PX))
    is_false = iou(boxes.xyxy_px, labels.xyxy_px).max(axis=1, initial=0.0) < 0.4
    return np.stack([boxes.class_id, boxes.score, is_false], axis=1)


def _recall(counted: FloatArray) -> Figures:
    """By class and distance: number, recall at each score, and the scatter of the heights."""
    figures: Figures = {}
    for name in _CLASSES:
        for low_m, high_m in _BANDS_M:
            is_here = (counted[:, 0] == road_class_id(name)) & (counted[:, 1] >= low_m)
            here = counted[is_here & (counted[:, 1] < high_m)]
            if not len(here):
                continue
            log_ratio = here[here[:, 2] > 0, 3]
            figures[f"{name} {low_m}-{high_m} m"] = {
                "n": len(here),
                **{
                    f"at_{score}": round(float((here[:, 2] >= score).mean()), 3)
                    for score in _SCORES
                },
                "log_height": None if len(log_ratio) < 2 else round(float(log_ratio.mean()), 3),
                "sd": None if len(log_ratio) < 2 else round(float(log_ratio.std()), 3),
            }
    return figures


def _precision(found: FloatArray) -> Figures:
    """By class and score: number of boxes, and the fraction that is true."""
    figures: Figures = {}
    for name in _CLASSES:
        for score in _SCORES:
            is_here = (found[:, 0] == road_class_id(name)) & (found[:, 1] >= score)
            if is_here.any():
                true = 1 - found[is_here, 2].mean()
                figures[f"{name} at_{score}"] = {
                    "n": int(is_here.sum()),
                    "fraction": round(float(true), 3),
                }
    return figures
