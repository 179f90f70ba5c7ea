"""EventFinder: finds the events of a drive, frame by frame."""

from __future__ import annotations

from track_range.events.event import Event, EventSettings
from track_range.run.frame_result import FrameResult


class EventFinder:
    """Finds the events of a drive from its frames in order, live or from the rows of a run."""

    def __init__(self, settings: EventSettings | None = None) -> None:
        """Start without events; None = default settings."""
        self.settings = settings or EventSettings()
        self._ended: list[Event] = []

    def update(self, result: FrameResult) -> tuple[Event, ...]:
        """Events that ended before this frame and have not been returned yet, in the order of their ends."""
        return ()

    def finish(self) -> tuple[Event, ...]:
        """All events of the drive in the order of their starts, those in progress included; ends the drive."""
        return tuple(sorted(self._ended, key=lambda event: event.start_s))
