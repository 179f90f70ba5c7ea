"""Compact text encoding of a run's tracks and timeline for its report: integers, delta-coded.

    25.261 m, NaN, 25.102 m  ->  2526 cm, -, 2510 cm  ->  "2526,,-16"

Times are in milliseconds, distances and sigmas in centimetres, speeds in decimetres per second. The
script of the page decodes a track when its chart comes into view. If all tracks together have too
many points, the longest are thinned.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from typing import Any

import numpy as np

from track_range.detection.classes import STATIC_CLASSES
from track_range.foundation.arrays import FloatArray, IntArray
from track_range.pipeline.colours import track_colour
from track_range.results.approaches import track_extremes
from track_range.results.folder import every_of
from track_range.results.rows.rows import Rows
from track_range.views.tables import figure

LINE_POINTS = 1200  # of a line, longer ones are thinned; a page shows about one point per pixel
# numbers in a page, of three to four bytes; 2,000 tracks of 30 frames have 0.9 million
MOST_CELLS = 1_800_000
MAX_BINS = 600  # maximum number of points of the timeline; a page shows about one per two pixels
_DEFAULT_FRAME_S = 0.1  # duration of a frame in s if nothing shows it

TICKS_PER_S, TICKS_PER_M, TICKS_PER_MPS, TICKS_PER_TTC_S = 1000.0, 100.0, 10.0, 100.0
"""Resolution of times, distances, speeds and times to collision."""

_SERIES = (  # column, key in the page and resolution, besides the distances
    ("truth_m", "truth", TICKS_PER_M),
    ("closing_mps", "closing", TICKS_PER_MPS),
    ("road_x", "x", TICKS_PER_M),
    ("box_width", "w", TICKS_PER_M),
    ("shown_ttc", "ttc", TICKS_PER_TTC_S),
    ("path_offset_m", "o", TICKS_PER_M),
    ("passing", "pass", TICKS_PER_M),
    ("passing_sigma", "pass_s", TICKS_PER_M),
    ("contact_probability", "p", 100.0),
    ("alarm_threshold", "p_on", 100.0),
    ("warning", "warning", 1.0),
    ("box_left", "x1", 1.0),
    ("box_top", "y1", 1.0),
    ("box_right", "x2", 1.0),
    ("box_bottom", "y2", 1.0),
)


def packed(values: FloatArray, ticks_per_unit: float) -> str:
    """(N,) values as text: rounded to ticks, each as the difference from the last finite value,
    empty where NaN.
    """
    known = np.isfinite(values)
    steps = np.diff(np.round(values[known] * ticks_per_unit), prepend=0.0).astype(np.int64)
    cells = np.full(len(values), "", dtype=object)
    cells[known] = steps.astype(str)
    return ",".join(cells)


def thinned(n: int, limit: int) -> IntArray:
    """At most `limit` of n rows, evenly spaced, including the first and the last."""
    return (
        np.arange(n)
        if n <= limit
        else np.unique(np.linspace(0, n - 1, limit).round().astype(np.int64))
    )


def track_records(rows: Rows) -> Iterator[dict[str, Any]]:
    """Data of each track for the page, longest track first; series without values are omitted.

    Keys: id, name (class), is_user (no light or sign), colour, n (frames), from_s, to_s; near_m,
    ttc_s, error_pct (None = unknown); t, and the keys of `_SERIES`; observed ("1101": the third box
    was predicted; missing = all observed); m and s: distance and sigma by method.
    """
    row_sets, methods = sorted(rows.by_track(), key=len, reverse=True), rows.methods_measured
    names = [name for name, _, _ in _SERIES]
    names += [f"{method}_{part}" for method in methods for part in ("m", "sigma_m")]
    n_series = 3 + sum(name in rows for name in names)
    limit = LINE_POINTS  # of points per line with which all lines fit into a page
    while limit > 8 and n_series * sum(min(len(own), limit) for own in row_sets) > MOST_CELLS:
        limit = int(0.9 * limit)
    extremes = {row["track_id"]: row for row in track_extremes(rows)}
    for track in map(rows.select, row_sets):
        shown = thinned(len(track), limit)
        yield {
            **_properties(track, extremes[int(track["track_id"][0])]),
            **_series(track.select(shown), methods),
        }


def _properties(track: Rows, extremes: Mapping[str, Any]) -> dict[str, Any]:
    near_m, ttc_s = (
        extremes[key] and round(extremes[key], 1) for key in ("min_distance_m", "min_ttc_front_s")
    )
    time_s, fused_m, truth_m = track["time_s"], track["fused_m"], track["truth_m"]
    error = np.abs(fused_m / np.where(truth_m > 0, truth_m, np.nan) - 1.0)
    error = error[np.isfinite(error)]
    track_id = extremes["track_id"]
    return {
        "id": track_id,
        "name": extremes["class"],
        "is_user": extremes["class"] not in STATIC_CLASSES,
        "colour": "#{2:02x}{1:02x}{0:02x}".format(*track_colour(track_id)),
        "n": len(time_s),
        "from_s": round(float(time_s[0]), 3),
        "to_s": round(float(time_s[-1]), 3),
        "near_m": near_m,
        "ttc_s": ttc_s,
        "error_pct": round(100 * float(np.median(error)), 1) if len(error) else None,
    }


def _series(track: Rows, methods: list[str]) -> dict[str, Any]:
    def series(name: str, key: str, ticks: float) -> dict[str, str]:
        values = track[name] if name in track else np.zeros(0)
        return {key: packed(values, ticks)} if np.isfinite(values).any() else {}

    record: dict[str, Any] = {"t": packed(track["time_s"], TICKS_PER_S), "m": {}, "s": {}}
    for name, key, ticks in _SERIES:
        record |= series(name, key, ticks)
    observed = track["observed"]
    record |= (
        {} if observed.all() else {"observed": "".join("1" if flag else "0" for flag in observed)}
    )
    for method in methods:
        record["m"] |= series(f"{method}_m", method, TICKS_PER_M)
        record["s"] |= series(f"{method}_sigma_m", method, TICKS_PER_M)
    return record


def _frame_s(summary: Mapping[str, Any], n_frames: float) -> float:
    """Duration of a frame in s by the processed time of the summary; results of early versions have
    none.
    """
    hours = figure(summary.get("events") or {}, "hours") or 0.0
    return 3600 * hours / n_frames if hours and n_frames else _DEFAULT_FRAME_S


def timeline(rows: Rows, summary: Mapping[str, Any]) -> dict[str, Any]:
    """Data of the timeline: number of road users and ego speed over the time of a run.

    Keys: `from_s`, `to_s`, `frame_s` (time between processed frames); `t`, `n`: packed times and
    largest numbers of road users; `ego`: ego speed, if known. Times are the starts of equal bins.
    The time span covers the frames of the summary and the rows.
    """
    time_s, frame = rows["time_s"], rows["frame"]
    first_s, n_frames = figure(summary, "starts_s") or 0.0, figure(summary, "frames") or 0.0
    frame_s = default_s = _frame_s(summary, n_frames)
    last_s = first_s + n_frames * frame_s
    if len(time_s):
        between = float(np.ptp(frame)) / every_of(summary.get("settings") or {})
        span = float(np.ptp(time_s))
        frame_s = span / between if between and span / between > 0 else default_s
        first_s = min(first_s, float(time_s.min()))
        last_s = max(float(time_s.max()) + frame_s, first_s + n_frames * frame_s)
    span_s = max(last_s - first_s, frame_s)
    n_bins = int(np.clip(round(span_s / frame_s), 1, MAX_BINS))
    width_s = span_s / n_bins
    row_bin = np.clip((time_s - first_s + 1e-6) // width_s, 0, n_bins - 1).astype(np.int64)
    is_user = ~np.isin(rows["class"], STATIC_CLASSES)
    _, row, count = np.unique(frame[is_user], return_index=True, return_counts=True)
    n_users = np.zeros(n_bins)
    np.maximum.at(n_users, row_bin[is_user][row], count)
    ego_mps = rows["ego_mps"]
    known = np.isfinite(ego_mps)
    ego = np.full(n_bins, np.nan)
    ego[row_bin[known]] = ego_mps[known]
    return {
        "from_s": round(first_s, 3),
        "to_s": round(first_s + span_s, 3),
        "frame_s": round(frame_s, 4),
        "t": packed(first_s + width_s * np.arange(n_bins, dtype=np.float64), TICKS_PER_S),
        "n": packed(n_users, 1.0),
        **({"ego": packed(ego, TICKS_PER_MPS)} if known.any() else {}),
    }
