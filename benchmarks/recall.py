"""Share of simulated cars that detectors of real roads find: how real the simulation looks to them."""

from __future__ import annotations

from argparse import ArgumentParser, Namespace
from collections.abc import Iterator
from itertools import chain
from pathlib import Path

import numpy as np
from rich.console import Console
from rich.table import Table

from track_range.detection.boxes import iou
from track_range.detection.classes import ROAD_CLASSES
from track_range.detection.models.lookup import DEFAULT_MODEL, find_model
from track_range.detection.models.onnx_session import Runtime
from track_range.detection.yolo.detector import YoloDetector, YoloSettings
from track_range.foundation.arrays import FloatArray, Image
from track_range.simulation.render.renderer import Renderer, kitti_like_rig
from track_range.simulation.world.scenarios import make_scenario
from track_range.simulation.world.truth import label_scene

SCENARIOS = ("town", "highway", "city", "cut-in", "crossing", "queue", "night")
_TIMES_S = (0.0, 1.1, 2.3, 3.7, 5.2)
_MIN_HEIGHT_PX = 30.0
_SCORES = (0.1, 0.25)
_CAR = ROAD_CLASSES.index("car")


def add_options(parser: ArgumentParser) -> None:
    """Options of the workload."""
    parser.add_argument(
        "--model", type=Path, action="append", default=[], metavar="FILE", help="beside the packaged one"
    )
    parser.add_argument("--seeds", type=int, default=2, metavar="N")


def measure(options: Namespace) -> dict[str, object]:
    """Recall of cars over 30 px high, at least half visible, at IoU 0.5 and the right class, per model and scenario."""
    words = (DEFAULT_MODEL, *map(str, options.model))
    runtime = Runtime(n_threads=1)
    models = {
        word: YoloDetector(find_model(word).path, YoloSettings(min_score=_SCORES[0]), runtime=runtime) for word in words
    }
    best: dict[str, dict[str, list[float]]] = {word: {name: [] for name in SCENARIOS} for word in words}
    for name in SCENARIOS:
        for image, cars_px in _pictures(name, options.seeds):
            for word, model in models.items():
                found = model.detect(image)
                hit = (iou(cars_px, found.xyxy_px) >= 0.5) & (found.class_id == _CAR)
                best[word][name].extend((hit * found.score).max(axis=1, initial=0.0).tolist())
    figures = {
        word: {"all": _recall(list(chain.from_iterable(each.values())))} | {n: _recall(s) for n, s in each.items()}
        for word, each in best.items()
    }
    _tell(figures)
    return {"recall": figures}


def _pictures(name: str, n_seeds: int) -> Iterator[tuple[Image, FloatArray]]:
    rig = kitti_like_rig()
    for seed in range(n_seeds):
        scene = make_scenario(name, seed=seed, seconds=6.0)
        renderer, labels = Renderer(scene, rig), label_scene(scene, list(_TIMES_S), camera=rig.left)
        high = labels.xyxy_px[:, 3] - labels.xyxy_px[:, 1] > _MIN_HEIGHT_PX
        cars = high & (labels.kitti_type == "Car") & (labels.occluded < 2)
        for frame, time_s in enumerate(_TIMES_S):
            yield renderer.render(time_s), labels.xyxy_px[cars & (labels.frame == frame)]


def _recall(scores: list[float]) -> dict[str, float]:
    return {"n": len(scores)} | {
        f"at_{least}": round(float(np.mean(np.array(scores) >= least)), 3) for least in _SCORES
    }


def _tell(figures: dict[str, dict[str, dict[str, float]]]) -> None:
    table = Table("model", "scenario", "cars", *(f"recall at score {least}" for least in _SCORES))
    for word, each in figures.items():
        for name, row in each.items():
            table.add_row(Path(word).name, name, *(f"{value}" for value in row.values()))
    Console().print(table)
