"""Errors of box-only methods on labelled boxes, per class and distance band, with cross-validation over sequences.

Errors are relative. The metrics of a class cover 10-100 m, those of far objects 30-100 m, bands 5-100 m. Fitted methods
are cross-validated: each fold of sequences is measured by a method that was fitted to the other sequences.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from itertools import pairwise
from typing import Any

import numpy as np

from track_range.foundation.arrays import BoolArray, FloatArray, IntArray
from track_range.ranging.evaluation.errors import BANDS_M, MethodColumn, score_rows
from track_range.ranging.fitting.labelled_boxes import CLASS_OF, BoxSet

CLASSES = tuple(CLASS_OF.values())  # evaluated classes, in the order of tables
NEAREST_M, FAR_M = 10.0, 30.0  # smallest distance in m of the metrics of a class, and of those of far objects
N_FOLDS = 7  # folds of the cross-validation: 3 of KITTI's 21 sequences each

CLOSING_HALF_SPAN_S = 0.5
"""Time in s before and after a label over which its true closing speed is the central difference of the distance."""

Predictor = Callable[[BoxSet], MethodColumn]  # function that measures boxes
Fitter = Callable[[BoxSet], Predictor]  # function that fits a predictor to boxes

Scheme = Callable[[BoxSet, BoxSet, Fitter], MethodColumn]
"""Function that fits a method to training boxes and measures boxes: `cross_validated`, `within_drives`, `held_out`."""


def figures(boxes: BoxSet, distance_m: FloatArray, sigma_m: FloatArray | None = None) -> dict[str, dict[str, Any]]:
    """Metrics by class for (N,) measured distances, NaN = not measured, and their (N,) sigmas, None = unknown."""
    sigma_m = np.full(len(boxes), np.nan) if sigma_m is None else sigma_m
    column = MethodColumn(distance_m, sigma_m)
    present = [name for name in CLASSES if (boxes.class_name == name).any()]
    return {name: _class_figures(boxes, column, boxes.class_name == name) for name in present}


def _class_figures(boxes: BoxSet, column: MethodColumn, is_class: BoolArray) -> dict[str, Any]:
    true_m = boxes.distance_m
    in_span = is_class & (true_m >= NEAREST_M) & (true_m <= BANDS_M[-1])
    bands = [
        {"from_m": low, "to_m": high, **score_rows(column, true_m, is_class & (true_m >= low) & (true_m < high))}
        for low, high in pairwise(BANDS_M)
    ]
    tracks = np.unique(np.stack([boxes.sequence, boxes.track_id])[:, in_span], axis=1)
    key = "mean_relative_error_pct"
    return {
        **score_rows(column, true_m, in_span),
        "n_tracks": tracks.shape[1],
        "rear_view_pct": score_rows(column, true_m, in_span & boxes.is_rear_view)[key],
        "far_pct": score_rows(column, true_m, in_span & (true_m >= FAR_M))[key],
        "rear_view_far_pct": score_rows(column, true_m, in_span & boxes.is_rear_view & (true_m >= FAR_M))[key],
        "bands": bands,
    }


def folds(boxes: BoxSet, n_folds: int = N_FOLDS) -> Iterator[BoolArray]:
    """Masks (N,) of the boxes of each fold: every `n_folds`-th sequence, or single sequences if there are fewer."""
    for fold in range(min(n_folds, len(boxes.sequence_names))):
        left_out = boxes.sequence % n_folds == fold
        if left_out.any():
            yield left_out


def cross_validated(boxes: BoxSet, train: BoxSet, fit: Fitter) -> MethodColumn:
    """Distances and sigmas of `boxes`, with each fold measured by a method fitted to the other sequences of `train`.

    `train` has boxes of the same sequences, for example without noise; a single sequence is fitted to itself.
    """
    parts = []
    for test in folds(boxes):
        others = train.select(~np.isin(train.sequence, np.unique(boxes.sequence[test])))
        parts.append((test, fit(others if len(others) else train)(boxes.select(test))))
    return _combined(parts, len(boxes))


def within_drives(boxes: BoxSet, train: BoxSet, fit: Fitter) -> MethodColumn:
    """Distances and sigmas of `boxes`, with each sequence measured by a method fitted to the same sequence of `train`.

    This is the protocol of Zhang et al. It shows how well a curve can fit, and not the error on other drives.
    """
    parts = []
    for number in np.unique(boxes.sequence):
        test = boxes.sequence == number
        parts.append((test, fit(train.select(train.sequence == number))(boxes.select(test))))
    return _combined(parts, len(boxes))


def held_out(boxes: BoxSet, train: BoxSet, fit: Fitter) -> MethodColumn:
    """Distances and sigmas of `boxes` by a method fitted to `train`, which has none of the same images."""
    return fit(train)(boxes)


def _combined(parts: Sequence[tuple[BoolArray, MethodColumn]], n: int) -> MethodColumn:
    """Column of n rows from the columns of parts of the rows; NaN for unknown sigmas."""
    distance_m, sigma_m, systematic_m = np.full((3, n), np.nan)
    for rows, part in parts:
        distance_m[rows], sigma_m[rows] = part.distance_m, part.sigma_m
        systematic_m[rows] = np.nan if part.sigma_systematic_m is None else part.sigma_systematic_m
    return MethodColumn(distance_m, sigma_m, systematic_m if np.isfinite(systematic_m).any() else None)


def frame_rows(boxes: BoxSet) -> Iterator[IntArray]:
    """Row indices of each frame, in the order of sequences and frames."""
    order = np.lexsort((boxes.frame, boxes.sequence))
    key = np.stack([boxes.sequence, boxes.frame])[:, order]
    starts = np.flatnonzero(np.any(np.diff(key, axis=1, prepend=-1) != 0, axis=0))
    yield from np.split(order, starts[1:])


def true_closing_mps(boxes: BoxSet) -> FloatArray:
    """(N,) true closing speed in m/s; NaN unless the track is labelled about half a second before and after."""
    reach = round(CLOSING_HALF_SPAN_S / float(np.median(_steps_s(boxes)))) if len(boxes) > 1 else 1
    ids = {
        (int(s), int(t), int(f)): row
        for row, (s, t, f) in enumerate(zip(boxes.sequence, boxes.track_id, boxes.frame, strict=True))
    }
    before, after = (
        np.array(
            [
                ids.get((int(s), int(t), int(f) + shift), -1)
                for s, t, f in zip(boxes.sequence, boxes.track_id, boxes.frame, strict=True)
            ]
        )
        for shift in (-reach, reach)
    )
    known = (before >= 0) & (after >= 0)
    span_s = boxes.time_s[after] - boxes.time_s[before]
    closed_m = boxes.distance_m[before] - boxes.distance_m[after]
    return np.where(known, closed_m / np.where(known, span_s, 1.0), np.nan)


def _steps_s(boxes: BoxSet) -> FloatArray:
    steps_s = np.diff(np.unique(boxes.time_s))
    return steps_s if len(steps_s) else np.ones(1)


def closing_figures(boxes: BoxSet, closing_mps: FloatArray) -> dict[str, dict[str, Any]]:
    """Number of boxes, and median and 95th percentile of the closing speed error at 10-100 m, by class."""
    error = np.abs(closing_mps - true_closing_mps(boxes))
    in_span = np.isfinite(error) & (boxes.distance_m >= NEAREST_M)
    by_class = {}
    for name in CLASSES:
        class_error = error[in_span & (boxes.class_name == name)]
        if (boxes.class_name == name).any():
            median, p95 = np.percentile(class_error, [50, 95]).round(4).tolist() if len(class_error) else (None, None)
            by_class[name] = {
                "closing_n": len(class_error),
                "closing_median_error_mps": median,
                "closing_p95_error_mps": p95,
            }
    return by_class
