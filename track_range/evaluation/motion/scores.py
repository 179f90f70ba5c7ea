"""Scores of measured motion: closing speed, speed over ground, time to collision, warnings.

An answer is a closing speed with a sigma below 1.5 m/s; coverage is the fraction of the labels with
a known motion that have an answer. The errors of times to collision T are defined as in TSTTC (Shi
et al., 2023), with measured times clipped to +-20 s, over objects that approach:

    RTE   mean |T - T*| / T*           MiD   10^4 mean |log s - log s*|,  s = T / (T + 0.1 s)       T*: true time

s is the ratio of the object's size 0.1 s before to its size now.
"""

from collections import Counter
from collections.abc import Mapping
from typing import Any

import numpy as np

from track_range.evaluation.motion.labelled_motion import LabelledMotion
from track_range.evaluation.motion.measured_motion import MeasuredMotion
from track_range.evaluation.motion.states import state_figures
from track_range.foundation.arrays import BoolArray, FloatArray, IntArray
from track_range.foundation.bootstrap import Resamples, Statistic, figures_of
from track_range.foundation.poisson import rate_interval
from track_range.ranging.truth.errors import fraction, within_sigmas

BANDS: Mapping[str, tuple[float, float]] = {"10-40": (10.0, 40.0), "40-80": (40.0, 80.0)}  # m
MAX_SIGMA_MPS = 1.5  # largest sigma of an answer
# largest true time to collision that is compared, and the one to which measured ones are clipped
_TTC_LIMIT_S = 20.0
_STEP_S = 0.1  # interval of the size ratio s

_SCALE_ERROR, _CLOSING_ERROR_MPS, _PATH_HALF_WIDTH_M = 0.1, 1.5, 2.0
"""Limits above which each is the cause of a false alarm, in this order: relative error of the
distance, error of the closing speed, and lateral offset at which the object will truly pass."""


def motion_figures(
    truth: LabelledMotion, measured: MeasuredMotion, seed: int | None = None
) -> dict[str, Any]:
    """Figures by distance band, class and time to collision, as JSON values, with a seed also their
    95 % intervals.
    """
    resamples = None if seed is None else resampled_drives(truth, seed)
    compared = quantities(truth, measured)
    return {
        **_by_band_and_class(truth, compared["closing"], resamples),
        "speed": _by_band_and_class(truth, compared["speed"], resamples),
        "states": state_figures(truth, measured),
        "ttc": {
            f"below_{limit}_s": ttc_figures(measured.ttc_s, truth.ttc_s, limit, resamples)
            for limit in (6, 20)
        },
        "warnings": warning_figures(truth, measured),
    }


def quantities(truth: LabelledMotion, measured: MeasuredMotion) -> dict[str, FloatArray]:
    """Values, sigmas and true values (3, N) of the compared quantities in m/s or s, by name; speeds
    with a sigma from 1.5 m/s are no answers, and unknown true values are not compared (NaN).
    """
    sigmas_mps = np.stack([measured.closing_sigma_mps, measured.speed_sigma_mps])
    closing_sigma, speed_sigma = np.where(sigmas_mps < MAX_SIGMA_MPS, sigmas_mps, np.nan)
    true_ttc_s = np.where(between(truth.ttc_s, 0.0, _TTC_LIMIT_S), truth.ttc_s, np.nan)
    return {
        "closing": np.stack([measured.closing_mps, closing_sigma, truth.closing_mps]),
        "speed": np.stack([measured.speed_mps, speed_sigma, truth.speed_mps]),
        "ttc": np.stack([measured.ttc_s, measured.ttc_sigma_s, true_ttc_s]),
    }


def answers(
    values: FloatArray, rows: BoolArray
) -> tuple[dict[str, float | None], FloatArray, FloatArray]:
    """Number and coverage of known true values, of values, sigmas and true values (3, N) in the
    rows (N,); errors (N,) and sigmas (N,) of the answers, NaN elsewhere.
    """
    known = rows & np.isfinite(values[2])
    is_answered = known & np.isfinite(values).all(axis=0)
    value, sigma, true = np.where(is_answered, values, np.nan)
    counts = {"n": int(known.sum()), "coverage": fraction(is_answered[known])}
    return counts, np.abs(value - true), sigma


def resampled_drives(truth: LabelledMotion, seed: int) -> Resamples:
    """Resamples of the drives and their tracks."""
    boxes = truth.boxes
    every = np.ones(len(boxes), np.bool_)
    return Resamples.of(boxes.track_id, drive=boxes.sequence, seed=seed, rows=every)


def between(values: FloatArray, low: float, high: float) -> BoolArray:
    """Whether values are in [low, high)."""
    return np.asarray((values >= low) & (values < high))


