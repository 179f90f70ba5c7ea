"""The tables of `evaluate detections`: accuracy and speed, a row per model, and average precision by class."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from detection.classes import ROAD_CLASSES
from track_range.tables import Column, Cost, Grid, figure, grid_of


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
    """One row per model: size, and means over its averaged classes and over those that all models average."""
    rows = list(figures["models"].values())
    columns = [Column("MB", [row["size_mb"] for row in rows], cost=_less)]
    columns += [Column(head, [figure(row, key) for row in rows], scale=100, cost=_more) for head, key in _ACCURACY]
    if len({tuple(row["averaged_classes"]) for row in rows}) > 1:
        common = [figure(row["common"], "ap50") for row in rows]
        columns.append(Column("mAP50 common %", common, scale=100, cost=_more))
    return grid_of(f"Detection, {figures['n_images']} images", "model", list(figures["models"]), columns)


def speed_grid(figures: Mapping[str, Any]) -> Grid:
    """One row per model and input size: median ms per image by stage."""
    columns = [
        Column(head, [figure(row["speed"], key) for row in figures["models"].values()], pattern, cost=cost)
        for head, key, pattern, cost in _SPEED
    ]
    names = [f"{name}, {row['input']}" for name, row in figures["models"].items()]
    return grid_of("Speed per image", "model, input", names, columns)


def class_grid(figures: Mapping[str, Any]) -> Grid:
    """One row per class: how much there is to find, and each model's AP50."""
    models = figures["models"]
    told_of = {name: each for row in models.values() for name, each in row["classes"].items() if each["n_boxes"]}
    names = [name for name in ROAD_CLASSES if name in told_of]
    counts = [told_of[name] for name in names]
    columns = [
        Column("images", [each["n_images"] for each in counts], "{:.0f}"),
        Column("boxes", [each["n_boxes"] for each in counts], "{:.0f}"),
    ]
    for model, row in models.items():
        told = [row["classes"].get(name, {}) for name in names]
        values = [figure(each, "ap50") if each.get("is_known") else None for each in told]
        columns.append(Column(model, values, scale=100))
    return grid_of("AP50 % by class", "class", names, columns)
