"""Ground truth matched to the rows of a run, for the summary, the tables and the report."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Any

import numpy as np
import numpy.typing as npt

from track_range.foundation.arrays import BoolArray, FloatArray, IntArray
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

    @property
    def is_road_class(self) -> BoolArray:
        """(N,) mask of the rows that match a label of a road class."""
        return self.of_labels(self.truth.class_id, -1) >= 0

    def of_labels(self, values: npt.NDArray[Any], unmatched: Any) -> npt.NDArray[Any]:
        """(N,) values of the matching labels, from those of all labels; `unmatched` for rows without a match."""
        return np.where(self.row >= 0, np.append(values, unmatched)[self.row], unmatched)


def matched_truth(columns: Columns, truth: Truth) -> MatchedTruth:
    """Ground truth matched to the rows of a run by frame and box overlap."""
    row = match_truth(columns["frame"].astype(np.int64), boxes_px(columns), truth)
    matched = MatchedTruth(truth, row, np.full(len(row), np.nan))
    return replace(matched, distance_m=matched.of_labels(truth.distance_m, np.nan))


def with_truth(columns: Columns, matched: MatchedTruth) -> dict[str, Any]:
    """Columns with `truth_m`, the true distance, and `scored_truth_m`, only of objects that count for the errors.

    Not scored are other classes (such as vans and trams) and distances out of range. NaN = no match, or not scored.
    """
    truth_m = matched.distance_m
    scored = matched.is_road_class & (truth_m >= BANDS_M[0]) & (truth_m <= BANDS_M[-1])
    return {**columns, "truth_m": truth_m, "scored_truth_m": np.where(scored, truth_m, np.nan)}


def boxes_px(columns: Columns) -> FloatArray:
    """(N, 4) boxes x1, y1, x2, y2 in pixels."""
    return np.stack([columns[name] for name in ("x1_px", "y1_px", "x2_px", "y2_px")], axis=1)
