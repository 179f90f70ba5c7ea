"""Fitting, by name, every model of sizes that a run can use, on labelled boxes.

cuboids       priors over sizes (`prior_fit.py`): wants labels with 3-D boxes
log-linear    one curve per class (`curve_fit.py`)
the others    plain curves of one size, made safe (`plain_curves.SAFE_CURVES`); their sigma is the error that they
              make on sequences that they are not fitted on
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from track_range.foundation.arrays import FloatArray
from track_range.ranging.evaluation.box_evaluation import cross_validated, folds
from track_range.ranging.evaluation.box_methods import labelled_sizes, plain_fitter
from track_range.ranging.fitting.curve_fit import MIN_SAMPLES, SizeSamples, fit_curves
from track_range.ranging.fitting.labelled_boxes import BoxSet
from track_range.ranging.fitting.prior_fit import fit_size_priors
from track_range.ranging.size_models.curve import CurveError
from track_range.ranging.size_models.log_linear import SizeCurves
from track_range.ranging.size_models.plain_curves import SAFE_CURVES, FittedTable
from track_range.ranging.size_models.size_model import SIZE_CLASSES, StoredSizeModel
from track_range.ranging.size_models.tables import TableCurve, TableSizes

CUBOIDS, LOG_LINEAR = "cuboids", "log-linear"

MODEL_NAMES = (CUBOIDS, LOG_LINEAR, *SAFE_CURVES)
"""What can be fitted."""

_MIN_SIGMA_RELATIVE = 0.03
_MIN_SPREAD = 1.3
"""Smallest ratio of a class's 95th and 5th percentile of height that tells a curve from a point."""


@dataclass(frozen=True, slots=True)
class UsableBoxes:
    """Boxes of the classes that a curve can be fitted on, and a phrase on each class that has too little for it."""

    boxes: BoxSet
    refused: tuple[str, ...]


def usable_boxes(boxes: BoxSet) -> UsableBoxes:
    """Without classes of fewer than `MIN_SAMPLES` boxes, or of one size throughout.

    Raises:
        CurveError: no class is left.
    """
    refused, good = [], np.zeros(len(boxes), np.bool_)
    for name in np.unique(boxes.class_name):
        mine = boxes.class_name == name
        low, high = np.percentile(boxes.wh_over_f[mine, 1], [5, 95])
        if mine.sum() < MIN_SAMPLES:
            refused.append(f"{name} ({mine.sum()} boxes, at least {MIN_SAMPLES} required)")
        elif high / low < _MIN_SPREAD:
            refused.append(f"{name} (all boxes of the same size, several distances required)")
        else:
            good |= mine
    if not good.any():
        raise CurveError(f"too few samples to fit a curve for any class: {', '.join(refused) or 'no labelled boxes'}.")
    return UsableBoxes(boxes.select(good), tuple(refused))


def fit_model(boxes: BoxSet, name: str, *, source: str) -> StoredSizeModel:
    """The model `name` (of `MODEL_NAMES`) fitted on boxes.

    Raises:
        CurveError: too few of them, or no 3-D boxes for cuboids.
    """
    if name == CUBOIDS:
        return fit_size_priors(labelled_sizes(boxes), source=source)
    if name == LOG_LINEAR:
        return log_linear(boxes, source=source)
    return table_model(boxes, name, source=source)


def log_linear(boxes: BoxSet, *, source: str) -> SizeCurves:
    """Log-linear curves, and standard sizes for classes that the boxes do not have."""
    samples = SizeSamples(boxes.class_name, boxes.sequence, boxes.wh_over_f, boxes.bearing, boxes.distance_m)
    return fit_curves(samples, source=source)


def table_model(boxes: BoxSet, name: str, *, source: str) -> TableSizes:
    """A safe plain curve per class with enough boxes."""
    curves, measure = {}, ""
    for kind in (kind for kind in SIZE_CLASSES if (boxes.class_name == kind).sum() >= MIN_SAMPLES):
        mine = boxes.select(boxes.class_name == kind)
        fitted = SAFE_CURVES[name].fit(mine.wh_over_f, mine.bearing, mine.distance_m)
        if not isinstance(fitted, FittedTable):
            raise TypeError(f"{name}: expected a curve of one box measure")
        measure = fitted.measure.__name__
        sigma = max(_error_on_other_drives(mine, name, fitted), _MIN_SIGMA_RELATIVE)
        curves[kind] = TableCurve(table=fitted, sigma_relative=sigma, n=len(mine), source=source)
    if not curves:
        raise CurveError(f"expected at least {MIN_SAMPLES} labelled boxes of one class, got fewer.")
    return TableSizes(measure, curves)


def _error_on_other_drives(boxes: BoxSet, name: str, fitted: FittedTable) -> float:
    """Root mean square of the relative error, leaving sequences out; where there is one, of the fit itself."""
    distance_m: FloatArray = fitted.predict(boxes.wh_over_f, boxes.bearing)
    if len(list(folds(boxes))) > 1:
        distance_m = cross_validated(boxes, boxes, plain_fitter(SAFE_CURVES[name])).distance_m
    return float(np.sqrt(np.nanmean((distance_m / boxes.distance_m - 1) ** 2)))
