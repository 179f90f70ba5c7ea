"""Comparison of all plain curves on the boxes of a class (Zhang et al., Table 3), and their error on other drives.

residual sum of squares = sum (d_fitted - d)^2 over the fitted boxes (Zhang et al., eq. 3 and Table 3)
cross-validated error   = mean |d_fitted - d| / d, with each sequence measured by a curve fitted to other sequences
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from track_range.foundation.arrays import FloatArray
from track_range.ranging.evaluation.box_evaluation import cross_validated, folds
from track_range.ranging.evaluation.box_methods import plain_fitter
from track_range.ranging.fitting.labelled_boxes import BoxSet
from track_range.ranging.size_models.plain_curves import PLAIN_CURVES, Curve

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
    predict: Curve


def compare_curves(boxes: BoxSet, class_name: str) -> list[CurveFit]:
    """All plain curves, fitted to the boxes of one class."""
    boxes = boxes.select(boxes.class_name == class_name)
    true_m, fits = boxes.distance_m, []

    def error_pct(distance_m: FloatArray) -> float:
        return float(100 * np.nanmean(np.abs(distance_m / true_m - 1)))

    for name, fitter in PLAIN_CURVES.items():
        curve = fitter(boxes.wh_over_f, boxes.bearing, true_m)
        distance_m = curve(boxes.wh_over_f, boxes.bearing)
        has_folds = len(list(folds(boxes))) > 1
        near = [distance_m[np.abs(true_m / row_m - 1) < _NEAR] for row_m in TABLE_DISTANCES_M]
        fits.append(
            CurveFit(
                class_name=class_name,
                curve=name,
                n=len(boxes),
                residual_m2=float(((distance_m - true_m) ** 2).sum()),
                fitted_error_pct=error_pct(distance_m),
                other_drives_error_pct=error_pct(cross_validated(boxes, boxes, plain_fitter(fitter)).distance_m)
                if has_folds
                else np.nan,
                at_m=tuple(float(values.mean()) if len(values) else np.nan for values in near),
                predict=curve,
            )
        )
    return fits
