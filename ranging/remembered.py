"""What is remembered of tracks from frame to frame: numbers in columns, one per track, found by the track's id."""

from __future__ import annotations

import numpy as np

from track_range.foundation.arrays import BoolArray, FloatArray, IntArray


class TrackMemory:
    """Numbers of every track: arrays (..., N) whose last axis are tracks; what they mean is the caller's."""

    def __init__(self, blank: FloatArray) -> None:
        """Know no track; `blank` (...) is what is said of a new one."""
        self._columns = blank[..., None]  # the last one is always the blank
        self._place: dict[int, int] = {}

    @property
    def known(self) -> FloatArray:
        """(..., K) of all tracks remembered, in any order."""
        return self._columns[..., :-1]

    def recall(self, track_id: IntArray) -> FloatArray:
        """(..., N) a copy of what is known of these tracks."""
        places = [self._place.get(one, -1) for one in track_id.tolist()]
        return self._columns.take(places, axis=-1)

    def remember(self, track_id: IntArray, columns: FloatArray, *, is_recent: BoolArray) -> None:
        """Know (..., N) of these tracks from now on, and of the (K,) recent ones of `known` that are not among them."""
        here = track_id.tolist()
        absent = {one: place for one, place in self._place.items() if is_recent[place]}
        for one in here:
            absent.pop(one, None)
        kept = self._columns[..., [*absent.values(), -1]]
        self._columns = np.concatenate([columns, kept], axis=-1)
        self._place = {one: place for place, one in enumerate((*here, *absent))}
