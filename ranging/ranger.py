"""The seam between identities and metres: one implementation per method of measuring distance."""

from __future__ import annotations

from typing import Protocol

from track_range.ranging.ranges import Ranges
from track_range.stereo.geometry.frames import Frame
from track_range.tracking.tracks import Tracks


class Ranger(Protocol):
    """Measures how far each track of a frame is; may remember its tracks by their ids."""

    def measure(self, tracks: Tracks, frame: Frame) -> Ranges:
        """One distance per track, in the tracks' order, NaN where this method cannot tell."""
        ...


class OncePerFrame:
    """A ranger whose answer several others want: the same tracks of the same frame are measured once."""

    def __init__(self, ranger: Ranger) -> None:
        """Ask `ranger`, and remember what it said last."""
        self._ranger = ranger
        self._last: tuple[Tracks, int, Ranges] | None = None

    def measure(self, tracks: Tracks, frame: Frame) -> Ranges:
        """What the ranger says of them."""
        if self._last is None or self._last[0] is not tracks or self._last[1] != frame.index:
            self._last = tracks, frame.index, self._ranger.measure(tracks, frame)
        return self._last[2]
