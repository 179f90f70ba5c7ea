"""Tables of `track-range evaluate detections`: accuracy and speed per model, and average precision by class."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from track_range.detection.classes import ROAD_CLASSES
from track_range.report.tables import Column, Cost, Grid, figure, grid_of


def _more(value: float) -> float:
    return -value


def _less(value: float) -> float:
    return value


_ACCURACY: tuple[tuple[str, str], ...] = (
    ("mAP50 %", "ap50"),
    ("mAP50-95 %", "ap50_95"),
    ("precision %", "precision"),
    ("recall %", "recall"),
)
_SPEED: tuple[tuple[str, str, str, Cost], ...] = (
    ("pre ms", "pre_ms", "{:.2f}", _less),
    ("inference ms", "inference_ms", "{:.1f}", _less),
    ("post ms", "post_ms", "{:.2f}", _less),
    ("total ms", "total_ms", "{:.1f}", _less),
    ("fps", "fps", "{:.1f}", _more),
)


def accuracy_grid(figures: Mapping[str, Any]) -> Grid:
    """One row per model: file size, and means over its averaged classes and the classes averaged for all models."""
    rows = list(figures["models"].values())
    columns = [Column("MB", [row["size_mb"] for row in rows], cost=_less)]
    columns += [Column(head, [figure(row, key) for row in rows], scale=100, cost=_more) for head, key in _ACCURACY]
    if len({tuple(row["averaged_classes"]) for row in rows}) > 1:
        common = [figure(row["common"], "ap50") for row in rows]
        columns.append(Column("mAP50 common %", common, scale=100, cost=_more))
    return grid_of(f"Detection, {figures['n_images']} images", "model", list(figures["models"]), columns)


def speed_grid(figures: Mapping[str, Any]) -> Grid:
    """One row per model with its input size: median time per image of each stage, in ms."""
    columns = [
        Column(head, [figure(row["speed"], key) for row in figures["models"].values()], pattern, cost=cost)
        for head, key, pattern, cost in _SPEED
    ]
    names = [f"{name}, {row['input']}" for name, row in figures["models"].items()]
    return grid_of("Speed per image", "model, input", names, columns)


def class_grid(figures: Mapping[str, Any]) -> Grid:
    """One row per class: labelled images and boxes, and AP50 of each model, or all metrics of a single model."""
    models = figures["models"]
    by_name = (item for row in models.values() for item in row["classes"].items())
    labelled = {name: scores for name, scores in by_name if scores["n_boxes"]}
    names = [name for name in ROAD_CLASSES if name in labelled]
    columns = [
        Column("images", [labelled[name]["n_images"] for name in names], "{:.0f}"),
        Column("boxes", [labelled[name]["n_boxes"] for name in names], "{:.0f}"),
    ]
    for model, row in models.items():
        by_class = [row["classes"].get(name, {}) for name in names]
        known = [scores if scores.get("is_known") else {} for scores in by_class]
        if len(models) > 1:
            columns.append(Column(model, [figure(scores, "ap50") for scores in known], scale=100))
        else:
            columns += [
                Column(head.removeprefix("m"), [figure(scores, key) for scores in known], scale=100)
                for head, key in _ACCURACY
            ]
    return grid_of("AP50 % by class" if len(models) > 1 else "By class", "class", names, columns)
