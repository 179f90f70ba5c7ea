"""Errors of distances and closing speeds against ground truth, and calibration of their sigmas.

Tracks are matched to labels frame by frame: one to one, with the largest total IoU, each at least
0.5, regardless of class. Errors are relative, (measured - true) / true, over 5-100 m, for labels
that are not truncated and at most partly occluded; errors of closing speeds are differences over
the same labels. `coverage` is the fraction of matched track-frames that a method measured. The
`common` metrics cover the track-frames that all methods measured, so that methods are compared on
the same objects.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from itertools import pairwise
from typing import Any

import numpy as np
import numpy.typing as npt
from scipy.optimize import linear_sum_assignment

from track_range.detection.boxes import iou
from track_range.foundation.arrays import BoolArray, FloatArray, IntArray
from track_range.foundation.bootstrap import CI95, Resamples, Statistic, figures_of
from track_range.ranging.truth.truth import Truth

# edges of the distance bands for which errors are reported
BANDS_M = (5.0, 10.0, 20.0, 30.0, 50.0, 100.0)
_GROSS_ERROR = 0.25  # relative error above which a distance is wrong rather than inaccurate
MIN_IOU = 0.5  # of a matched track and label, as in KITTI's evaluation of people and cyclists
# of methods in the common metrics; others would leave too few common track-frames
_MIN_COMMON_COVERAGE = 0.5


@dataclass(frozen=True, slots=True)
class MethodColumn:
    """One method's distances of the N track-frames of a run."""

    distance_m: FloatArray  # (N,) distance, NaN = not measured
    sigma_m: FloatArray  # (N,) standard deviation, NaN = not measured or unknown
    # (N,) systematic part of sigma_m, as in `Ranges`; None = unknown
    sigma_systematic_m: FloatArray | None = None
    # (N,) whether fusion leaves them out where another method measured, as in `Ranges`; None = all
    is_fallback: BoolArray | None = None


def match_truth(frame: IntArray, xyxy_px: FloatArray, truth: Truth) -> IntArray:
    """(N,) row of `truth` that each track-frame matches, -1 = none."""
    return match_boxes(frame, xyxy_px, truth.frame, truth.xyxy_px)


def match_boxes(
    frame: IntArray, xyxy_px: FloatArray, other_frame: IntArray, other_px: FloatArray
) -> IntArray:
    """(N,) index of the other box (M, 4) in the frame of each box (N, 4), one to one by IoU; -1 =
    none.
    """
    matched = np.full(len(frame), -1)
    orders = [(numbers, np.argsort(numbers, kind="stable")) for numbers in (frame, other_frame)]
    by_frame = [(numbers[order], order) for numbers, order in orders]
    for number in np.intersect1d(frame, other_frame):
        rows, labels = (
            order[slice(*np.searchsorted(numbers, (number, number + 1)))]
            for numbers, order in by_frame
        )
        overlap = iou(xyxy_px[rows], other_px[labels])
        row, label = linear_sum_assignment(
            np.where(overlap >= MIN_IOU, overlap, 0.0), maximize=True
        )
        is_match = overlap[row, label] >= MIN_IOU
        matched[rows[row[is_match]]] = labels[label[is_match]]
    return matched


def score_methods(
    methods: Mapping[str, MethodColumn],
    true_m: FloatArray,
    *,
    is_road_class: BoolArray,
    kitti_type: npt.NDArray[np.str_],
    track_id: IntArray | None = None,
    seed: int = 0,
) -> tuple[dict[str, Any], dict[str, Any]]:
    """Scores of each method on the track-frames that it measured, and on the track-frames that all
    methods measured.

    With the true tracks (N,), figures have 95 % intervals, by resampling tracks (`foundation.bootstrap`).
    Methods with a coverage below 0.5 are not part of the common scores. `true_m` (N,) is NaN where
    unknown. Labels that are not of a road class (Van, Tram) appear in `by_class` only.
    """
    in_span = (true_m >= BANDS_M[0]) & (true_m <= BANDS_M[-1])
    resamples = (
        None
        if track_id is None
        else Resamples.of(track_id, seed=seed, rows=in_span & is_road_class)
    )
    separate = {
        name: _score_with_bands(c, true_m, in_span & is_road_class, resamples)
        for name, c in methods.items()
    }
    for name, column in methods.items():
        separate[name]["by_class"] = {
            str(label_type): score_rows(column, true_m, in_span & (kitti_type == label_type))
            for label_type in np.unique(kitti_type[in_span])
        }
    compared = {
        name: c
        for name, c in methods.items()
        if (separate[name]["coverage"] or 0) >= _MIN_COMMON_COVERAGE
    }
    is_measured = [np.isfinite(column.distance_m) for column in compared.values()]
    in_common = in_span & is_road_class & np.all(is_measured or [in_span], axis=0)
    common = {
        name: _score_with_bands(column, true_m, in_common, resamples)
        for name, column in compared.items()
    }
    return separate, common


def coverage_only(methods: Mapping[str, MethodColumn]) -> dict[str, Any]:
    """Scores of each method without ground truth: coverage and sigma; errors are None."""
    return {
        name: {
            **score_rows(column, np.full_like(column.distance_m, np.nan), column.distance_m != 0),
            "bands": [],
        }
        for name, column in methods.items()
    }


