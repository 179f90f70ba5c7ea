"""Errors of measured disparities, and of the distances from them: the metrics of stereo matchers.

    Z = f B / d        error = Z / Z_true - 1 = d_true / d - 1

A failure is an object without a value or with an error above 15 % (`wrong_pct`: the latter only).
Intervals are 95 % bootstrap intervals: the errors of objects in one pair (of one track of a drive)
are correlated, so pairs (tracks) are resampled instead of objects. As in
`ranging/truth/errors.py`, `bias_pct` is the median error, and fractions are 0..1; `n` counts
all objects, `n_measured` the measured objects.

Risk-coverage curves are the errors of the boxes that are answered first, in the order of their
uncertainty:

    A = (1 / N) sum_k r(k)      r(k): risk of the k most certain of N boxes

The risk is the fraction of failures, for which boxes without a value come last, or the mean
relative error, over boxes with a value. The uncertainty is the standard deviation relative to the
disparity, or another measure. A small area A means that the errors are small, and that uncertain
boxes have the largest errors. (Geifman and El-Yaniv, "Selective classification for deep neural
networks", NIPS 2017.)
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from track_range.foundation.arrays import BoolArray, FloatArray, IntArray
from track_range.foundation.bootstrap import (
    CI95,
    Resamples,
    Statistic,
    figures_of,
    measured_by_all,
    paired_differences,
)
from track_range.stereo.geometry.alignment import Alignment
from track_range.stereo.geometry.camera import PinholeCamera

BANDS_M = ((5.0, 15.0), (15.0, 30.0), (30.0, 60.0))  # bands of true distance with separate metrics
FAILURE = 0.15  # relative distance error above which a value is a failure
STEP_PCT = 5  # step of the answered fraction along a curve, per cent
# figures of the answered boxes
_KEYS = ("failures_pct", "mean_relative_error_pct", "p95_relative_error_pct")


@dataclass(frozen=True, slots=True)
class MatcherColumn:
    """Results of one matcher for N objects: (N,) disparities and (N,) standard deviations, px; NaN
    = no value.
    """

    disparity_px: FloatArray
    sigma_px: FloatArray

    def select(self, rows: BoolArray | IntArray) -> MatcherColumn:
        """The results of the given rows."""
        return MatcherColumn(self.disparity_px[rows], self.sigma_px[rows])


@dataclass(frozen=True, slots=True)
class Objects:
    """The measured objects with their true disparities."""

    true_px: FloatArray  # (N,) true disparity
    focal_baseline_m: FloatArray  # (N,) f B, px m
    x_px: FloatArray  # (N,) column of the box centre in the left image
    pair: IntArray  # (N,) number of the pair (frame), an index into `cameras`
    group: IntArray  # (N,) group of correlated errors: the pair, or the track of a drive
    cameras: tuple[PinholeCamera, ...]  # rectified left camera of each pair

    def __len__(self) -> int:
        return len(self.true_px)

    @property
    def distance_m(self) -> FloatArray:
        """(N,) true distance."""
        return self.focal_baseline_m / self.true_px

    def select(self, rows: BoolArray | IntArray) -> Objects:
        """The objects of the given rows, with all cameras."""
        parts = {
            name: getattr(self, name)[rows]
            for name in ("true_px", "focal_baseline_m", "x_px", "pair", "group")
        }
        return replace(self, **parts)


def corrected(
    column: MatcherColumn, objects: Objects, alignments: Mapping[int, Alignment]
) -> MatcherColumn:
    """The disparities corrected with the alignment of each pair; disparities <= 0 become NaN."""
    disparity_px, sigma_px = column.disparity_px.copy(), column.sigma_px.copy()
    for number, camera in enumerate(objects.cameras):
        rows = objects.pair == number
        disparity_px[rows], sigma_px[rows] = alignments[number].corrected(
            disparity_px[rows], sigma_px[rows], x_px=objects.x_px[rows], camera=camera
        )
    is_positive = disparity_px > 0
    return MatcherColumn(
        np.where(is_positive, disparity_px, np.nan), np.where(is_positive, sigma_px, np.nan)
    )


def folds(n_pairs: int, *, n_left_out: int = 2) -> list[range]:
    """Folds of `n_left_out` successive pairs; the last fold may be smaller."""
    return [
        range(start, min(start + n_left_out, n_pairs)) for start in range(0, n_pairs, n_left_out)
    ]


# `stereo.alignment.from_reference.fit_reference`, or one with the same parameters
Fit = Callable[..., Alignment]


def left_out_alignments(
    column: MatcherColumn, objects: Objects, fit: Fit, *, seed: int = 0
) -> dict[int, Alignment]:
    """Alignment by pair, each fitted to all pairs outside its fold (cross-validation).

    Raises RigError if too few objects are outside a fold.
    """
    alignments: dict[int, Alignment] = {}
    for fold in folds(len(objects.cameras)):
        rest = ~np.isin(objects.pair, list(fold))
        alignment = fit(
            column.disparity_px[rest],
            objects.true_px[rest],
            x_px=objects.x_px[rest],
            camera=objects.cameras[0],
            groups=objects.group[rest],
            sigma_px=column.sigma_px[rest],
            seed=seed,
        )
        alignments |= dict.fromkeys(fold, alignment)
    return alignments


def matcher_figures(
    columns: Mapping[str, MatcherColumn], objects: Objects, *, seed: int = 0
) -> dict[str, dict[str, Any]]:
    """Metrics of each matcher for all objects, with bands and bootstrap intervals."""
    return {
        name: _figures_with_bands(column, objects, seed=seed) for name, column in columns.items()
    }


def common_figures(
    columns: Mapping[str, MatcherColumn], objects: Objects, *, seed: int = 0
) -> dict[str, dict[str, Any]]:
    """Metrics of each matcher for the objects that all matchers measured, so that no matcher gains
    by rejections.
    """
    is_common = np.all([np.isfinite(column.disparity_px) for column in columns.values()], axis=0)
    common = objects.select(is_common)
    return {
        name: _figures_with_bands(column.select(is_common), common, seed=seed)
        for name, column in columns.items()
    }


def comparison(
    columns: Mapping[str, MatcherColumn], objects: Objects, *, seed: int = 0
) -> dict[str, dict[str, Any]]:
    """Median errors on the objects that all matchers measured, and failures on all objects, with
    the differences from the smallest one; see `paired_differences`.
    """
    everything = np.ones(len(objects), np.bool_)
    measured = {name: column.disparity_px for name, column in columns.items()}
    common, names = measured_by_all(measured, everything)
    statistics = {name: _statistics(column, objects.true_px) for name, column in columns.items()}
    compared = {}
    for key, rows, compared_names in (
        ("median_relative_error_pct", common, names),
        ("failures_pct", everything, tuple(columns)),
    ):
        of_rows = {
            name: replace(
                statistics[name][key], values=np.where(rows, statistics[name][key].values, np.nan)
            )
            for name in compared_names
        }
        resamples = Resamples.of(objects.group, seed=seed, rows=rows)
        compared[key] = {
            "n": len(objects),
            "n_common": int(rows.sum()),
            "n_measured": {name: int(np.isfinite(px).sum()) for name, px in measured.items()},
            **paired_differences(of_rows, resamples, key),
        }
    return compared


def figures(column: MatcherColumn, true_px: FloatArray) -> dict[str, Any]:
    """Metrics of one matcher for objects with true disparities (N,); None where undefined."""
    counts = {
        "n": len(true_px),
        "n_measured": int(np.isfinite(column.disparity_px).sum()),
    }
    return {**counts, **figures_of(_statistics(column, true_px))}


def _statistics(column: MatcherColumn, true_px: FloatArray) -> dict[str, Statistic]:
    """The metrics of one matcher before their average over the objects (N,)."""
    is_measured = np.isfinite(column.disparity_px)
    error = np.where(is_measured, true_px / column.disparity_px - 1, np.nan)
    size, error_px = np.abs(error), np.abs(column.disparity_px - true_px)
    is_wrong = size > FAILURE  # False for NaN
    within = {k: np.where(is_measured, error_px <= k * column.sigma_px, np.nan) for k in (1, 2)}
    return {
        "coverage": Statistic(is_measured.astype(np.float64)),
        "failures_pct": Statistic((~is_measured | is_wrong).astype(np.float64), scale=100),
        "wrong_pct": Statistic(is_wrong.astype(np.float64), scale=100),
        "median_relative_error_pct": Statistic(size, 0.5, 100),
        "mean_relative_error_pct": Statistic(size, scale=100),
        "p95_relative_error_pct": Statistic(size, 0.95, 100),
        "bias_pct": Statistic(error, 0.5, 100),
        "median_abs_error_px": Statistic(error_px, 0.5),
        **{f"within_{k}_sigma": Statistic(values) for k, values in within.items()},
    }


def _figures_with_bands(column: MatcherColumn, objects: Objects, *, seed: int) -> dict[str, Any]:
    bands = []
    for low, high in BANDS_M:
        rows = (objects.distance_m >= low) & (objects.distance_m < high)
        band = figures_with_intervals(column.select(rows), objects.select(rows), seed=seed)
        bands.append({"from_m": low, "to_m": high, **band})
    return {**figures_with_intervals(column, objects, seed=seed), "bands": bands}


def figures_with_intervals(
    column: MatcherColumn, objects: Objects, *, seed: int = 0
) -> dict[str, Any]:
    """Metrics of one matcher with their bootstrap intervals, by resampling groups, as `NAME_ci95`
    and in `intervals` by name; none with fewer than two groups.
    """
    statistics = _statistics(column, objects.true_px)
    resamples = Resamples.of(objects.group, seed=seed, rows=np.ones(len(objects), np.bool_))
    known = figures_of(statistics, resamples)
    intervals = {name: known[name + CI95] for name in statistics if name + CI95 in known}
    return {**figures(column, objects.true_px), **known, "intervals": intervals}


def risk_coverage(
    column: MatcherColumn, true_px: FloatArray, uncertainty: FloatArray | None = None
) -> dict[str, Any]:
    """The curve of one matcher for N boxes, with a row per answered fraction, and its areas, as
    plain values for JSON.

    The areas are under the curves of failures and of the mean relative error, per cent; the latter
    is None without a value. Boxes are sorted by `uncertainty` (N,), larger = less certain; None =
    the relative sigma.
    """
    order = certain_first(column, uncertainty)
    disparity_px, expected_px = column.disparity_px[order], true_px[order]
    error = np.abs(expected_px / disparity_px - 1)
    is_failure = ~(error <= FAILURE)  # true for NaN
    known = error[np.isfinite(error)]
    n, count = len(error), np.arange(1, len(error) + 1)
    rows = []
    for answered_pct in range(STEP_PCT, 100 + STEP_PCT, STEP_PCT):
        first = order[: math.ceil(n * answered_pct / 100)]
        figure = figures(column.select(first), true_px[first])
        rows.append(
            {"answered_pct": answered_pct, "n": len(first), **{key: figure[key] for key in _KEYS}}
        )
    means = np.cumsum(known) / count[: len(known)]
    return {
        "area_failures_pct": round(float(100 * (np.cumsum(is_failure) / count).mean()), 4)
        if n
        else None,
        "area_error_pct": round(float(100 * means.mean()), 4) if len(known) else None,
        "curve": rows,
    }


def certain_first(column: MatcherColumn, uncertainty: FloatArray | None = None) -> IntArray:
    """(N,) rows of the boxes from the most to the least certain box; boxes without a value come
    last.

    Equal uncertainties are in the order of the relative sigma.
    """
    relative_sigma = column.sigma_px / column.disparity_px
    measure = relative_sigma if uncertainty is None else uncertainty
    is_missing = ~np.isfinite(column.disparity_px)
    return np.lexsort((relative_sigma, np.where(np.isfinite(measure), measure, np.inf), is_missing))
