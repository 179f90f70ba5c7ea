"""Figures from the events of clips: number by kind, and the most severe ones."""

from __future__ import annotations

import heapq
import math
from collections import Counter
from collections.abc import Iterable, Sequence
from dataclasses import dataclass, field

from track_range.fleet.report.clip_figures import Figures
from track_range.fleet.report.track_figures import N_RANKED
from track_range.results.events.event import CLIPS_FOLDER, EVENT_KINDS, Event, clip_name, severity_key
from track_range.results.events.files import rounded_values


@dataclass(frozen=True, slots=True)
class ClipEvent:
    """An event of a clip.

    Attributes:
        clip: name of the clip.
        number: number of the event's row in its file, from 1.
        event: the event.
    """

    clip: str
    number: int
    event: Event

    @property
    def video(self) -> str:
        """Name of its video among the files of the clip, if it was written."""
        return f"{CLIPS_FOLDER}/{clip_name(self.number, self.event.kind, self.event.track_id)}"


@dataclass(slots=True)
class EventFigures:
    """Figures of the events of one or more clips.

    Attributes:
        n_by_kind: number of events by kind.
        n_warnings: number of events with a collision warning.
        worst: the most severe events.
    """

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
        return [
            {"kind": kind, "events": self.n_by_kind[kind], "per_hour": self.n_by_kind[kind] / hours if hours else None}
            for kind in EVENT_KINDS
            if self.n_by_kind[kind]
        ]


def _worst(events: Iterable[ClipEvent]) -> list[ClipEvent]:
    return heapq.nsmallest(N_RANKED, events, key=lambda item: (severity_key(item.event), item.clip, item.number))


def ranked_rows(events: Iterable[ClipEvent], starts_utc_s: dict[str, float]) -> list[Figures]:
    """Rows of ranked events: clip, number, the columns of events.csv, utc_s of the peak (None = unknown).

    Args:
        events: the events.
        starts_utc_s: Unix time of the start of each clip's video; NaN = unknown.
    """
    rows = []
    for item in events:
        utc_s = starts_utc_s.get(item.clip, math.nan) + item.event.peak_s
        known = utc_s if math.isfinite(utc_s) else None
        rows.append({"clip": item.clip, "number": item.number, **rounded_values(item.event), "utc_s": known})
    return rows
