"""Tables of `track-range evaluate detections`: accuracy by class and size, calibration, speed."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

from track_range.detection.classes import ROAD_CLASSES
from track_range.detection.evaluation.matching import SizeMeasure
from track_range.views.report.tables import Column, Cost, Grid, figure, grid_of


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


def size_grids(figures: Mapping[str, Any], measure: SizeMeasure) -> list[Grid]:
    """A table per model with a row per class and bin of sizes, and the means over the averaged classes.

    Args:
        figures: results.
        measure: "area" or "height", the measure of the bins.
    """
    return [_size_grid(name, row["by_size"][measure], measure) for name, row in figures["models"].items()]


def _size_grid(model: str, bins: Sequence[Mapping[str, Any]], measure: SizeMeasure) -> Grid:
    rows = {
        f"{name}, {one['name']}": scores
        for name in ROAD_CLASSES
        for one in bins
        if (scores := one["classes"].get(name, {})).get("n_boxes")
    }
    rows |= {f"mean, {one['name']}": one for one in bins if one["averaged_classes"]}
    columns = [Column("boxes", [row["n_boxes"] for row in rows.values()], "{:.0f}")]
    columns += [
        Column(head.removeprefix("m"), [figure(row, key) for row in rows.values()], scale=100)
        for head, key in _ACCURACY
        if key != "precision"
    ]
    return grid_of(f"{model}: by {measure} of the box in the image", f"class, {measure}", list(rows), columns)


_CALIBRATION: tuple[tuple[str, str, str, float, Cost | None], ...] = (
    ("detections", "n", "{:.0f}", 1.0, None),
    ("score %", "mean_score", "{:.1f}", 100.0, None),
    ("precision %", "precision", "{:.1f}", 100.0, None),
    ("ECE %", "ece", "{:.1f}", 100.0, _less),
    ("chance %", "ece_if_calibrated", "{:.1f}", 100.0, None),
    ("MCE %", "mce", "{:.1f}", 100.0, _less),
)
"""Heading, key, format, scale and cost of each column of a table of calibration."""


def calibration_grids(figures: Mapping[str, Any]) -> list[Grid]:
    """Calibration of each model over all classes, and by class: the ECE of each model, or all metrics of a single one.

    "score" is the mean score; "chance" the ECE expected of calibrated scores in the same number.
    """
    models = {name: row["calibration"] for name, row in figures["models"].items()}
    classes = [name for name in ROAD_CLASSES if any(name in row["classes"] for row in models.values())]
    title = "Calibration of scores"
    if len(models) == 1:
        (row,) = models.values()
        return [_calibration_grid(title, "class", {"all": row["all"], **{c: row["classes"][c] for c in classes}})]
    columns = [
        Column(name, [figure(row["classes"].get(c, {}), "ece") for c in classes], scale=100)
        for name, row in models.items()
    ]
    return [
        _calibration_grid(title, "model", {name: row["all"] for name, row in models.items()}),
        grid_of("ECE % by class", "class", classes, columns),
    ]


def _calibration_grid(title: str, corner: str, rows: Mapping[str, Mapping[str, Any]]) -> Grid:
    columns = [
        Column(head, [figure(row, key) for row in rows.values()], pattern, scale, cost if corner == "model" else None)
        for head, key, pattern, scale, cost in _CALIBRATION
    ]
    return grid_of(title, corner, list(rows), columns)
