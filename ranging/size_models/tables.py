"""TableSizes: size model with monotonic tables of plain curves, such as Zhang's polynomial of the box diagonal."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Annotated, Any, Literal

import numpy as np
from pydantic import BaseModel, ConfigDict, Field

from track_range.foundation.arrays import FloatArray
from track_range.foundation.validation import Integer, Number
from track_range.ranging.size_models.drive_state import DriveState
from track_range.ranging.size_models.plain_curves import MEASURES, FittedTable
from track_range.ranging.size_models.size_model import SIZE_CLASSES, BoxExtents, Sigma, SizeClass, SizeRanges

KIND = "table"  # value of "kind" in curve files of this model
_MIN_STEP = 1e-9  # smallest difference of successive nodes in log size; the slopes of smaller ones overflow
_STEP = 0.02  # step in log size, to either side, of the numerical slope of a curve


@dataclass(frozen=True, slots=True, kw_only=True)
class TableCurve:
    """The curve of one class."""

    table: FittedTable  # log distance as a function of the log size
    sigma_relative: float  # standard deviation of the relative error on left-out sequences
    n: int  # number of fitted boxes
    source: str  # origin of the curve


_Nodes = Annotated[list[Annotated[Number, Field(ge=-20, le=20)]], Field(min_length=2, max_length=10_000)]
"""Logarithms of the nodes of a table; those of box sizes and distances are within +-10."""


class _ClassTable(BaseModel):
    log_size: _Nodes
    log_distance: _Nodes
    sigma_relative: Sigma
    n: Integer
    source: str


class TableFile(BaseModel):
    """Content of a curve file with tables, by size class."""

    model_config = ConfigDict(extra="ignore", frozen=True)
    measure: Literal["height", "diagonal"]
    classes: dict[SizeClass, _ClassTable]


class TableSizes:
    """Size model with a table per class, all of the same box measure."""

    def __init__(self, measure: str, curves: Mapping[str, TableCurve]) -> None:
        """Create a model from curves by size class, all of the box measure `measure` (a key of `MEASURES`).

        Boxes of other classes are not ranged (NaN).
        """
        self.box_measure = measure
        self.curves = dict(curves)

    def measure(self, boxes: BoxExtents, drive: DriveState | None = None) -> SizeRanges:
        """Distances of the boxes, each ranged separately; NaN if a side is cut and the curves need the width."""
        distance_m, sigma_m, systematic_m = np.full((3, len(boxes)), np.nan)
        usable = boxes.uses_width | (self.box_measure == "height")
        for name, curve in self.curves.items():
            rows = np.flatnonzero((boxes.size_class == SIZE_CLASSES.index(name)) & usable)
            class_boxes = boxes.select(rows)
            distance_m[rows] = curve.table(class_boxes.wh_over_f, class_boxes.bearing)
            systematic_m[rows] = distance_m[rows] * curve.sigma_relative
            noise = (_slopes(curve.table, class_boxes) ** 2 * class_boxes.log_variance).sum(axis=1)
            sigma_m[rows] = np.hypot(systematic_m[rows], distance_m[rows] * np.sqrt(noise))
        return SizeRanges(distance_m, sigma_m, systematic_m)

    def document(self) -> dict[str, Any]:
        """Content of a curve file with this model."""
        classes = {
            name: {
                "log_size": curve.table.log_size.round(5).tolist(),
                "log_distance": curve.table.log_distance.round(5).tolist(),
                "sigma_relative": round(curve.sigma_relative, 4),
                "n": curve.n,
                "source": curve.source,
            }
            for name, curve in self.curves.items()
        }
        return {"kind": KIND, "measure": self.box_measure, "classes": classes}


def _slopes(table: FittedTable, boxes: BoxExtents) -> FloatArray:
    """(N, 2) slopes of log distance in log width and log height."""
    wh, bearing = boxes.wh_over_f, boxes.bearing
    differences = [
        np.log(table(wh * np.exp(step), bearing)) - np.log(table(wh * np.exp(-step), bearing))
        for step in _STEP * np.identity(2)
    ]
    return np.stack(differences, axis=1) / (2 * _STEP)


def tables_in(content: TableFile) -> TableSizes:
    """The model in the content of a curve file; ValueError if a table increases or its lists differ in length."""
    curves = {}
    for name, numbers in content.classes.items():
        log_size, log_distance = np.array(numbers.log_size), np.array(numbers.log_distance)
        is_table = log_size.shape == log_distance.shape
        if not (is_table and (np.diff(log_size) >= _MIN_STEP).all() and (np.diff(log_distance) <= 0).all()):
            raise ValueError(f"{name}: log_size must increase and log_distance must not")
        table = FittedTable(MEASURES[content.measure], log_size, log_distance)
        curves[name] = TableCurve(
            table=table, sigma_relative=numbers.sigma_relative, n=numbers.n, source=numbers.source
        )
    return TableSizes(content.measure, curves)
