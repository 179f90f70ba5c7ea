"""The truth beside a run's rows: what charts draw, and the part of it that the tables' errors are of."""

from __future__ import annotations

from typing import Any

import numpy as np

from track_range.ranging.evaluation.errors import BANDS_M
from track_range.report.series import Columns
from track_range.results.summary import MatchedTruth


def with_truth(columns: Columns, matched: MatchedTruth) -> dict[str, Any]:
    """The columns with `truth_m` of each row, and `scored_truth_m`, without vans, trams and what is too near or far.

    NaN = no label matches the row, or it is not to be scored.
    """
    truth, row, truth_m = matched.truth, matched.row, matched.distance_m
    is_road_class = (row >= 0) & (truth.class_id[row] >= 0) if len(truth) else np.zeros(len(row), np.bool_)
    scored = is_road_class & (truth_m >= BANDS_M[0]) & (truth_m <= BANDS_M[-1])
    return {**columns, "truth_m": truth_m, "scored_truth_m": np.where(scored, truth_m, np.nan)}
