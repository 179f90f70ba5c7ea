"""Section `events` of summary.json, and the order of events by severity."""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import Any

from track_range.results.events.event import EVENT_KINDS, Event
from track_range.results.events.files import rounded_values


def events_section(events: Sequence[Event], seconds: float) -> dict[str, Any]:
    """Number of events by kind, the most severe one, and the hours of video in which they happened.

    Args:
        events: all events of a run.
        seconds: duration of the processed video.
    """
    worst = min(events, key=severity_key, default=None)
    return {
        "n": len(events),
        "by_kind": {kind: sum(event.kind == kind for event in events) for kind in EVENT_KINDS},
        "worst": None if worst is None else rounded_values(worst),
        "hours": round(seconds / 3600, 6),
    }


def severity_key(event: Event) -> tuple[bool, float, float, float, float]:
    """Sort key of events, the most severe first.

    Events with a collision warning come before others; then the larger probability of contact, the shorter time to
    collision, the smaller distance, and the earlier peak. Unknown values come last.
    """
    return (
        math.isnan(event.warning_s),
        -_or(event.probability, 0.0),
        _or(event.min_ttc_s, math.inf),
        _or(event.min_distance_m, math.inf),
        event.peak_s,
    )


def _or(value: float, unknown: float) -> float:
    return unknown if math.isnan(value) else value
