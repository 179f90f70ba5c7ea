"""Ground truth matched to the rows of a run, for the summary, the tables and the report."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np

from track_range.foundation.arrays import FloatArray, IntArray
from track_range.ranging.evaluation.errors import BANDS_M, match_truth
from track_range.ranging.evaluation.truth import Truth
from track_range.results.columns import Columns


@dataclass(frozen=True, slots=True)
class MatchedTruth:
    """Ground truth of N rows (a track in a frame each).

    Attributes:
        truth: the labels.
        row: (N,) index of the matching label in `truth`; -1 = no match.
        distance_m: (N,) true distance of the matching label in metres; NaN = no match.
    """

    truth: Truth
    row: IntArray
    distance_m: FloatArray


def matched_truth(columns: Columns, truth: Truth) -> MatchedTruth:
    """Ground truth matched to the rows of a run by frame and box overlap."""
    row = match_truth(columns["frame"].astype(np.int64), boxes_px(columns), truth)
    distance_m = np.where(row >= 0, truth.distance_m[row], np.nan) if len(truth) else np.full(len(row), np.nan)
    return MatchedTruth(truth, row, distance_m)


def with_truth(columns: Columns, matched: MatchedTruth) -> dict[str, Any]:
    """Columns with `truth_m`, the true distance, and `scored_truth_m`, only of objects that count for the errors.

    Not scored are other classes (such as vans and trams) and distances out of range. NaN = no match, or not scored.
    """
    truth, row, truth_m = matched.truth, matched.row, matched.distance_m
    is_road_class = (row >= 0) & (truth.class_id[row] >= 0) if len(truth) else np.zeros(len(row), np.bool_)
    scored = is_road_class & (truth_m >= BANDS_M[0]) & (truth_m <= BANDS_M[-1])
    return {**columns, "truth_m": truth_m, "scored_truth_m": np.where(scored, truth_m, np.nan)}


def boxes_px(columns: Columns) -> FloatArray:
    """(N, 4) boxes x1, y1, x2, y2 in pixels."""
    return np.stack([columns[name] for name in ("x1_px", "y1_px", "x2_px", "y2_px")], axis=1)
