"""Figures from the events of clips: number by kind, and the most severe ones."""

from __future__ import annotations

import heapq
import math
from collections import Counter
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any, NamedTuple

from track_range.fleet.report.track_figures import N_RANKED, Figures
from track_range.results.events.event import CLIPS_FOLDER, EVENT_KINDS, Event, clip_name, severity_key
from track_range.results.events.files import rounded_values


class ClipEvent(NamedTuple):
    """An event of a clip; `number` is that of its row in its file, from 1."""

    clip: str
    number: int
    event: Event

    def row(self, start_utc_s: float) -> Figures:
        """Clip, number, the columns of events.csv, and Unix time of the peak (of the start: `start_utc_s`)."""
        utc_s = start_utc_s + self.event.peak_s
        values = {"clip": self.clip, "number": self.number, **rounded_values(self.event)}
        return {**values, "utc_s": utc_s if math.isfinite(utc_s) else None}


@dataclass(slots=True)
class EventFigures:
    """Events of one or more clips by kind, those with a collision warning, and the most severe ones."""

    n_by_kind: Counter[str] = field(default_factory=Counter)
    n_warnings: int = 0
    worst: list[ClipEvent] = field(default_factory=list)

    @classmethod
    def of(cls, clip: str, events: Sequence[Event]) -> EventFigures:
        """Figures of a clip."""
        return cls(
            Counter(event.kind for event in events),
            sum(math.isfinite(event.warning_s) for event in events),
            _worst(ClipEvent(clip, i + 1, event) for i, event in enumerate(events)),
        )

    def add(self, other: EventFigures) -> None:
        """Add the figures of other clips."""
        self.n_by_kind.update(other.n_by_kind)
        self.n_warnings += other.n_warnings
        self.worst = _worst([*self.worst, *other.worst])

    def by_kind(self, hours: float) -> list[Figures]:
        """Number of events, and per hour of video, of the kinds that occur."""
        counts = {kind: self.n_by_kind[kind] for kind in EVENT_KINDS if self.n_by_kind[kind]}
        return [{"kind": kind, "events": n, "per_hour": n / hours if hours else None} for kind, n in counts.items()]


def _worst(events: Iterable[ClipEvent]) -> list[ClipEvent]:
    return heapq.nsmallest(N_RANKED, events, key=lambda item: (severity_key(item.event), item.clip, item.number))


def event_video(row: Mapping[str, Any]) -> str:
    """Name of the video of an event in a row of figures among the files of its clip, if it was written."""
    return f"{CLIPS_FOLDER}/{clip_name(row['number'], row['kind'], row['track_id'])}"
