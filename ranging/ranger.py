"""The seam between identities and metres: one implementation per method of measuring distance."""

from __future__ import annotations

from typing import Protocol

from ranging.ranges import Ranges
from stereo.frames import Frame
from tracking.tracks import Tracks


class Ranger(Protocol):
    """Measures how far each track of a frame is; may remember its tracks by their ids."""

    def measure(self, tracks: Tracks, frame: Frame) -> Ranges:
        """One distance per track, in the tracks' order, NaN where this method cannot tell."""
        ...