def _by_band_and_class(
    truth: LabelledMotion, values: FloatArray, resamples: Resamples | None
) -> dict[str, Any]:
    """`speed_figures` of speeds, sigmas and true speeds (3, N) by distance band, and by class and
    band.
    """
    z, names = truth.boxes.distance_m, truth.boxes.class_name
    in_bands = {band: between(z, *limits) for band, limits in BANDS.items()}
    classes = np.unique(names[np.isfinite(values[2])]).tolist()
    return {
        "bands": {band: speed_figures(values, rows, resamples) for band, rows in in_bands.items()},
        "by_class": {
            name: {
                band: speed_figures(values, rows & (names == name), resamples)
                for band, rows in in_bands.items()
            }
            for name in classes
        },
    }


def speed_figures(
    values: FloatArray, rows: BoolArray, resamples: Resamples | None = None
) -> dict[str, Any]:
    """Coverage and errors of speeds, sigmas and true speeds (3, N) in m/s, in the rows (N,); None
    without values.
    """
    counts, error, sigma_mps = answers(values, rows)
    statistics = {"median_mps": Statistic(error, 0.5), "p95_mps": Statistic(error, 0.95)}
    statistics |= within_sigmas(error / sigma_mps)
    return {**counts, **figures_of(statistics, resamples)}


def ttc_figures(
    ttc_s: FloatArray, true_s: FloatArray, limit_s: float, resamples: Resamples | None = None
) -> dict[str, Any]:
    """Errors of (N,) times to collision where the true time is at most `limit_s`; None without an
    answer.
    """
    known = (true_s > 0) & (true_s <= limit_s)
    rows = known & np.isfinite(ttc_s)
    T = np.where(rows, np.clip(ttc_s, -_TTC_LIMIT_S, _TTC_LIMIT_S), np.nan)
    true = np.where(rows, true_s, np.nan)
    relative = np.abs(T - true) / true
    mid = np.abs(np.log1p(_STEP_S / T) - np.log1p(_STEP_S / true))
    statistics = {
        "median_pct": Statistic(relative, 0.5, 100),
        "rte_pct": Statistic(relative, scale=100),
        "mid": Statistic(mid, scale=1e4),
    }
    counts = {"n": int(rows.sum()), "coverage": fraction(rows[known])}
    return {**counts, **figures_of(statistics, resamples)}


def warning_figures(truth: LabelledMotion, measured: MeasuredMotion) -> dict[str, Any]:
    """Alarms per hour on drives without a contact (each alarm is false) of cameras that look along
    the drive, the time in alarm, and counts by cause.
    """
    first, last = _alarm_spans(truth, measured)
    causes = Counter(_false_alarm_cause(truth, measured, row) for row in first.tolist())
    hours = float(truth.duration_s[truth.are_ahead].sum()) / 3600
    return {
        "hours": round(hours, 4),
        "false_alarms": len(first),
        "per_hour": round(len(first) / hours, 2) if hours else None,
        "per_hour_95": np.round(rate_interval(len(first), hours), 2).tolist() if hours else None,
        "in_alarm_s": round(float((truth.boxes.time_s[last] - truth.boxes.time_s[first]).sum()), 2),
        "by_cause": dict(sorted(causes.items())),
    }


def _alarm_spans(truth: LabelledMotion, measured: MeasuredMotion) -> tuple[IntArray, IntArray]:
    """Row of the first, and of the last, box of each alarm."""
    boxes = truth.boxes
    rows = np.lexsort((boxes.frame, boxes.track_id, boxes.sequence))
    is_on = np.concatenate([[False], measured.is_alarm[rows], [False]])
    key = np.stack([boxes.sequence, boxes.track_id])[:, rows]
    is_same = np.concatenate([[False], (np.diff(key, axis=1) == 0).all(axis=0), [False]])
    starts = is_on[1:-1] & ~(is_on[:-2] & is_same[:-1])
    ends = is_on[1:-1] & ~(is_on[2:] & is_same[1:])
    return rows[starts], rows[ends]


def _false_alarm_cause(truth: LabelledMotion, measured: MeasuredMotion, row: int) -> str:
    """The error when an alarm began: "scale", "box error" (the speed), "wrong path", or else
    "driver" braked.
    """
    true_m, x_m = truth.boxes.distance_m[row], truth.boxes.x_m[row]
    if abs(measured.distance_m[row] / true_m - 1) > _SCALE_ERROR:
        return "scale"
    if not abs(measured.closing_mps[row] - truth.closing_mps[row]) <= _CLOSING_ERROR_MPS:
        return "box error"
    # the ego path at the object, if the yaw rate remains
    ahead_s = true_m / max(truth.ego_mps[row], 2.0)
    offset_m = x_m - true_m * truth.yaw_rad_s[row] * ahead_s / 2
    return "wrong path" if abs(offset_m) > _PATH_HALF_WIDTH_M else "driver"
