"""fit_sizes: fit of a size model to a user's labels, and the comparison of plain curves (Zhang et al.).

cuboids       priors over sizes (`prior_fit`), from labels with 3-D boxes
log-linear    one log-linear curve per class (`curve_fit`)
others        monotonic plain curves of one box measure (`plain_curves.SAFE_CURVES`); sigma is their error on left-out
              sequences

The comparison fits all plain curves to the boxes of a class (Zhang et al., Table 3):

residual sum of squares = sum (d_fitted - d)^2 over the fitted boxes (Zhang et al., eq. 3 and Table 3)
cross-validated error   = mean |d_fitted - d| / d, with each sequence measured by a curve fitted to other sequences
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from track_range.detection.formats.tables.errors import LabelFileError
from track_range.foundation.arrays import FloatArray
from track_range.foundation.errors import UsageError
from track_range.ranging.fitting.cross_validation import cross_validated, folds, plain_fitter
from track_range.ranging.fitting.curve_fit import MIN_SAMPLES, fit_curves
from track_range.ranging.fitting.prior_fit import fit_size_priors
from track_range.ranging.fitting.settings import FitSettings
from track_range.ranging.size_models.curve import CurveError, save_curves
from track_range.ranging.size_models.plain_curves import (
    PLAIN_CURVES,
    SAFE_CURVES,
    Curve,
    TableCurve,
    TableSizes,
)
from track_range.ranging.size_models.size_model import SIZE_CLASSES, StoredSizeModel
from track_range.ranging.truth.box_files import read_box_csv, read_box_labels
from track_range.ranging.truth.labelled_boxes import BoxSet, box_set

CUBOIDS, LOG_LINEAR = "cuboids", "log-linear"

MODEL_NAMES = (CUBOIDS, LOG_LINEAR, *SAFE_CURVES)  # names of the size models that can be fitted
# distances in m of the rows of Table 3 of Zhang et al.
TABLE_DISTANCES_M = (20.0, 30.0, 40.0, 60.0, 90.0)
# largest relative difference between a box's distance and that of the row in which it is averaged
_NEAR = 0.05
_MIN_SIGMA_RELATIVE = 0.03  # smallest relative standard deviation of a curve
# of the 95th to the 5th percentile of the box heights of a class that determines a curve
_MIN_HEIGHT_RATIO = 1.3


@dataclass(frozen=True, slots=True)
class CurveFit:
    """One curve fitted to the boxes of one class."""

    class_name: str
    curve: str
    n: int  # number of boxes
    residual_m2: float  # residual sum of squares over the fitted boxes
    fitted_error_pct: float  # mean relative error over the fitted boxes
    # mean relative error, cross-validated by sequence; NaN = one sequence only
    other_drives_error_pct: float
    # mean fitted distance of the boxes near each of `TABLE_DISTANCES_M`; NaN = no boxes
    at_m: tuple[float, ...]
    predict: Curve


@dataclass(frozen=True, slots=True)
class FittedSizes:
    """Result of `fit_sizes`."""

    boxes: BoxSet
    name: str  # name of the model, one of `MODEL_NAMES`
    model: StoredSizeModel | None  # the fitted model; None = comparison only
    comparison: Mapping[str, Sequence[CurveFit]]  # the plain curves by class; empty = no comparison
    notes: tuple[str, ...]


def fit_sizes(settings: FitSettings) -> FittedSizes:
    """Fit a size model to labelled boxes, and write it to `settings.out`, if given.

    Raises LabelFileError, RigError, CurveError: labels or calibration cannot be used, or there are
    too few labels; UsageError: settings that contradict each other.
    """
    _check(settings)
    boxes, notes = _boxes(settings)
    boxes, too_few = _usable_boxes(boxes, settings.labels or settings.csv)
    comparison = {}
    if settings.compare or settings.picture is not None:
        comparison = {
            str(name): compare_curves(boxes, str(name)) for name in np.unique(boxes.class_name)
        }
    name = settings.curve or (CUBOIDS if settings.calib else LOG_LINEAR)
    model = None
    if settings.out is not None:
        model = _fit_model(boxes, name, source=_source(settings, boxes))
        save_curves(model, settings.out)
    rejected = (f"Too few samples to fit a curve for {reason}." for reason in too_few)
    return FittedSizes(boxes, name, model, comparison, (*notes, *rejected))


def _check(settings: FitSettings) -> None:
    if (settings.labels is None) == (settings.csv is None):
        raise UsageError("expected either --labels and --calib, or --csv.")
    if settings.labels is not None and settings.calib is None and not settings.labels.is_file():
        raise UsageError(
            "--labels requires --calib, the folder of calibration files with the focal lengths."
        )
    if settings.out is None and not settings.compare and settings.picture is None:
        raise UsageError(
            "nothing to do; give --out FILE to write a curve file, --compare or --picture."
        )
    if settings.curve is not None and settings.curve not in MODEL_NAMES:
        raise UsageError(f"--curve {settings.curve}: expected one of {', '.join(MODEL_NAMES)}.")
    if settings.calib is None and settings.curve == CUBOIDS:
        raise UsageError(
            "--curve cuboids requires KITTI labels with 3-D boxes (--labels); other "
            "files have none."
        )


def _boxes(settings: FitSettings) -> tuple[BoxSet, tuple[str, ...]]:
    if settings.csv is not None:
        boxes, notes = read_box_csv(settings.csv, focal_px=settings.focal_px)
    elif settings.labels is None:
        raise UsageError("expected either --labels and --calib, or --csv.")
    elif settings.calib is not None:
        boxes, notes = box_set(settings.labels, settings.calib), ()
    else:
        boxes, notes = read_box_labels(settings.labels, focal_px=settings.focal_px)
    excluded = set(settings.leave_out) - {""}
    unknown = excluded - set(boxes.sequence_names)
    if unknown:  # an error, since a misspelt name would put test sequences into the fit
        raise LabelFileError(
            f"{settings.labels or settings.csv}: --leave-out names unknown sequences: "
            f"{', '.join(sorted(unknown))}."
        )
    is_excluded = np.array([name in excluded for name in boxes.sequence_names])[boxes.sequence]
    return boxes.select(~is_excluded), notes


def _source(settings: FitSettings, boxes: BoxSet) -> str:
    path = settings.labels or settings.csv
    used = ", ".join(boxes.sequence_names[k] or "one" for k in np.unique(boxes.sequence))
    return f"{settings.source or (path.name if path else '')}, sequences {used}"


def _usable_boxes(boxes: BoxSet, source: object) -> tuple[BoxSet, list[str]]:
    """Boxes of the classes with at least `MIN_SAMPLES` boxes of several sizes, and why other
    classes are left out.
    """
    rejected, is_usable = list[str](), np.zeros(len(boxes), np.bool_)
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
    return boxes.select(is_usable), rejected


def _fit_model(boxes: BoxSet, name: str, *, source: str) -> StoredSizeModel:
    """The model `name`, one of `MODEL_NAMES`; CurveError if there are too few boxes, or no 3-D
    boxes for cuboids.
    """
    if name == CUBOIDS:
        return fit_size_priors(boxes, source=source)
    if name == LOG_LINEAR:
        return fit_curves(boxes, source=source)
    curves, measure = {}, ""
    for class_name in SIZE_CLASSES:
        samples = boxes.select(boxes.class_name == class_name)
        if len(samples) < MIN_SAMPLES:
            continue
        table = SAFE_CURVES[name](samples.wh_over_f, samples.bearing, samples.distance_m)
        measure = table.measure.__name__
        # The root mean square of the cross-validated relative error; of the fit itself if there is
        # a single sequence.
        if len(list(folds(samples))) > 1:
            distance_m = cross_validated(
                samples, samples, plain_fitter(SAFE_CURVES[name])
            ).distance_m
        else:
            distance_m = table(samples.wh_over_f, samples.bearing)
        error = float(np.sqrt(np.nanmean((distance_m / samples.distance_m - 1) ** 2)))
        sigma = max(error, _MIN_SIGMA_RELATIVE)
        curves[class_name] = TableCurve(
            table=table, sigma_relative=sigma, n=len(samples), source=source
        )
    if not curves:
        raise CurveError(f"expected at least {MIN_SAMPLES} labelled boxes of one class, got fewer.")
    return TableSizes(measure, curves)


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
                other_drives_error_pct=error_pct(
                    cross_validated(boxes, boxes, plain_fitter(fitter)).distance_m
                )
                if has_folds
                else np.nan,
                at_m=tuple(float(values.mean()) if len(values) else np.nan for values in near),
                predict=curve,
            )
        )
    return fits
