"""Health: what the notes of a pipeline say, as codes with a severity and the time since when.

The sentences and their codes are made in one place each (`foundation.errors.Note`), so that a
program may switch on a code.
"""

import math
from collections.abc import Iterable
from dataclasses import asdict, dataclass
from typing import Any

from track_range.foundation.errors import Note, Severity

_RANK: dict[Severity, int] = {"ok": 0, "warning": 1, "error": 2}


@dataclass(frozen=True, slots=True)
class HealthItem:
    """One thing that a pipeline knows about its inputs or itself.

    Attributes:
        code: its name, such as "right-camera-moved"; "note" = a sentence without a code.
        severity: "ok", "warning" or "error".
        sensor: "left", "right", "pair", "speed", "detector", "calibration", "methods" or
            "pipeline".
        since_s: time of the frame since which it is known, within a second.
        sentence: the note for the user.
    """

    code: str
    severity: Severity
    sensor: str
    since_s: float
    sentence: str


@dataclass(frozen=True, slots=True)
class Health:
    """The state of a pipeline, see `tr.Pipeline.health`."""

    items: tuple[HealthItem, ...] = ()  # in the order of the notes

    @property
    def severity(self) -> Severity:
        """The worst severity of all items; "ok" without any."""
        return self._worst(self.items)

    @property
    def sensors(self) -> dict[str, Severity]:
        """The worst severity by sensor, of those that have an item."""
        names = dict.fromkeys(item.sensor for item in self.items)
        return {name: self.of(name) for name in names}

    @property
    def codes(self) -> frozenset[str]:
        """All codes."""
        return frozenset(item.code for item in self.items)

    def of(self, sensor: str) -> Severity:
        """The worst severity of the items of a sensor; "ok" without any."""
        return self._worst(item for item in self.items if item.sensor == sensor)

    def to_list(self) -> list[dict[str, Any]]:
        """The items for JSON; an unknown time is null."""
        return [
            {**asdict(item), "since_s": None if math.isnan(item.since_s) else item.since_s}
            for item in self.items
        ]

    @staticmethod
    def _worst(items: Iterable[HealthItem]) -> Severity:
        return max((item.severity for item in items), key=_RANK.__getitem__, default="ok")


def health_of(
    notes: Iterable[str], before: Health | None = None, time_s: float = math.nan
) -> Health:
    """The health by the notes after a frame at `time_s`; what was known `before` keeps its time."""
    known = {(item.code, item.sensor): item.since_s for item in (before or Health()).items}
    items = []
    for text in notes:
        note = text if isinstance(text, Note) else Note(text)
        since_s = known.get((note.code, note.sensor), time_s)
        items.append(HealthItem(note.code, note.severity, note.sensor, since_s, str(note)))
    return Health(tuple(items))
