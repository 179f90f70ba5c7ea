"""The paper's filter: distance alone, as uncertain as 0.1 in everything, moved on by the ego speed.

    d' = d - V t,  P' = P + Q        K = P / (P + R),  d = d' + K (z - d'),  P = (1 - K) P'        Q = R = 0.1

(Zhang et al., eq. 10-16.) Their eq. 15 reads d + V t, which is a target that the car drives away from; what stands
still before a moving car comes nearer by V t. R is 10 % of the distance in their words, 0.1 in their formula, and so
here. Q is per frame, whatever its length. Targets that move themselves are followed late: with V unknown all are.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from detection.detections import FloatArray, IntArray
from ranging.ranges import Ranges
from ranging.remembered import TrackRows
from ranging.smoothing import FilteredRanges, time_to_collision

_NOISE = 0.1
_MAX_GAP_S = 1.0


@dataclass(slots=True)
class _State(TrackRows):
    """(N,) distance, its variance, the distance a frame ago, and when it was measured last."""

    distance_m: FloatArray
    variance: FloatArray
    time_s: FloatArray
    measured_s: FloatArray

    @classmethod
    def blank(cls, track_id: IntArray) -> _State:
        return cls(track_id, *np.full((4, len(track_id)), np.nan))


class PaperFilter:
    """As `DistanceFilter` to look at; what a measurement says of its own sigma, and of its way, is not listened to."""

    def __init__(self) -> None:
        """Start without tracks."""
        self._state = _State.blank(np.zeros(0, np.int64))

    def update(
        self, measured: Ranges, time_s: float, *, way: IntArray | None = None, ego_speed_mps: float = np.nan
    ) -> FilteredRanges:
        """Every track's filtered range at `time_s`; the rate is the difference to the frame before."""
        state = _State.blank(measured.track_id).recalling(self._state)
        state.distance_m[time_s - state.measured_s > _MAX_GAP_S] = np.nan
        before_m, dt = state.distance_m.copy(), time_s - state.time_s
        there = np.isfinite(measured.distance_m)
        fresh = there & np.isnan(state.distance_m)
        state.distance_m = state.distance_m - np.nan_to_num(ego_speed_mps) * np.nan_to_num(dt)
        state.variance = state.variance + _NOISE
        gain = np.where(there, state.variance / (state.variance + _NOISE), 0.0)
        innovation = np.where(there, measured.distance_m - state.distance_m, 0.0)
        state.distance_m = np.where(fresh, measured.distance_m, state.distance_m + gain * innovation)
        state.variance = np.where(fresh, _NOISE, (1 - gain) * state.variance)
        state.time_s = np.full(len(dt), time_s)
        state.measured_s[there] = time_s
        is_recent = time_s - self._state.measured_s <= _MAX_GAP_S
        self._state = state.with_absent(self._state, is_recent=is_recent)
        with np.errstate(divide="ignore", invalid="ignore"):  # no step, no rate
            rate_mps = np.where(dt > 0, (state.distance_m - before_m) / dt, np.nan)
            rate_variance = np.where(np.isfinite(rate_mps), 2 * state.variance / dt**2, np.nan)
        ttc_s, ttc_sigma_s = time_to_collision(
            state.distance_m, rate_mps, variances=np.stack([state.variance, 0 * rate_variance, rate_variance])
        )
        ranges = Ranges(state.track_id, state.distance_m.copy(), np.sqrt(state.variance + 0 * state.distance_m))
        return FilteredRanges(ranges, rate_mps, np.sqrt(rate_variance), ttc_s, ttc_sigma_s)
