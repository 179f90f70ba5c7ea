"""BelievedSizes: how the believed size of each object changed, which is no motion.

    s = log z + log h        z: distance by a method, h: height of the box
                             s: believed size, up to a constant

A rigid object keeps its size, so that its motion along the axis shows in h alone. A distance by an
assumed size also changes with the assumption: the body type that the views of a truck suggest, the
height of the road, a horizon. That change is common to all distances of the track so far, and the
filter scales its state by it, instead of reading a speed from it.

A Kalman filter follows s as a random walk, whose variance grows with that of the size: the size of
a truck is less known than that of a car, and its belief changes more. Its state also has the s_0 of
the first frame, since noise that both estimates share, as in the first frames, is no change:

    x = [s s_0]'    H = [1 0]    change of the belief = that of s - s_0
"""

import numpy as np

from track_range.foundation.arrays import FloatArray, IntArray
from track_range.foundation.track_state import TrackState

# growth of the variance of s per second, as a fraction of the systematic variance of the distance;
# chosen on KITTI's sequences
_DRIFT_HZ = 0.1
_MAX_GAP_S = 1.0  # longest time without s, after which the belief starts again


class BelievedSizes:
    """Log sizes of all tracks of a video, as M methods believe them."""

    def __init__(self, n_methods: int) -> None:
        """Start without tracks."""
        self._tracks = TrackState(np.full((4, n_methods), np.nan))

    def update(
        self,
        track_id: IntArray,
        size_px_m: FloatArray,
        time_s: float,
        *,
        independent: FloatArray,
        systematic: FloatArray,
    ) -> FloatArray:
        """(M, N) factors of the believed sizes of N tracks since the previous frame, 1 = unknown.

        `size_px_m` (M, N) are distances by M methods times the heights of boxes, NaN = none, with
        the `independent` and `systematic` variances of the logarithms of the distances.
        """
        s, P_ss, P_s0, seen_s = last = self._tracks.get(track_id)
        size, elapsed_s = np.log(size_px_m), time_s - seen_s
        is_seen = np.isfinite(size)
        is_known = is_seen & (elapsed_s <= _MAX_GAP_S)
        P_ss = P_ss + _DRIFT_HZ * systematic * elapsed_s
        nu, S = size - s, P_ss + independent
        change = np.where(is_known, (P_ss - P_s0) / S * nu, 0.0)
        left = independent / S
        first = [size, independent, independent]
        now = np.where(is_known, [s + P_ss / S * nu, left * P_ss, left * P_s0], first)
        state = np.where(is_seen, [*now, np.full(size.shape, time_s)], last)
        is_recent = (time_s - self._tracks.known[-1] <= _MAX_GAP_S).any(axis=0)
        self._tracks.put(track_id, state, keep_known=is_recent)
        return np.asarray(np.exp(change))
