"""What is remembered of tracks from frame to frame: parallel arrays, one row per track."""

from __future__ import annotations

from dataclasses import dataclass, fields
from typing import Self

import numpy as np

from detection.detections import BoolArray, IntArray


@dataclass(slots=True)
class TrackRows:
    """Arrays with one row per track; what is remembered of it comes with the subclass.

    Attributes:
        track_id: (N,) unique.
    """

    track_id: IntArray

    def recalling(self, known: Self) -> Self:
        """These rows, those of tracks that are known replaced by what is known of them; in place."""
        _, here, there = np.intersect1d(self.track_id, known.track_id, assume_unique=True, return_indices=True)
        for field in fields(self):
            getattr(self, field.name)[here] = getattr(known, field.name)[there]
        return self

    def with_absent(self, known: Self, *, is_recent: BoolArray) -> Self:
        """These rows, and the recent ones of `known` that are not here: what the next frame may ask for."""
        absent = np.flatnonzero(is_recent & ~np.isin(known.track_id, self.track_id))
        names = [field.name for field in fields(self)]
        return type(self)(*(np.concatenate([getattr(self, name), getattr(known, name)[absent]]) for name in names))
