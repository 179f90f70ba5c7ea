"""TrackState: numbers stored per track from frame to frame, in arrays with the tracks on the last
axis.
"""

import numpy as np

from track_range.foundation.arrays import BoolArray, FloatArray, IntArray


class TrackState:
    """The state of every known track: arrays (..., N) with one column per track, looked up by track
    id.
    """

    def __init__(self, initial: FloatArray) -> None:
        """Start without tracks; `initial` (...) is the state of an unknown track."""
        self._columns = initial[..., None]  # of the known tracks, then the initial state
        self._ids: list[int] = []

    @property
    def known(self) -> FloatArray:
        """(..., K) state of all known tracks, in the order of the mask `keep_known` of `put`."""
        return self._columns[..., :-1]

    def get(self, track_id: IntArray) -> FloatArray:
        """(..., N) copy of the states of the tracks `track_id` (N,)."""
        ids = track_id.tolist()
        if ids == self._ids[: len(ids)]:  # the tracks of the last frame
            return self._columns[..., : len(ids)].copy()
        column_of = {key: column for column, key in enumerate(self._ids)}
        return self._columns.take([column_of.get(key, -1) for key in ids], axis=-1)

    def is_absent(self, track_id: IntArray) -> BoolArray:
        """(K,) mask of the tracks of `known` that are not in `track_id` (N,)."""
        present = set(track_id.tolist())
        return np.array([key not in present for key in self._ids], np.bool_)

    def put(self, track_id: IntArray, state: FloatArray, *, keep_known: BoolArray) -> None:
        """Set the states (..., N) of the tracks `track_id` (N,); forget all other tracks except
        `keep_known` (K,).
        """
        ids = track_id.tolist()
        n = len(ids)
        is_prefix = ids == self._ids[:n]
        if is_prefix and (n == len(self._ids) or keep_known[n:].all()):
            self._columns[..., :n] = state
            return
        present, columns = set(ids), []
        for column in keep_known.nonzero()[0].tolist():
            if self._ids[column] not in present:
                columns.append(column)
                ids.append(self._ids[column])
        self._columns = np.concatenate([state, self._columns[..., [*columns, -1]]], axis=-1)
        self._ids = ids
