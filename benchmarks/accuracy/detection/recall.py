"""Recall of detectors trained on real images for simulated cars, as a measure of the realism of the
simulation.
"""

from __future__ import annotations

from argparse import Namespace
from collections.abc import Iterator
from itertools import chain
from pathlib import Path

import numpy as np

from benchmarks.harness import Figures, option, workload
from track_range.detection.boxes import iou
from track_range.detection.catalogue.lookup import DEFAULT_MODEL, find_model
from track_range.detection.classes import ROAD_CLASSES
from track_range.detection.models.onnx_session import Runtime
from track_range.detection.yolo.detector import YoloDetector, YoloSettings
from track_range.foundation.arrays import FloatArray, Image
from track_range.simulation.render.renderer import Renderer, kitti_like_rig
from track_range.simulation.world.scenarios import make_scenario
from track_range.simulation.world.truth import label_scene

SCENARIOS = ("town", "highway", "city", "cut-in", "crossing", "queue", "night")
_TIMES_S = (0.0, 1.1, 2.3, 3.7, 5.2)  # frames of a drive
_MIN_HEIGHT_PX = 30.0
_SCORES = (0.1, 0.25)  # confidence thresholds
_CAR = ROAD_CLASSES.index("car")


@workload(
    option(
        "--model",
        type=Path,
        action="append",
        default=[],
        metavar="FILE",
        help="detector in addition to ours",
    ),
    option("--seeds", default=2, help="number of drives per scenario"),
)
def recall(options: Namespace) -> Figures:
    """Recall of detectors of real images for simulated cars, at least 30 px high and half visible,
    at IoU 0.5.
    """
    runtime = Runtime(n_threads=1)
    models = {
        name: YoloDetector(
            find_model(name).path, YoloSettings(min_score=_SCORES[0]), runtime=runtime
        )
        for name in (DEFAULT_MODEL, *map(str, options.model))
    }
    scores: dict[str, dict[str, list[float]]] = {
        name: {scenario: [] for scenario in SCENARIOS} for name in models
    }
    for scenario in SCENARIOS:
        for image, cars_px in _images(scenario, options.seeds):
            for name, model in models.items():
                detected = model.detect(image)
                is_hit = (iou(cars_px, detected.xyxy_px) >= 0.5) & (detected.class_id == _CAR)
                scores[name][scenario].extend(
                    (is_hit * detected.score).max(axis=1, initial=0.0).tolist()
                )
    return {
        Path(name).name: {"all": _recall(list(chain.from_iterable(by_scenario.values())))}
        | {scenario: _recall(best) for scenario, best in by_scenario.items()}
        for name, by_scenario in scores.items()
    }


def _images(scenario: str, n_seeds: int) -> Iterator[tuple[Image, FloatArray]]:
    """Images, each with the (N, 4) boxes of its cars."""
    rig = kitti_like_rig()
    for seed in range(n_seeds):
        scene = make_scenario(scenario, seed=seed, seconds=6.0)
        renderer, labels = Renderer(scene, rig), label_scene(scene, list(_TIMES_S), camera=rig.left)
        is_high = labels.xyxy_px[:, 3] - labels.xyxy_px[:, 1] > _MIN_HEIGHT_PX
        is_car = is_high & (labels.kitti_type == "Car") & (labels.occluded < 2)
        for frame, time_s in enumerate(_TIMES_S):
            yield renderer.render(time_s), labels.xyxy_px[is_car & (labels.frame == frame)]


def _recall(scores: list[float]) -> dict[str, float]:
    """Number of cars and recall at each threshold, from the confidence of the best detection of
    each car.
    """
    return {"n": len(scores)} | {
        f"at_{threshold}": round(float(np.mean(np.array(scores) >= threshold)), 3)
        for threshold in _SCORES
    }
