"""Data of the report's timeline: number of road users and ego speed over the time of a run."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np

from track_range.foundation.arrays import FloatArray
from track_range.results.columns import Columns
from track_range.views.report.content.series import TICKS_PER_MPS, TICKS_PER_S, column, packed
from track_range.views.report.tables import figure

MAX_BINS = 600
"""Maximum number of points of the timeline; a page shows about one per two pixels."""

_DEFAULT_FRAME_S = 0.1
"""Duration of a frame in s if the rows do not determine it."""


def timeline(columns: Columns, summary: Mapping[str, Any]) -> dict[str, Any]:
    """Data for the page.

    Keys: `from_s`, `to_s`, `frame_s` (duration of a frame); `t`, `n`: packed times and largest numbers of road users;
    `ego`: ego speed, if known. Times are the starts of equal bins. The time span covers the frames of the summary and
    the rows.
    """
    time_s, frame = column(columns, "time_s"), column(columns, "frame")
    first_s, last_s, frame_s = run_span(time_s, frame, summary)
    span_s = max(last_s - first_s, frame_s)
    n_bins = int(np.clip(round(span_s / frame_s), 1, MAX_BINS))
    width_s = span_s / n_bins
    bin_of_row = np.clip((time_s - first_s + 1e-6) // width_s, 0, n_bins - 1).astype(np.int64)
    _, row, count = np.unique(frame, return_index=True, return_counts=True)
    n_users = np.zeros(n_bins)
    np.maximum.at(n_users, bin_of_row[row], count)
    ego_mps = column(columns, "ego_mps")
    known = np.isfinite(ego_mps)
    ego = np.full(n_bins, np.nan)
    ego[bin_of_row[known]] = ego_mps[known]
    return {
        "from_s": round(first_s, 3),
        "to_s": round(first_s + span_s, 3),
        "frame_s": round(frame_s, 4),
        "t": packed(first_s + width_s * np.arange(n_bins, dtype=np.float64), TICKS_PER_S),
        "n": packed(n_users, 1.0),
        **({"ego": packed(ego, TICKS_PER_MPS)} if known.any() else {}),
    }


def run_span(time_s: FloatArray, frame: FloatArray, summary: Mapping[str, Any]) -> tuple[float, float, float]:
    """Times in s of the start and the end of a run, and the duration of a frame."""
    first_s, n_frames = figure(summary, "starts_s") or 0.0, figure(summary, "frames") or 0.0
    if not len(time_s):
        return first_s, first_s + n_frames * _DEFAULT_FRAME_S, _DEFAULT_FRAME_S
    n_between = float(np.ptp(frame))
    frame_s = float(np.ptp(time_s)) / n_between if n_between else _DEFAULT_FRAME_S
    frame_s = frame_s if frame_s > 0 else _DEFAULT_FRAME_S
    first_s = min(first_s, float(time_s.min()))
    return first_s, max(float(time_s.max()) + frame_s, first_s + n_frames * frame_s), frame_s
