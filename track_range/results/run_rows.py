"""RunRows: rows and events of the finished frames of a run, or of any other sequence of frame results."""

from __future__ import annotations

from dataclasses import dataclass, field

from track_range.pipeline.frame_result import FrameResult
from track_range.results.events.event import Event
from track_range.results.events.finder import EventFinder
from track_range.results.table import RunTable


@dataclass(slots=True, kw_only=True)
class RunRows:
    """Rows and events of the finished frames.

    Attributes:
        fps: nominal frame rate, for the duration of the last frame; 0 = unknown.
        finder: finds the events.
        table: the rows.
        events: events that have ended; after `finish` all events, in the order of their starts.
        frame_index: numbers of the frames.
        ego_mps: ego speed at the frames, NaN = unknown.
        methods: names of the distances that were measured in any frame.
        starts_s: time of the first frame.
        last_s: time of the last frame.
    """

    fps: float = 0.0
    finder: EventFinder = field(default_factory=EventFinder)
    table: RunTable = field(default_factory=RunTable)
    events: tuple[Event, ...] = ()
    frame_index: list[int] = field(default_factory=list)
    ego_mps: list[float] = field(default_factory=list)
    methods: set[str] = field(default_factory=set)
    starts_s: float = 0.0
    last_s: float = 0.0

    def __len__(self) -> int:
        """Number of frames."""
        return len(self.frame_index)

    def add(self, result: FrameResult) -> tuple[Event, ...]:
        """Add a finished frame, and return the events that ended before it.

        Raises:
            OutputError: its rows cannot be stored; they are not added.
        """
        self.table.append(result)
        ended = self.finder.update(result)
        self.events += ended
        self.last_s = result.time_s
        if not self.frame_index:
            self.starts_s = result.time_s
        self.frame_index.append(result.index)
        self.ego_mps.append(result.ego_mps)
        self.methods.update(result.ranges)
        return ended

    def finish(self) -> None:
        """End the search for events after the last frame: `events` then contains those in progress as well."""
        self.events = self.finder.finish()

    @property
    def seconds(self) -> float:
        """Duration of the frames in seconds, that of the last one included."""
        return self.last_s - self.starts_s + (1 / self.fps if self.fps else 0.0) if self.frame_index else 0.0
