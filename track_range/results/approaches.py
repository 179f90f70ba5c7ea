"""Closest approaches: smallest distance, strongest closing and shortest time to collision of road
users.
"""

import math
from collections.abc import Iterator
from typing import Any

import numpy as np

from track_range.detection.classes import STATIC_CLASSES
from track_range.foundation.arrays import FloatArray, IntArray
from track_range.results.rows.rows import Rows, most_frequent
from track_range.results.rows.supported import supported_values


def closest_approaches(rows: Rows) -> list[dict[str, Any]]:
    """One row for each road user (a track, without traffic lights and signs), nearest first.

    Keys: `track_id`, `class` (the most frequent class); `min_distance_m` (filtered, else fused),
    `max_closing_mps` and `min_ttc_s` (also as `min_ttc_front_s`), each with `_at_s`, its time;
    `min_distance_sigma_m`, `max_closing_sigma_mps`. None = no value is supported
    (`rows.supported`).
    """
    users = [row for row in track_extremes(rows) if row["class"] not in STATIC_CLASSES]
    return sorted(
        users, key=lambda row: np.inf if row["min_distance_m"] is None else row["min_distance_m"]
    )


def track_extremes(rows: Rows) -> Iterator[dict[str, Any]]:
    """Rows as in `closest_approaches`, but for each track, by increasing track ID."""
    distance_m, sigma_m = reference_distance(rows)
    supported = supported_values(rows, distance_m, sigma_m)
    spread_mps = rows["closing_sigma_mps"]
    measures = (  # key, values whose smallest counts, and standard deviations with their key
        ("min_distance_m", supported["distance_m"], "min_distance_sigma_m", sigma_m),
        ("max_closing_mps", -supported["closing_mps"], "max_closing_sigma_mps", spread_mps),
        ("min_ttc_front_s", supported["ttc_front_s"], "", None),
    )
    for own in rows.by_track():
        row: dict[str, Any] = {"track_id": int(rows["track_id"][own[0]])}
        row["class"] = most_frequent(rows["class"][own])
        for key, values, sigma_key, sigmas in measures:
            value = sigma = time_s = math.nan
            at = row_of_smallest(values, own)
            if at is not None:
                value, time_s = abs(values[at]), rows["time_s"][at]
                sigma = math.nan if sigmas is None else sigmas[at]
            row[key] = _finite(value)
            if sigma_key:
                row[sigma_key] = _finite(sigma)
            row[f"{key}_at_s"] = _finite(time_s)
        # the name of this figure everywhere; the other one is that of earlier versions
        row |= {f"min_ttc_s{end}": row[f"min_ttc_front_s{end}"] for end in ("", "_at_s")}
        yield row


def row_of_smallest(values: FloatArray, rows: IntArray) -> int | None:
    """The one of `rows` with the smallest value; None = all values are unknown."""
    known = rows[np.isfinite(values[rows])]
    return int(known[np.argmin(values[known])]) if len(known) else None


def _finite(value: float) -> float | None:
    return float(value) if math.isfinite(value) else None


def reference_distance(
    rows: Rows, methods: tuple[str, str] = ("fused_kf", "fused")
) -> tuple[FloatArray, FloatArray]:
    """(N,) distances of a run by the first method, else by the second, and their standard
    deviations; NaN = unknown.
    """
    (first_m, first_sigma_m), (other_m, other_sigma_m) = map(rows.distance, methods)
    is_first = np.isfinite(first_m)
    return np.where(is_first, first_m, other_m), np.where(is_first, first_sigma_m, other_sigma_m)
