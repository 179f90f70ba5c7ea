"""Fit of size models by name, to labelled boxes.

cuboids       priors over sizes (`prior_fit.py`), from labels with 3-D boxes
log-linear    one log-linear curve per class (`curve_fit.py`)
others        monotonic plain curves of one box measure (`plain_curves.SAFE_CURVES`); sigma is their error on left-out
              sequences
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

MODEL_NAMES = (CUBOIDS, LOG_LINEAR, *SAFE_CURVES)  # names of the size models that can be fitted
_MIN_SIGMA_RELATIVE = 0.03  # smallest relative standard deviation of a curve

_MIN_HEIGHT_RATIO = 1.3
"""Smallest ratio of the 95th to the 5th percentile of box heights of a class that determines a curve."""


@dataclass(frozen=True, slots=True)
class UsableBoxes:
    """Boxes of classes with enough data for a curve."""

    boxes: BoxSet
    rejected: tuple[str, ...]  # name of and reason for each class that was removed


def usable_boxes(boxes: BoxSet, source: object) -> UsableBoxes:
    """The boxes without classes of fewer than `MIN_SAMPLES` boxes or with boxes of a single size.

    Args:
        boxes: labelled boxes.
        source: file or folder of the labels, for messages.

    Raises:
        CurveError: no class is left.
    """
    rejected, is_usable = [], np.zeros(len(boxes), np.bool_)
    for name in np.unique(boxes.class_name):
        is_class = boxes.class_name == name
        low, high = np.percentile(boxes.wh_over_f[is_class, 1], [5, 95])
        if is_class.sum() < MIN_SAMPLES:
            rejected.append(f"{name} ({is_class.sum()} boxes, at least {MIN_SAMPLES} required)")
        elif high / low < _MIN_HEIGHT_RATIO:
            rejected.append(f"{name} (all boxes of the same size, several distances required)")
        else:
            is_usable |= is_class
    if not is_usable.any():
        reasons = ", ".join(rejected) or "no labelled boxes"
        raise CurveError(f"{source}: too few samples to fit a curve for any class: {reasons}.")
    return UsableBoxes(boxes.select(is_usable), tuple(rejected))


def fit_model(boxes: BoxSet, name: str, *, source: str) -> StoredSizeModel:
    """The model `name`, one of `MODEL_NAMES`, fitted to boxes.

    Raises:
        CurveError: too few boxes, or no 3-D boxes for cuboids.
    """
    if name == CUBOIDS:
        return fit_size_priors(labelled_sizes(boxes), source=source)
    if name == LOG_LINEAR:
        return log_linear(boxes, source=source)
    return table_model(boxes, name, source=source)


def log_linear(boxes: BoxSet, *, source: str) -> SizeCurves:
    """Log-linear curves, with standard sizes for classes without boxes."""
    samples = SizeSamples(boxes.class_name, boxes.sequence, boxes.wh_over_f, boxes.bearing, boxes.distance_m)
    return fit_curves(samples, source=source)


def table_model(boxes: BoxSet, name: str, *, source: str) -> TableSizes:
    """A monotonic plain curve for each class with enough boxes."""
    curves, measure = {}, ""
    class_names = [class_name for class_name in SIZE_CLASSES if (boxes.class_name == class_name).sum() >= MIN_SAMPLES]
    for class_name in class_names:
        samples = boxes.select(boxes.class_name == class_name)
        fitted = SAFE_CURVES[name].fit(samples.wh_over_f, samples.bearing, samples.distance_m)
        if not isinstance(fitted, FittedTable):
            raise TypeError(
                f"{name}: expected a curve that depends on one dimension of the box (height, width or diagonal)"
            )
        measure = fitted.measure.__name__
        sigma = max(_error_on_other_drives(samples, name, fitted), _MIN_SIGMA_RELATIVE)
        curves[class_name] = TableCurve(table=fitted, sigma_relative=sigma, n=len(samples), source=source)
    if not curves:
        raise CurveError(f"expected at least {MIN_SAMPLES} labelled boxes of one class, got fewer.")
    return TableSizes(measure, curves)


def _error_on_other_drives(boxes: BoxSet, name: str, fitted: FittedTable) -> float:
    """Root mean square of the cross-validated relative error; of the fit itself if there is a single sequence."""
    distance_m: FloatArray = fitted.predict(boxes.wh_over_f, boxes.bearing)
    if len(list(folds(boxes))) > 1:
        distance_m = cross_validated(boxes, boxes, plain_fitter(SAFE_CURVES[name])).distance_m
    return float(np.sqrt(np.nanmean((distance_m / boxes.distance_m - 1) ** 2)))
