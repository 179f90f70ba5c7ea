"""Tables of `track-range evaluate detections`: accuracy by class and size, calibration, speed."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from track_range.detection.classes import ROAD_CLASSES
from track_range.detection.evaluation.matching import SizeMeasure
from track_range.views.tables import (
    Column,
    ColumnSpec,
    Grid,
    columns_of,
    figure,
    grid_of,
    largest,
)

_ACCURACY = (
    ("mAP50 %", "ap50"),
    ("mAP50-95 %", "ap50_95"),
    ("precision %", "precision"),
    ("recall %", "recall"),
)
_CLASS_ACCURACY: tuple[ColumnSpec, ...] = tuple(
    (head.removeprefix("m"), key, "{:.1f}", 100) for head, key in _ACCURACY
)
_SPEED: tuple[ColumnSpec, ...] = (
    ("pre ms", "pre_ms", "{:.2f}", 1, float),
    ("inference ms", "inference_ms", "{:.1f}", 1, float),
    ("post ms", "post_ms", "{:.2f}", 1, float),
    ("total ms", "total_ms", "{:.1f}", 1, float),
    ("fps", "fps", "{:.1f}", 1, largest),
)
_CALIBRATION: tuple[ColumnSpec, ...] = (
    ("detections", "n", "{:.0f}"),
    ("score %", "mean_score", "{:.1f}", 100),
    ("precision %", "precision", "{:.1f}", 100),
    ("ECE %", "ece", "{:.1f}", 100, float),
    ("chance %", "ece_if_calibrated", "{:.1f}", 100),
    ("MCE %", "mce", "{:.1f}", 100, float),
)


def accuracy_grid(figures: Mapping[str, Any]) -> Grid:
    """One row per model: file size, and means over its averaged classes and the classes averaged
    for all models.
    """
    rows = list(figures["models"].values())
    columns = [Column("MB", [row["size_mb"] for row in rows], cost=float)]
    columns += columns_of(rows, ((head, key, "{:.1f}", 100, largest) for head, key in _ACCURACY))
    if len({tuple(row["averaged_classes"]) for row in rows}) > 1:
        common = [row["common"] for row in rows]
        columns += columns_of(common, [("mAP50 common %", "ap50", "{:.1f}", 100, largest)])
    return grid_of(
        f"Detection, {figures['n_images']} images", "model", list(figures["models"]), columns
    )


def speed_grid(figures: Mapping[str, Any]) -> Grid:
    """One row per model with its input size: median time per image of each stage, in ms."""
    models = figures["models"]
    names = [f"{name}, {row['input']}" for name, row in models.items()]
    return grid_of(
        "Speed per image",
        "model, input",
        names,
        columns_of((row["speed"] for row in models.values()), _SPEED),
    )


def class_grid(figures: Mapping[str, Any]) -> Grid:
    """One row per class: labelled images and boxes, and AP50 of each model, or all metrics of a
    single model.
    """
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
        columns += columns_of(
            known, [(model, "ap50", "{:.1f}", 100)] if len(models) > 1 else _CLASS_ACCURACY
        )
    return grid_of("AP50 % by class" if len(models) > 1 else "By class", "class", names, columns)


def size_grids(figures: Mapping[str, Any], measure: SizeMeasure) -> list[Grid]:
    """A table per model with a row per class and bin of areas or heights, and the means over the
    averaged classes.
    """
    grids = []
    for model, model_figures in figures["models"].items():
        bins = model_figures["by_size"][measure]
        rows = {
            f"{name}, {one['name']}": scores
            for name in ROAD_CLASSES
            for one in bins
            if (scores := one["classes"].get(name, {})).get("n_boxes")
        }
        rows |= {f"mean, {one['name']}": one for one in bins if one["averaged_classes"]}
        columns = [Column("boxes", [row["n_boxes"] for row in rows.values()], "{:.0f}")]
        columns += columns_of(
            rows.values(), (spec for spec in _CLASS_ACCURACY if spec[1] != "precision")
        )
        title = f"{model}: by {measure} of the box in the image"
        grids.append(grid_of(title, f"class, {measure}", list(rows), columns))
    return grids


def calibration_grids(figures: Mapping[str, Any]) -> list[Grid]:
    """Calibration of each model over all classes, and by class: ECE of each model, or all metrics
    of a single model.

    "score" is the mean score; "chance" the ECE expected of calibrated scores in the same number.
    """
    models = {name: row["calibration"] for name, row in figures["models"].items()}
    classes = [
        name for name in ROAD_CLASSES if any(name in row["classes"] for row in models.values())
    ]
    title = "Calibration of scores"
    if len(models) == 1:
        (row,) = models.values()
        rows = {"all": row["all"], **{name: row["classes"][name] for name in classes}}
        unmarked = (spec[:4] for spec in _CALIBRATION)
        return [grid_of(title, "class", list(rows), columns_of(rows.values(), unmarked))]
    columns = [
        Column(name, [figure(row["classes"].get(c, {}), "ece") for c in classes], scale=100)
        for name, row in models.items()
    ]
    return [
        grid_of(
            title,
            "model",
            list(models),
            columns_of((row["all"] for row in models.values()), _CALIBRATION),
        ),
        grid_of("ECE % by class", "class", classes, columns),
    ]
