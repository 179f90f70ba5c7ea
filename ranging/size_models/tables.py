"""TableSizes: plain curves of one size, such as the paper's polynomial of the diagonal, made safe for use in a run."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np

from track_range.foundation.arrays import FloatArray
from track_range.ranging.size_models.plain_curves import MEASURES, FittedTable
from track_range.ranging.size_models.size_model import SIZE_CLASSES, BoxExtents, SizeRanges

KIND = "table"
_STEP = 0.02  # of the slope by log size, to either side


@dataclass(frozen=True, slots=True, kw_only=True)
class TableCurve:
    """The curve of one class: log distance at log sizes, `sigma_relative` on drives not fitted on, n boxes, source."""

    table: FittedTable
    sigma_relative: float
    n: int
    source: str


class TableSizes:
    """The curves of all classes, all functions of the same size."""

    def __init__(self, measure: str, curves: Mapping[str, TableCurve]) -> None:
        """Curves by size class of `measure` (height or diagonal); a class without one gives NaN."""
        self.measured = measure
        self.curves = dict(curves)

    def measure(self, boxes: BoxExtents) -> SizeRanges:
        """Distances of boxes, each by itself; NaN where a side is cut off and the curve is of the diagonal."""
        distance_m, sigma_m, kept_m = np.full((3, len(boxes)), np.nan)
        seen = boxes.uses_width | (self.measured == "height")
        for name, curve in self.curves.items():
            rows = np.flatnonzero((boxes.size_class == SIZE_CLASSES.index(name)) & seen)
            mine = boxes.select(rows)
            distance_m[rows] = curve.table.predict(mine.wh_over_f, mine.bearing)
            kept_m[rows] = distance_m[rows] * curve.sigma_relative
            noise = (self._slopes(curve.table, mine) ** 2 * mine.log_variance).sum(axis=1)
            sigma_m[rows] = np.hypot(kept_m[rows], distance_m[rows] * np.sqrt(noise))
        return SizeRanges(distance_m, sigma_m, kept_m)

    def _slopes(self, table: FittedTable, boxes: BoxExtents) -> FloatArray:
        """(N, 2) of log distance by log width and log height."""
        found = [
            np.log(table.predict(boxes.wh_over_f * np.exp(step), boxes.bearing))
            - np.log(table.predict(boxes.wh_over_f * np.exp(-step), boxes.bearing))
            for step in _STEP * np.eye(2)
        ]
        return np.stack(found, axis=1) / (2 * _STEP)

    def document(self) -> dict[str, Any]:
        """Content of a curve file of this kind."""
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
        return {"kind": KIND, "measure": self.measured, "classes": classes}


def tables_in(document: Mapping[str, Any]) -> TableSizes:
    """The curves of a file's content.

    Raises:
        ValueError, KeyError, TypeError, AttributeError: an unknown class or size, or a table that does not fall.
    """
    curves = {}
    for name, numbers in document["classes"].items():
        if name not in SIZE_CLASSES:
            raise ValueError(f"unknown size class {name}")
        log_size, log_distance = (np.array(numbers[key], np.float64) for key in ("log_size", "log_distance"))
        falls = log_size.shape == log_distance.shape == (len(log_size),) and len(log_size) >= 2
        if not (falls and (np.diff(log_size) > 0).all() and (np.diff(log_distance) <= 0).all()):
            raise ValueError(f"{name}: log_size must increase and log_distance must not")
        sigma = float(numbers["sigma_relative"])
        if not sigma > 0:
            raise ValueError(f"{name}: sigma_relative must be positive")
        table = FittedTable(MEASURES[document["measure"]], log_size, log_distance)
        curves[name] = TableCurve(table=table, sigma_relative=sigma, n=int(numbers["n"]), source=str(numbers["source"]))
    return TableSizes(document["measure"], curves)
