"""Compact text encoding of a run's tracks for its report: integers, delta-coded.

    25.261 m, NaN, 25.102 m  ->  2526 cm, -, 2510 cm  ->  "2526,,-16"

Times are in milliseconds, distances and sigmas in centimetres, speeds in decimetres per second. The script of the page
decodes a track when its chart comes into view. If all tracks together have too many points, the longest are thinned.
"""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any

import numpy as np

from track_range.foundation.arrays import BoolArray, FloatArray, IntArray
from track_range.pipeline.colours import track_colour
from track_range.results.columns import Columns, methods_measured

LINE_POINTS = 1200
"""Maximum number of points of a line; longer ones are thinned. A page shows about one point per pixel."""

MOST_CELLS = 1_800_000
"""Maximum count of numbers in a page, at three to four bytes each; 2,000 tracks of 30 frames have 0.9 million."""

TICKS_PER_S, TICKS_PER_M, TICKS_PER_MPS, TICKS_PER_TTC_S = 1000.0, 100.0, 10.0, 100.0
"""Resolution of times, distances, speeds and times to collision."""


_SERIES = (
    ("truth_m", "truth", TICKS_PER_M),
    ("closing_mps", "closing", TICKS_PER_MPS),
    ("road_x", "x", TICKS_PER_M),
    ("box_width", "w", TICKS_PER_M),
    ("shown_ttc", "ttc", TICKS_PER_TTC_S),
    ("path_offset_m", "o", TICKS_PER_M),
    ("passing", "pass", TICKS_PER_M),
    ("passing_sigma", "pass_s", TICKS_PER_M),
    ("contact_probability", "p", 100.0),
    ("warning", "warning", 1.0),
    ("box_left", "x1", 1.0),
    ("box_top", "y1", 1.0),
    ("box_right", "x2", 1.0),
    ("box_bottom", "y2", 1.0),
)
"""Column, key in the page and resolution of the series of a track besides its distances."""


def column(columns: Columns, name: str, rows: BoolArray | IntArray | slice = slice(None)) -> FloatArray:
    """Rows of a column as float64; all NaN where the run has no such column."""
    if name in columns:
        return np.asarray(columns[name][rows], np.float64)
    return np.full(len(columns["time_s"][rows]), np.nan)


def packed(values: FloatArray, ticks_per_unit: float) -> str:
    """(N,) values as text: rounded to ticks, each as the difference from the last finite one, empty where NaN."""
    known = np.isfinite(values)
    steps = np.diff(np.round(values[known] * ticks_per_unit), prepend=0.0).astype(np.int64)
    cells = np.full(len(values), "", dtype=object)
    cells[known] = steps.astype(str)
    return ",".join(cells)


def track_records(columns: Columns) -> Iterator[dict[str, Any]]:
    """Data of each track for the page, longest track first; series without values are omitted.

    Keys: id, name (class), colour, n (frames), from_s, to_s; near_m, ttc_s, error_pct (None = unknown); t, and the
    keys of `_SERIES`; observed ("1101": the third box was predicted; missing = all observed); m and s: distance and
    sigma by method.
    """
    row_sets = rows_by_track(columns)
    limit = _longest_line([len(rows) for rows in row_sets], n_series=_n_series(columns))
    methods = methods_measured(columns)
    for rows in row_sets:
        track = {name: values[rows] for name, values in columns.items()}
        shown = thinned(len(rows), limit)
        yield {**_properties(track), **_series({name: values[shown] for name, values in track.items()}, methods)}


def rows_by_track(columns: Columns) -> list[IntArray]:
    """Rows of each track in the order of time, longest track first."""
    track_id = columns["track_id"]
    if not len(track_id):
        return []
    order = np.lexsort((columns["time_s"], track_id))
    starts = np.flatnonzero(np.diff(track_id[order])) + 1
    return sorted(np.split(order, starts), key=len, reverse=True)


def _n_series(columns: Columns) -> int:
    return (
        3
        + sum(name in columns for name, _, _ in _SERIES)
        + sum(name in columns for method in methods_measured(columns) for name in (f"{method}_m", _sigma(method)))
    )


def _sigma(method: str) -> str:
    return f"{method}_sigma_m"


def _longest_line(lengths: list[int], *, n_series: int) -> int:
    """Maximum number of points per line with which all lines fit into a page."""
    limit = LINE_POINTS
    while limit > 8 and n_series * sum(min(length, limit) for length in lengths) > MOST_CELLS:
        limit = int(0.9 * limit)
    return limit


def thinned(n: int, limit: int) -> IntArray:
    """At most `limit` of n rows, evenly spaced, including the first and the last."""
    return np.arange(n) if n <= limit else np.unique(np.linspace(0, n - 1, limit).round().astype(np.int64))


def _properties(track: Columns) -> dict[str, Any]:
    time_s, fused_m = column(track, "time_s"), column(track, "fused_m")
    truth_m = column(track, "truth_m")
    error = np.abs(fused_m / np.where(truth_m > 0, truth_m, np.nan) - 1.0)
    names, counts = np.unique(track["class"], return_counts=True)
    return {
        "id": int(track["track_id"][0]),
        "name": str(names[np.argmax(counts)]),
        "colour": "#{2:02x}{1:02x}{0:02x}".format(*track_colour(int(track["track_id"][0]))),
        "n": len(time_s),
        "from_s": round(float(time_s[0]), 3),
        "to_s": round(float(time_s[-1]), 3),
        "near_m": _rounded(fused_m, np.min),
        "ttc_s": _rounded(column(track, "ttc_s"), np.min),
        "error_pct": _rounded(100.0 * error, np.median),
    }


def _rounded(values: FloatArray, reduce: Any) -> float | None:
    known = values[np.isfinite(values)]
    return round(float(reduce(known)), 2) if len(known) else None


def _series(track: Columns, methods: list[str]) -> dict[str, Any]:
    series: dict[str, Any] = {"t": packed(column(track, "time_s"), TICKS_PER_S), "m": {}, "s": {}}
    for name, key, ticks in _SERIES:
        values = column(track, name)
        series |= {key: packed(values, ticks)} if np.isfinite(values).any() else {}
    observed = column(track, "observed") != 0
    series |= {} if observed.all() else {"observed": "".join("1" if flag else "0" for flag in observed)}
    for method in methods:
        for key, name in (("m", f"{method}_m"), ("s", _sigma(method))):
            values = column(track, name)
            series[key] |= {method: packed(values, TICKS_PER_M)} if np.isfinite(values).any() else {}
    return series
