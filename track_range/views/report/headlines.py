"""The three main results of a run in words: events, smallest distance, shortest time to collision."""

from __future__ import annotations

from collections import Counter
from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np

from track_range.foundation.arrays import BoolArray
from track_range.foundation.files.input_files import counted
from track_range.results.columns import Columns
from track_range.results.events.event import Event
from track_range.views.report import tables
from track_range.views.report.content.events import kind_counts, object_words, sigma_words, time_words
from track_range.views.report.content.road import is_on_course
from track_range.views.report.content.series import column

STATIC_CLASSES = ("traffic light", "traffic sign")  # classes that are not road users
_MIN_PROBABILITY = 0.25  # smallest probability of contact of a headline, as of the amber marks in the overlay

_MIN_SIGNIFICANCE = 2.0
"""Smallest closing speed in its standard deviations of a time to collision that is a headline."""


def headlines(columns: Columns, events: Sequence[Event] | None) -> list[dict[str, Any]]:
    """Main results of a run, three: `figure`, `words`, and `time_s` of the moment in the video, None = none.

    Args:
        columns: rows of the run, with `road_columns` where they are known.
        events: events of the run; None = unknown.
    """
    is_user = ~np.isin(columns["class"], STATIC_CLASSES) & (column(columns, "track_id") > 0)
    first = _user_headline(columns, is_user) if events is None else _event_headline(events)
    return [first, _nearest_headline(columns, is_user), _collision_headline(columns, is_user)]


def _headline(figure: str, words: str, time_s: float | None = None) -> dict[str, Any]:
    return {"figure": figure, "words": words, "time_s": None if time_s is None else round(time_s, 3)}


def _row_headline(columns: Columns, row: int, figure: str, words: str) -> dict[str, Any]:
    """Headline about the object and the moment of a row."""
    time_s = float(columns["time_s"][row])
    name = f"{columns['class'][row]} {columns['track_id'][row]:.0f}"
    return _headline(figure, f"{words}: {name} at {time_words(time_s)}", time_s)


def _event_headline(events: Sequence[Event]) -> dict[str, Any]:
    if not events:
        return _headline("No event", "no collision warning, close following, hard approach, cut-in or near miss")
    warnings = sorted((event for event in events if np.isfinite(event.warning_s)), key=lambda event: event.warning_s)
    n_events = counted(len(events), "event")
    if not warnings:
        return _headline(n_events, f"no warning; {', '.join(kind_counts(events))}")
    first = warnings[0]
    order = "the first" if len(warnings) > 1 else "it is"
    text = f"in {n_events}; {order} of {object_words(first)} at {time_words(first.warning_s)}"
    return _headline(counted(len(warnings), "warning"), text, first.warning_s)


def _user_headline(columns: Columns, is_user: BoolArray) -> dict[str, Any]:
    """Number of road users by class, for runs without events."""
    names = dict(zip(columns["track_id"][is_user].tolist(), columns["class"][is_user].tolist(), strict=True))
    if not names:
        return _headline("No road user", "no track was confirmed in this run")
    counts = sorted(Counter(names.values()).items())
    text = ", ".join(f"{n} \N{MULTIPLICATION SIGN} {name}" for name, n in counts)
    return _headline(counted(len(names), "road user"), f"tracked: {text}")


def _nearest_headline(columns: Columns, is_user: BoolArray) -> dict[str, Any]:
    distance_m = column(columns, "fused_m")
    rows = np.flatnonzero(is_user & np.isfinite(distance_m) & (column(columns, "observed") != 0))
    if not len(rows):
        return _headline("No distance", "no distance to a road user was measured")
    row = int(rows[np.argmin(distance_m[rows])])
    sigma_m = column(columns, "fused_sigma_m")[row]
    uncertainty = f" (± {sigma_words(sigma_m)} m)" if np.isfinite(sigma_m) else ""
    return _row_headline(columns, row, f"{distance_m[row]:.1f} m", f"smallest distance{uncertainty}")


def _collision_headline(columns: Columns, is_user: BoolArray) -> dict[str, Any]:
    """Shortest time to collision; without one, the largest probability of contact."""
    ttc_s, speed_mps = column(columns, "ttc_s"), column(columns, "closing_mps")
    is_slow = speed_mps < _MIN_SIGNIFICANCE * column(columns, "closing_sigma_mps")  # False where sigma is unknown
    rows = np.flatnonzero(is_user & np.isfinite(ttc_s) & is_on_course(columns) & ~is_slow)
    if len(rows):
        row = int(rows[np.argmin(ttc_s[rows])])
        return _row_headline(columns, row, f"{ttc_s[row]:.1f} s", "shortest time to collision")
    probability = np.where(is_user, column(columns, "contact_probability"), np.nan)
    row = int(np.nanargmax(probability)) if np.isfinite(probability).any() else -1
    if row < 0 or probability[row] < _MIN_PROBABILITY:
        return _headline("No collision course", "no road user approached the path of the camera's vehicle")
    return _row_headline(columns, row, f"{100 * probability[row]:.0f} %", "largest probability of contact")


def run_line(summary: Mapping[str, Any], columns: Columns, duration_s: float) -> str:
    """Duration, frames and number of road users of a run in one line."""
    n = len(np.unique(columns["track_id"][~np.isin(columns["class"], STATIC_CLASSES)]))
    frames = tables.figure(summary, "frames")
    parts = [
        f"{time_words(duration_s)} of video" if duration_s > 0 else "",
        counted(int(frames), "frame") if frames is not None else "",
        counted(n, "road user"),
    ]
    return ", ".join(part for part in parts if part)
