"""How far a method's distances are from the truth, and whether its sigmas are honest.

Tracks are matched to labels frame by frame (one to one, greatest total IoU, at least 0.5, whatever their classes).
Errors are relative, (measured - true) / true, over 5-100 m, of labels that are not truncated and at most partly hidden;
those of closing speeds, where the truth knows them, are differences over the same labels.
`coverage` is the share of matched track-frames that a method measured. The `common` figures are over the track-frames
that every method measured, so that none can look good by refusing the hard ones.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from itertools import pairwise
from typing import Any

import numpy as np
import numpy.typing as npt
from scipy.optimize import linear_sum_assignment

from track_range.detection.boxes import iou
from track_range.foundation.arrays import BoolArray, FloatArray, IntArray
from track_range.ranging.evaluation.truth import Truth

BANDS_M = (5.0, 10.0, 20.0, 30.0, 50.0, 100.0)
"""Edges of the distance bands that errors are reported in."""

MIN_IOU = 0.5

_MIN_COMMON_COVERAGE = 0.5
"""A method that covers less has no say in what the common coverage is: it would leave nothing to compare on."""


@dataclass(frozen=True, slots=True)
class MethodColumn:
    """One method's distances over a run's track-frames: (N,) metres and (N,) sigma, NaN = not measured.

    `sigma_systematic_m` as in `Ranges`.
    """

    distance_m: FloatArray
    sigma_m: FloatArray
    sigma_systematic_m: FloatArray | None = None


def match_truth(frame: IntArray, xyxy_px: FloatArray, truth: Truth) -> IntArray:
    """(N,) row of `truth` that each track-frame matches, -1 where none."""
    matched = np.full(len(frame), -1)
    for number in np.intersect1d(frame, truth.frame):
        rows, labels = np.flatnonzero(frame == number), np.flatnonzero(truth.frame == number)
        overlap = iou(xyxy_px[rows], truth.xyxy_px[labels])
        row, label = linear_sum_assignment(np.where(overlap >= MIN_IOU, overlap, 0.0), maximize=True)
        good = overlap[row, label] >= MIN_IOU
        matched[rows[row[good]]] = labels[label[good]]
    return matched


def score_methods(
    methods: Mapping[str, MethodColumn],
    true_m: FloatArray,
    *,
    is_road_class: BoolArray,
    kitti_type: npt.NDArray[np.str_],
) -> tuple[dict[str, Any], dict[str, Any]]:
    """Scores of each method over its own coverage, and over the common one of those that cover half of it all.

    Args:
        methods: columns of (N,) by method name.
        true_m: (N,) true distance of each track-frame; NaN = no truth for it.
        is_road_class: (N,) whether its label is of a road class; others (Van, Tram) appear in `by_class` only.
        kitti_type: (N,) the label's own word.
    """
    in_span = (true_m >= BANDS_M[0]) & (true_m <= BANDS_M[-1])
    mine = {name: _score_with_bands(c, true_m, in_span=in_span & is_road_class) for name, c in methods.items()}
    for name, column in methods.items():
        mine[name]["by_class"] = {
            str(word): score_rows(column, true_m, in_span & (kitti_type == word))
            for word in np.unique(kitti_type[in_span])
        }
    ran = {name: column for name, column in methods.items() if (mine[name]["coverage"] or 0) >= _MIN_COMMON_COVERAGE}
    everyone = in_span & is_road_class & np.all([np.isfinite(c.distance_m) for c in ran.values()] or [in_span], axis=0)
    common = {name: _score_with_bands(c, true_m, in_span=everyone) for name, c in ran.items()}
    return mine, common


def coverage_only(methods: Mapping[str, MethodColumn]) -> dict[str, Any]:
    """What can be said of each method without a truth: how many track-frames it measured."""
    nothing = np.full(len(next(iter(methods.values())).distance_m) if methods else 0, np.nan)
    return {
        name: {
            **_figures(nothing[:0], nothing[:0]),
            "coverage": _share(np.isfinite(column.distance_m)),
            "n": int(np.isfinite(column.distance_m).sum()),
            "median_sigma_pct": _sigma_pct(column, np.isfinite(column.distance_m)),
            "bands": [],
        }
        for name, column in methods.items()
    }


def _score_with_bands(column: MethodColumn, true_m: FloatArray, *, in_span: BoolArray) -> dict[str, Any]:
    bands = [
        {"from_m": low, "to_m": high, **_band(column, true_m, in_span & (true_m >= low) & (true_m < high))}
        for low, high in pairwise(BANDS_M)
    ]
    return {**score_rows(column, true_m, in_span), "bands": bands}


def _band(column: MethodColumn, true_m: FloatArray, rows: BoolArray) -> dict[str, Any]:
    score = score_rows(column, true_m, rows)
    return {key: score[key] for key in ("n", "mean_relative_error_pct", "median_relative_error_pct", "bias_pct")}


def score_rows(column: MethodColumn, true_m: FloatArray, rows: BoolArray) -> dict[str, Any]:
    """Figures of one method over the `rows` (N,) that it measured; None where there is nothing to say."""
    measured = np.isfinite(column.distance_m) & rows
    error = column.distance_m[measured] / true_m[measured] - 1
    in_sigmas = np.abs(column.distance_m - true_m)[measured] / column.sigma_m[measured]
    return {
        "coverage": _share(measured[rows]),
        "n": int(measured.sum()),
        **_figures(error, in_sigmas),
        "median_sigma_pct": _sigma_pct(column, measured),
    }


def score_closing(closing_mps: FloatArray, sigma_mps: FloatArray, true_mps: FloatArray) -> dict[str, Any] | None:
    """Figures of closing speeds (N,) that are errors in m/s, over the rows with a truth; None where there is none."""
    rows = np.isfinite(true_mps)
    if not rows.any():
        return None
    measured = rows & np.isfinite(closing_mps)
    error_mps = (closing_mps - true_mps)[measured]
    in_sigmas = np.abs(error_mps) / sigma_mps[measured]
    n = len(error_mps)
    return {
        "coverage": _share(measured[rows]),
        "n": n,
        "mean_error_mps": _rounded(np.abs(error_mps).mean()) if n else None,
        "median_error_mps": _rounded(np.median(np.abs(error_mps))) if n else None,
        "bias_mps": _rounded(np.median(error_mps)) if n else None,
        **_within(in_sigmas),
        "median_sigma_mps": _rounded(np.median(sigma_mps[measured])) if n else None,
    }


def _sigma_pct(column: MethodColumn, measured: BoolArray) -> float | None:
    """Median of what a method claims its relative error to be; None where it claims nothing."""
    claimed = (column.sigma_m / column.distance_m)[measured & np.isfinite(column.sigma_m)]
    return _rounded(100 * np.median(claimed)) if len(claimed) else None


def _figures(error: FloatArray, in_sigmas: FloatArray) -> dict[str, Any]:
    """Figures of relative errors and of errors in units of sigma; None where there is nothing to say."""
    return {
        "mean_relative_error_pct": _rounded(100 * np.abs(error).mean()) if len(error) else None,
        "median_relative_error_pct": _rounded(100 * np.median(np.abs(error))) if len(error) else None,
        "bias_pct": _rounded(100 * np.median(error)) if len(error) else None,
        **_within(in_sigmas),
    }


def _within(in_sigmas: FloatArray) -> dict[str, float | None]:
    """Shares of errors (N,) in units of sigma, NaN = sigma not told."""
    known = in_sigmas[np.isfinite(in_sigmas)]
    return {"within_1_sigma": _share(known <= 1), "within_2_sigma": _share(known <= 2)}


def _share(yes: BoolArray) -> float | None:
    return _rounded(yes.mean()) if len(yes) else None


def _rounded(value: Any) -> float:
    return round(float(value), 4)
