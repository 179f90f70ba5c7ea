"""TrackState: numbers stored per track from frame to frame, in arrays with the tracks on the last axis."""

from __future__ import annotations

import numpy as np

from track_range.foundation.arrays import BoolArray, FloatArray, IntArray


class TrackState:
    """The state of every known track: arrays (..., N) with one column per track, looked up by track id."""

    def __init__(self, initial: FloatArray) -> None:
        """Start without tracks; `initial` (...) is the state of an unknown track."""
        self._columns = initial[..., None]  # of the known tracks, then the initial state
        self._column_of: dict[int, int] = {}

    @property
    def known(self) -> FloatArray:
        """(..., K) state of all known tracks, in the order of the mask `keep_known` of `put`."""
        return self._columns[..., :-1]

    def get(self, track_id: IntArray) -> FloatArray:
        """(..., N) copy of the states of the tracks `track_id` (N,)."""
        return self._columns.take([self._column_of.get(key, -1) for key in track_id.tolist()], axis=-1)

    def put(self, track_id: IntArray, state: FloatArray, *, keep_known: BoolArray) -> None:
        """Set the states (..., N) of the tracks `track_id`, and forget other tracks.

        Args:
            track_id: (N,) ids.
            state: (..., N) their new states.
            keep_known: (K,) tracks of `known` that stay known even if they are not in `track_id`.
        """
        present = track_id.tolist()
        absent = {key: column for key, column in self._column_of.items() if keep_known[column]}
        for key in present:
            absent.pop(key, None)
        self._columns = np.concatenate([state, self._columns[..., [*absent.values(), -1]]], axis=-1)
        self._column_of = {key: column for column, key in enumerate((*present, *absent))}
