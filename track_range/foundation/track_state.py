"""TrackState: numbers kept per track from frame to frame, in arrays whose last axis is the tracks."""

from __future__ import annotations

import numpy as np

from track_range.foundation.arrays import BoolArray, FloatArray, IntArray


class TrackState:
    """The state of every known track: arrays (..., N) with one column per track, found by track id."""

    def __init__(self, initial: FloatArray) -> None:
        """Start without tracks; `initial` (...) is the state of a track that is not known."""
        self._columns = initial[..., None]  # of the known tracks, then the initial state
        self._column_of: dict[int, int] = {}

    @property
    def known(self) -> FloatArray:
        """(..., K) state of all known tracks, in the order that the mask of `put` follows."""
        return self._columns[..., :-1]

    def get(self, track_id: IntArray) -> FloatArray:
        """(..., N) copy of the state of these tracks."""
        return self._columns.take([self._column_of.get(one, -1) for one in track_id.tolist()], axis=-1)

    def put(self, track_id: IntArray, state: FloatArray, *, keep: BoolArray) -> None:
        """Set the state (..., N) of these tracks; of the others only those where `keep` (K,) holds stay known."""
        present = track_id.tolist()
        absent = {one: column for one, column in self._column_of.items() if keep[column]}
        for one in present:
            absent.pop(one, None)
        self._columns = np.concatenate([state, self._columns[..., [*absent.values(), -1]]], axis=-1)
        self._column_of = {one: column for column, one in enumerate((*present, *absent))}