def _score_with_bands(
    column: MethodColumn, true_m: FloatArray, in_span: BoolArray, resamples: Resamples | None
) -> dict[str, Any]:
    keys = (
        "from_m",
        "to_m",
        "n",
        *(
            "mean_relative_error_pct",
            "median_relative_error_pct",
            "bias_pct",
            "within_25_percent",
        ),
    )
    listed = {*keys, *(key + CI95 for key in keys)}
    bands = [
        {key: value for key, value in band.items() if key in listed}
        for band in score_bands(column, true_m, in_span, resamples)
    ]
    return {**score_rows(column, true_m, in_span, resamples), "bands": bands}


def score_bands(
    column: MethodColumn,
    true_m: FloatArray,
    rows: BoolArray,
    resamples: Resamples | None = None,
) -> list[dict[str, Any]]:
    """`score_rows` in each distance band of `BANDS_M`."""
    return [
        {
            "from_m": low,
            "to_m": high,
            **score_rows(column, true_m, rows & (true_m >= low) & (true_m < high), resamples),
        }
        for low, high in pairwise(BANDS_M)
    ]


def score_rows(
    column: MethodColumn,
    true_m: FloatArray,
    rows: BoolArray,
    resamples: Resamples | None = None,
) -> dict[str, Any]:
    """Metrics of one method over its measured rows of `rows` (N,), with resamples of their 95 %
    intervals (`NAME_ci95`); None = no measured rows.
    """
    statistics = distance_statistics(column, true_m, rows)
    figures = figures_of(statistics, resamples)
    # NaN of the coverage are other rows
    is_measured = statistics["coverage"].values == 1
    counts: dict[str, Any] = {"coverage": figures.pop("coverage"), "n": int(is_measured.sum())}
    if resamples is not None:
        counts["n_tracks"] = len(np.unique(resamples.block[is_measured]))
    return {**counts, **figures}


def distance_statistics(
    column: MethodColumn, true_m: FloatArray, rows: BoolArray
) -> dict[str, Statistic]:
    """The figures of one method's distances in the rows (N,), before their average."""
    measured = np.isfinite(column.distance_m) & rows
    distance_m, sigma_m, true_m = (
        np.where(measured, values, np.nan) for values in (column.distance_m, column.sigma_m, true_m)
    )
    error, in_sigmas = distance_m / true_m - 1, np.abs(distance_m - true_m) / sigma_m
    size = np.abs(error)
    return {
        "coverage": Statistic(np.where(rows, measured, np.nan)),
        "mean_relative_error_pct": Statistic(size, scale=100),
        "median_relative_error_pct": Statistic(size, 0.5, 100),
        "bias_pct": Statistic(error, 0.5, 100),
        "within_25_percent": Statistic(np.where(np.isfinite(size), size <= _GROSS_ERROR, np.nan)),
        "delta_1_25": Statistic(np.where(np.isfinite(size), _are_in_delta_1(error), np.nan)),
        **within_sigmas(in_sigmas),
        "median_sigma_pct": Statistic(sigma_m / distance_m, 0.5, 100),
    }


def _are_in_delta_1(error: FloatArray) -> BoolArray:
    """(N,) whether the larger ratio of the measured and the true distance is below 1.25, which is
    what published evaluations call delta 1.
    """
    return np.asarray((1 + error < 1 + _GROSS_ERROR) & (1 + error > 1 / (1 + _GROSS_ERROR)))


def within_sigmas(in_sigmas: FloatArray, limits: Sequence[int] = (1, 2)) -> dict[str, Statistic]:
    """Fractions of errors (N,) in units of sigma within these limits; NaN = sigma unknown."""
    is_known = np.isfinite(in_sigmas)
    return {
        f"within_{k}_sigma": Statistic(np.where(is_known, in_sigmas <= k, np.nan)) for k in limits
    }


def score_closing(
    closing_mps: FloatArray,
    sigma_mps: FloatArray,
    true_mps: FloatArray,
    track_id: IntArray | None = None,
    seed: int = 0,
) -> dict[str, Any] | None:
    """Errors of (N,) closing speeds in m/s over the rows with a true speed; None if there is no
    such row.
    """
    rows = np.isfinite(true_mps)
    if not rows.any():
        return None
    measured = rows & np.isfinite(closing_mps)
    error_mps = np.where(measured, closing_mps - true_mps, np.nan)
    in_sigmas = np.abs(error_mps) / sigma_mps
    statistics = {
        "mean_error_mps": Statistic(np.abs(error_mps)),
        "median_error_mps": Statistic(np.abs(error_mps), 0.5),
        "bias_mps": Statistic(error_mps, 0.5),
        **within_sigmas(in_sigmas),
        "median_sigma_mps": Statistic(np.where(measured, sigma_mps, np.nan), 0.5),
    }
    resamples = None if track_id is None else Resamples.of(track_id, seed=seed, rows=rows)
    counts = {"coverage": fraction(measured[rows]), "n": int(measured.sum())}
    return {**counts, **figures_of(statistics, resamples)}


def fraction(mask: BoolArray) -> float | None:
    """Fraction of (N,) values that are true; None if N = 0."""
    return _rounded(mask.mean()) if len(mask) else None


def _rounded(value: Any) -> float:
    return round(float(value), 4)
