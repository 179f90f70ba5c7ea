"""CellAverages: log ratios of the distances of a network and their references, by track and range
of distances.
"""

from dataclasses import dataclass

import numpy as np

from track_range.foundation.arrays import FloatArray, IntArray
from track_range.foundation.track_state import TrackState

_CELL_LOG, _CELLS_PER_TRACK = 0.25, 64  # range of log d of a cell
_MAX_CELLS = 600  # more do not change the estimate


@dataclass(frozen=True, slots=True)
class NetworkCells:
    """Log ratios of the network's distances and those of the references, one for each track and
    range of distances (K,).
    """

    log_m: FloatArray  # mean of log d
    ratio: FloatArray  # mean of log z - log d
    variance: FloatArray  # of the mean, by the references' own errors
    n_frames: FloatArray
    squares: FloatArray  # sum of squared deviations from the mean
    noise_variance: FloatArray  # of the references in a frame
    track_id: IntArray
    class_id: IntArray


NO_CELLS = NetworkCells(*np.zeros((6, 0)), *np.zeros((2, 0), np.int64))


class CellAverages:
    """The cells of all frames so far."""

    def __init__(self) -> None:
        # number of frames, means of log d, log z / d, the reference's variance and noise, sum of
        # squared deviations, track, class
        self._state = TrackState(np.zeros(8))

    def add(self, values: FloatArray, track_id: IntArray, class_id: IntArray) -> None:
        """Add a frame's log d, log z / d, variances of the references and of their noise (4, N)."""
        if not len(track_id):
            return
        bins = np.clip(np.floor(values[0] / _CELL_LOG), 0, _CELLS_PER_TRACK - 1)
        cell = (track_id * _CELLS_PER_TRACK + bins).astype(np.int64)
        state = self._state.get(cell)
        state[0] += 1.0
        before = state[2].copy()
        state[1:5] += (values - state[1:5]) / state[0]
        state[5] += (values[1] - before) * (values[1] - state[2])
        state[6], state[7] = track_id, class_id
        stays = np.arange(self._state.known.shape[1]) < _MAX_CELLS
        self._state.put(cell, state, keep_known=stays)

    @property
    def cells(self) -> NetworkCells:
        """The averages."""
        n, log_m, ratio, variance, noise, squares, track_id, class_id = self._state.known
        ids = track_id.astype(np.int64), class_id.astype(np.int64)
        return NetworkCells(log_m, ratio, variance, n, squares, noise, *ids)
