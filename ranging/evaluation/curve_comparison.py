"""Comparison of all plain curves on the boxes of a class (Zhang et al., Table 3), and their error on other drives.

residual sum of squares = sum (d_fitted - d)^2 over the fitted boxes (Zhang et al., eq. 3 and Table 3)
cross-validated error   = mean |d_fitted - d| / d, with each sequence measured by a curve fitted to other sequences
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from track_range.foundation.arrays import BoolArray, FloatArray
from track_range.ranging.evaluation.box_evaluation import cross_validated, folds
from track_range.ranging.evaluation.box_methods import plain_fitter
from track_range.ranging.fitting.labelled_boxes import BoxSet
from track_range.ranging.size_models.plain_curves import PLAIN_CURVES, FittedCurve

TABLE_DISTANCES_M = (20.0, 30.0, 40.0, 60.0, 90.0)  # distances in m of the rows of Table 3 of Zhang et al.
_NEAR = 0.05  # largest relative difference between a box's distance and that of the row in which it is averaged


@dataclass(frozen=True, slots=True)
class CurveFit:
    """One curve fitted to the boxes of one class."""

    class_name: str
    curve: str
    n: int  # number of boxes
    residual_m2: float  # residual sum of squares over the fitted boxes
    fitted_error_pct: float  # mean relative error over the fitted boxes
    other_drives_error_pct: float  # mean relative error, cross-validated by sequence; NaN = one sequence only
    at_m: tuple[float, ...]  # mean fitted distance of the boxes near each of `TABLE_DISTANCES_M`; NaN = no boxes
    predict: Callable[[FloatArray, FloatArray], FloatArray]


def compare_curves(boxes: BoxSet, class_name: str) -> list[CurveFit]:
    """All plain curves, fitted to the boxes of one class."""
    of_class = boxes.select(boxes.class_name == class_name)
    return [_fit(of_class, name) for name in PLAIN_CURVES]


def _fit(boxes: BoxSet, name: str) -> CurveFit:
    fitted: FittedCurve = PLAIN_CURVES[name].fit(boxes.wh_over_f, boxes.bearing, boxes.distance_m)
    distance_m = fitted.predict(boxes.wh_over_f, boxes.bearing)
    has_folds = len(list(folds(boxes))) > 1
    others_m = cross_validated(boxes, boxes, plain_fitter(PLAIN_CURVES[name])).distance_m if has_folds else np.nan
    return CurveFit(
        class_name=str(boxes.class_name[0]),
        curve=name,
        n=len(boxes),
        residual_m2=float(((distance_m - boxes.distance_m) ** 2).sum()),
        fitted_error_pct=_error_pct(distance_m, boxes),
        other_drives_error_pct=_error_pct(others_m, boxes) if has_folds else np.nan,
        at_m=tuple(_mean(distance_m, _is_near(boxes, true_m)) for true_m in TABLE_DISTANCES_M),
        predict=fitted.predict,
    )


def _error_pct(distance_m: FloatArray | float, boxes: BoxSet) -> float:
    return float(100 * np.nanmean(np.abs(distance_m / boxes.distance_m - 1)))


def _is_near(boxes: BoxSet, true_m: float) -> BoolArray:
    return np.asarray(np.abs(boxes.distance_m / true_m - 1) < _NEAR)


def _mean(values: FloatArray, rows: BoolArray) -> float:
    return float(values[rows].mean()) if rows.any() else np.nan
