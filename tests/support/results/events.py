"""Events and a minimal finder for tests."""

from __future__ import annotations

import dataclasses
import math
from typing import Any

from track_range.pipeline.frame_result import FrameResult
from track_range.results.events.event import Event


def event(**changes: Any) -> Event:
    """A collision warning before a car."""
    values = {
        "kind": "forward_collision",
        "start_s": 1.5,
        "peak_s": 2.25,
        "end_s": 3.0,
        "warning_s": 1.75,
        "frame": 22,
        "track_id": 7,
        "class_name": "car",
        "min_distance_m": 8.125,
        "min_distance_sigma_m": 0.25,
        "min_ttc_s": 1.5,
        "closing_mps": 6.0,
        "ego_mps": 14.0,
        "probability": 0.75,
        "reason": "car ahead, closing",
    }
    others = {
        field.name: math.nan
        for field in dataclasses.fields(Event)
        if field.name not in values and field.default is dataclasses.MISSING
    }
    return Event(**{**others, **values, **changes})


class SeenFinder:
    """Finds an event of each track that has been seen: it ends after `n_frames`, or with the
    drive."""

    def __init__(self, n_frames: int = 3) -> None:
        self._n_frames = n_frames
        self._seen: dict[int, list[float]] = {}
        self._ended: dict[int, Event] = {}

    def update(self, result: FrameResult) -> tuple[Event, ...]:
        """Events that ended with this frame."""
        ended = []
        for track_id in result.tracks.track_id.tolist():
            times = self._seen.setdefault(track_id, [])
            times.append(result.time_s)
            if len(times) == self._n_frames:
                self._ended[track_id] = self._event(track_id)
                ended.append(self._ended[track_id])
        return tuple(ended)

    def finish(self) -> tuple[Event, ...]:
        """All events in the order of their starts."""
        events = [self._ended.get(track_id) or self._event(track_id) for track_id in self._seen]
        return tuple(sorted(events, key=lambda one: (one.start_s, one.track_id)))

    def _event(self, track_id: int) -> Event:
        times = self._seen[track_id]
        return event(
            track_id=track_id,
            start_s=times[0],
            peak_s=times[0],
            end_s=times[-1],
            warning_s=math.nan,
        )
