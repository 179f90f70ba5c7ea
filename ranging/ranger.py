"""Ranger: measures the distances of a frame's tracks; one implementation per ranging method."""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Mapping
from typing import Any

from track_range.detection.lanes.lines import LaneLines
from track_range.foundation.arrays import FloatArray32
from track_range.ranging.ranges import Ranges
from track_range.stereo.geometry.frames import Frame
from track_range.tracking.tracks import Tracks


class Ranger(ABC):
    """Measures the distance of each track of a frame; may keep state per track, by the tracks' ids.

    Only `measure` is required. The other members are hooks that a run calls or reads; their defaults do nothing.
    In each frame a run calls `start` (in another thread, perhaps a few frames ahead), `update_lanes` where the lane
    finder has run on the frame, and `measure_with`; after the last frame `close`.

    Attributes:
        background_s: seconds of work so far in the ranger's own threads; a run adds them to the time of its stage.
        disparity: (H, W) px, dense disparity of the frame measured last, NaN = unknown, in the left image, for the
            overlay; None = the method computes none.
    """

    background_s: float = 0.0
    disparity: FloatArray32 | None = None

    @abstractmethod
    def measure(self, tracks: Tracks, frame: Frame) -> Ranges:
        """Distances of N tracks in their order, NaN = not measured."""

    def measure_with(self, tracks: Tracks, frame: Frame, others: Mapping[str, Ranges]) -> Ranges:
        """As `measure`, given the ranges of the same tracks in the same frame by methods measured before.

        Args:
            tracks: N tracks.
            frame: the images.
            others: by method name, those of `RangingMethod.reads` that have measured in this run.
        """
        return self.measure(tracks, frame)

    def start(self, frame: Frame) -> None:  # noqa: B027
        """Begin work on a frame in the background, before its tracks are known; `measure` of the frame follows."""

    def update_lanes(self, lines: LaneLines) -> None:  # noqa: B027
        """Take in newly found lines of the own lane, a few times per second; they hold until the next call."""

    def close(self) -> None:  # noqa: B027
        """End threads and release what they hold; nothing is measured afterwards."""

    @property
    def notes(self) -> tuple[str, ...]:
        """Sentences for the user at the end of a run."""
        return ()

    def summary(self) -> dict[str, Any]:
        """Entries for the top level of summary.json: JSON values under keys that no other part uses."""
        return {}
