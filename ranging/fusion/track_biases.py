"""What fusion remembers of each track: how wrong the methods are about it, where it is, how far all that is trusted.

All of a track's numbers are one column, so that remembering and recalling it is one copy.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from track_range.foundation.arrays import FloatArray


@dataclass(frozen=True, slots=True)
class TrackBiases:
    """Views of columns (M + M M + 6, N) of N tracks and M methods: what is written to them is remembered.

    Attributes:
        mean: (M, N) bias u of each method, in units of the part of its sigma that a track keeps,
        covariance: (M, M, N) of these,
        own_variance: (M, N) and its diagonal.
        log_m: (N,) log distance when it was last measured; NaN = never, and so the next two,
        variance: (N,) its variance,
        time_s: (N,) and when that was.
        trust: (N,) frames in which methods have agreed,
        n_upsets: (N,) and frames of contradiction that no past decided.
        stereo_s: (N,) when stereo counted last; NaN = never.
    """

    mean: FloatArray
    covariance: FloatArray
    own_variance: FloatArray
    log_m: FloatArray
    variance: FloatArray
    time_s: FloatArray
    trust: FloatArray
    n_upsets: FloatArray
    stereo_s: FloatArray

    @classmethod
    def in_columns(cls, columns: FloatArray, m: int) -> TrackBiases:
        """Those of `m` methods."""
        covariance = columns[m : m + m * m]
        return cls(columns[:m], covariance.reshape(m, m, -1), covariance[:: m + 1], *columns[m + m * m :])

    def forget(self, left: FloatArray) -> None:
        """Back towards u = 0 of variance 1; `left` (N,) is the share that stays."""
        squared = left * left
        self.mean[:] *= left
        self.covariance[:] *= squared
        self.own_variance[:] += 1.0 - squared


def blank_track(m: int) -> FloatArray:
    """The column of a track that nothing is known of, for `m` methods."""
    return np.concatenate([np.zeros(m), np.eye(m).ravel(), [np.nan, np.nan, np.nan, 0.0, 0.0, np.nan]])
