"""Fit of log-linear size curves to labelled boxes with known distances, and standard sizes for
other classes.

The fit minimises the residuals of log d with a Huber loss. The error on other drives is estimated
by leaving out one sequence at a time: within a sequence the same few vehicles appear in hundreds of
frames, so the residuals of the fit are much smaller.
"""

from collections.abc import Mapping

import numpy as np
from scipy.optimize import least_squares

from track_range.foundation.arrays import FloatArray
from track_range.ranging.size_models.curve import CurveError
from track_range.ranging.size_models.log_linear import SizeCurve, SizeCurves
from track_range.ranging.truth.labelled_boxes import BoxSet

# nearer objects are truncated, farther ones are a few pixels high
NEAREST_M, FARTHEST_M = 5.0, 100.0
# smallest number of boxes of a class for a fit, which requires several objects at several distances
MIN_SAMPLES = 100
_MIN_SIGMA_RELATIVE = 0.03  # smallest relative standard deviation of a curve
# in log height and log width: the distance decreases with size
_SLOPE_BOUNDS = ((-2.0, -0.1), (-1.0, 0.0))
_HUBER_SCALE = 0.1  # residual of log d beyond which the loss is linear: 10 % of the distance
# m, relative sigma and source, without labels
STANDARD_HEIGHTS_M: Mapping[str, tuple[float, float, str]] = {
    "motorcycle": (1.55, 0.15, "a motorcycle with its rider, 1.3-1.8 m"),
    "bus": (3.1, 0.12, "city buses 2.9-3.3 m, coaches up to 3.8 m, minibuses 2.5 m"),
    "traffic light": (
        0.95,
        0.35,
        "three lamps of 200 or 300 mm with housing, 0.8-1.1 m; sometimes 1, 2 or 4 lamps",
    ),
    "traffic sign": (0.70, 0.30, "round and octagonal signs of 600-900 mm"),
}


def fit_curves(boxes: BoxSet, *, source: str) -> SizeCurves:
    """Curves of the classes with `MIN_SAMPLES` boxes (CurveError without any), and of standard
    sizes otherwise.
    """
    names, counts = np.unique(boxes.class_name, return_counts=True)
    fitted = [str(name) for name, count in zip(names, counts, strict=True) if count >= MIN_SAMPLES]
    if not fitted:
        available = ", ".join(f"{n} {c}" for n, c in zip(names, counts, strict=True)) or "none"
        raise CurveError(
            f"expected at least {MIN_SAMPLES} labelled boxes of one class, got {available}."
        )
    standard = {name: _standard_curve(name) for name in STANDARD_HEIGHTS_M if name not in fitted}
    whole, height_only = (
        {
            name: _fit_class(
                boxes.select(boxes.class_name == name), use_width=use_width, source=source
            )
            for name in fitted
        }
        for use_width in (True, False)
    )
    return SizeCurves({**whole, **standard}, {**height_only, **standard})


def leave_one_out_error(boxes: BoxSet, *, use_width: bool) -> FloatArray:
    """(N,) relative errors of samples of one class, by curves fitted to the other sequences; NaN =
    no curve.
    """
    error = np.full(len(boxes), np.nan)
    for sequence in np.unique(boxes.sequence):
        left_out = boxes.sequence == sequence
        if (~left_out).any():
            solution = _solve(boxes.select(~left_out), use_width=use_width)
            test = boxes.select(left_out)
            error[left_out] = (
                np.exp(_design(test, use_width=use_width) @ solution) / test.distance_m - 1
            )
    return error


def _fit_class(boxes: BoxSet, *, use_width: bool, source: str) -> SizeCurve:
    solution = _solve(boxes, use_width=use_width)
    error = leave_one_out_error(boxes, use_width=use_width)
    if not np.isfinite(error).any():  # a single sequence has only the residuals of the fit
        error = np.exp(_design(boxes, use_width=use_width) @ solution) / boxes.distance_m - 1
    intercept, per_log_height, *rest = (float(value) for value in solution)
    per_log_width, per_bearing = rest if use_width else (0.0, rest[0])
    return SizeCurve(
        intercept=round(intercept, 5),
        per_log_height=round(per_log_height, 5),
        per_log_width=round(per_log_width, 5),
        per_bearing=round(per_bearing, 5),
        sigma_relative=round(max(float(np.sqrt(np.nanmean(error**2))), _MIN_SIGMA_RELATIVE), 4),
        n=len(boxes),
        source=source,
    )


def _standard_curve(name: str) -> SizeCurve:
    height_m, sigma_relative, source = STANDARD_HEIGHTS_M[name]
    return SizeCurve(
        intercept=round(float(np.log(height_m)), 5),
        per_log_height=-1.0,
        per_log_width=0.0,
        per_bearing=0.0,
        sigma_relative=sigma_relative,
        n=0,
        source=f"standard size, not fitted: {source}",
    )


def _design(boxes: BoxSet, *, use_width: bool) -> FloatArray:
    """(N, 3 or 4) design matrix: 1, log height, log width if used, |tan bearing|."""
    log_w, log_h = np.log(boxes.wh_over_f).T
    columns = [np.ones_like(log_h), log_h, *([log_w] if use_width else []), np.abs(boxes.bearing)]
    return np.stack(columns, axis=1)


def _solve(boxes: BoxSet, *, use_width: bool) -> FloatArray:
    """(3 or 4,) coefficients of the Huber fit within `_SLOPE_BOUNDS`, which few objects do not
    determine well.
    """
    design, log_distance = _design(boxes, use_width=use_width), np.log(boxes.distance_m)
    free = (-np.inf, np.inf)
    low, high = np.array([free, *_SLOPE_BOUNDS[: 2 if use_width else 1], free]).T
    start = np.array([0.0, -1.0, *([-0.1] if use_width else []), 0.0])

    def residual(x: FloatArray) -> FloatArray:
        return np.asarray(design @ x - log_distance)

    result = least_squares(residual, start, bounds=(low, high), loss="huber", f_scale=_HUBER_SCALE)
    return np.asarray(result.x)
