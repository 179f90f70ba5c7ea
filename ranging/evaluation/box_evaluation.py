"""How far box-only methods are from the truth of labelled boxes, per class and band, on drives they were not fitted on.

Errors are relative. A class's own figures are over 10-100 m, far ones over 30-100 m, bands over 5-100 m. A method
that was fitted is judged leaving sequences out: fitted on the others, fold by fold.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from itertools import pairwise
from typing import Any

import numpy as np

from track_range.foundation.arrays import BoolArray, FloatArray, IntArray
from track_range.ranging.evaluation.errors import BANDS_M, MethodColumn, score_rows
from track_range.ranging.fitting.labelled_boxes import CLASS_OF, BoxSet

CLASSES = tuple(CLASS_OF.values())
"""What figures are given for, in their order."""

NEAREST_M, FAR_M = 10.0, 30.0
"""A class's own figures begin at the first, `far_pct` at the second."""

N_FOLDS = 7

CLOSING_HALF_SPAN_S = 0.5
"""The true closing speed is the central difference of the label's distance over so long to either side."""

Predictor = Callable[[BoxSet], MethodColumn]
Fitter = Callable[[BoxSet], Predictor]
"""What is fitted on some boxes and then measures others."""


def figures(boxes: BoxSet, distance_m: FloatArray, sigma_m: FloatArray | None = None) -> dict[str, dict[str, Any]]:
    """Figures by class of (N,) measured distances, NaN = not measured, and their (N,) sigmas, where there are any."""
    sigma_m = np.full(len(boxes), np.nan) if sigma_m is None else sigma_m
    column = MethodColumn(distance_m, sigma_m)
    present = [name for name in CLASSES if (boxes.class_name == name).any()]
    return {name: _of_class(boxes, column, boxes.class_name == name) for name in present}


def _of_class(boxes: BoxSet, column: MethodColumn, mine: BoolArray) -> dict[str, Any]:
    true_m = boxes.distance_m
    in_span = mine & (true_m >= NEAREST_M) & (true_m <= BANDS_M[-1])
    bands = [
        {"from_m": low, "to_m": high, **score_rows(column, true_m, mine & (true_m >= low) & (true_m < high))}
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
    """(N,) masks of the boxes left out together: every `n_folds`-th sequence; one by one where there are fewer."""
    for fold in range(min(n_folds, len(boxes.sequence_names))):
        left_out = boxes.sequence % n_folds == fold
        if left_out.any():
            yield left_out


def cross_validated(boxes: BoxSet, train: BoxSet, fit: Fitter) -> MethodColumn:
    """(N,) distances and sigmas of `boxes`, each fold by what was fitted on `train` without the fold's sequences.

    `train` has the same sequences as `boxes`, but perhaps exact boxes. One sequence alone is fitted on itself.
    """
    parts = []
    for test in folds(boxes):
        others = train.select(~np.isin(train.sequence, np.unique(boxes.sequence[test])))
        parts.append((test, fit(others if len(others) else train)(boxes.select(test))))
    return _put_together(parts, len(boxes))


def within_drives(boxes: BoxSet, train: BoxSet, fit: Fitter) -> MethodColumn:
    """As `cross_validated`, but each sequence by what was fitted on itself alone: how the paper was measured.

    It says how well a curve can fit, and nothing of other drives, other cars and other people.
    """
    parts = []
    for number in np.unique(boxes.sequence):
        test = boxes.sequence == number
        parts.append((test, fit(train.select(train.sequence == number))(boxes.select(test))))
    return _put_together(parts, len(boxes))


def _put_together(parts: Sequence[tuple[BoolArray, MethodColumn]], n: int) -> MethodColumn:
    """(n,) from columns of the rows that masks name; what a part does not tell of its sigma is NaN."""
    distance_m, sigma_m, systematic_m = np.full((3, n), np.nan)
    for rows, found in parts:
        distance_m[rows], sigma_m[rows] = found.distance_m, found.sigma_m
        systematic_m[rows] = np.nan if found.sigma_systematic_m is None else found.sigma_systematic_m
    return MethodColumn(distance_m, sigma_m, systematic_m if np.isfinite(systematic_m).any() else None)


def frame_rows(boxes: BoxSet) -> Iterator[IntArray]:
    """Rows of one frame after the other, sequence by sequence."""
    order = np.lexsort((boxes.frame, boxes.sequence))
    key = np.stack([boxes.sequence, boxes.frame])[:, order]
    starts = np.flatnonzero(np.any(np.diff(key, axis=1, prepend=-1) != 0, axis=0))
    yield from np.split(order, starts[1:])


def true_closing_mps(boxes: BoxSet) -> FloatArray:
    """(N,) true closing speed; NaN where the track is not labelled about half a second before and after."""
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
    """By class: median and 95th percentile of the closing speed's error at 10-100 m, and over how many boxes."""
    error = np.abs(closing_mps - true_closing_mps(boxes))
    in_span = np.isfinite(error) & (boxes.distance_m >= NEAREST_M)
    found = {}
    for name in CLASSES:
        mine = error[in_span & (boxes.class_name == name)]
        if (boxes.class_name == name).any():
            median, p95 = np.percentile(mine, [50, 95]).round(4).tolist() if len(mine) else (None, None)
            found[name] = {
                "closing_n": len(mine),
                "closing_median_error_mps": median,
                "closing_p95_error_mps": p95,
            }
    return found
