"""The paper's filter: distance alone, as uncertain as 0.1 in everything, moved on by the ego speed.

    d' = d - V t,  P' = P + Q        K = P / (P + R),  d = d' + K (z - d'),  P = (1 - K) P'        Q = R = 0.1

(Zhang et al., eq. 10-16.) Their eq. 15 reads d + V t, which is a target that the car drives away from; what stands
still before a moving car comes nearer by V t. R is 10 % of the distance in their words, 0.1 in their formula, and so
here. Q is per frame, whatever its length. Targets that move themselves are followed late: with V unknown all are.
"""

from __future__ import annotations

import numpy as np

from track_range.foundation.track_state import TrackState
from track_range.ranging.filtering.filtered_ranges import FilteredRanges, time_to_collision
from track_range.ranging.ranges import Ranges

_NOISE = 0.1
_MAX_GAP_S = 1.0


class PaperFilter:
    """Filters distances as `DistanceFilters` do, without regard to their sigmas."""

    def __init__(self) -> None:
        """Start without tracks."""
        self._tracks = TrackState(np.full(4, np.nan))

    def update(self, measured: Ranges, time_s: float, *, ego_speed_mps: float = np.nan) -> FilteredRanges:
        """Every track's filtered range at `time_s`; the rate is the difference to the frame before."""
        columns = self._tracks.get(measured.track_id)
        distance_m, variance, before_s, measured_s = columns  # views: what is written here is remembered
        distance_m[time_s - measured_s > _MAX_GAP_S] = np.nan
        before_m, dt = distance_m.copy(), time_s - before_s
        there = np.isfinite(measured.distance_m)
        fresh = there & np.isnan(distance_m)
        distance_m -= np.nan_to_num(ego_speed_mps) * np.nan_to_num(dt)
        variance += _NOISE
        gain = np.where(there, variance / (variance + _NOISE), 0.0)
        innovation = np.where(there, measured.distance_m - distance_m, 0.0)
        distance_m[:] = np.where(fresh, measured.distance_m, distance_m + gain * innovation)
        variance[:] = np.where(fresh, _NOISE, (1 - gain) * variance)
        before_s[:] = time_s
        measured_s[there] = time_s
        is_recent = time_s - self._tracks.known[-1] <= _MAX_GAP_S
        self._tracks.put(measured.track_id, columns, keep=is_recent)
        with np.errstate(divide="ignore", invalid="ignore"):  # no step, no rate
            rate_mps = np.where(dt > 0, (distance_m - before_m) / dt, np.nan)
            rate_variance = np.where(np.isfinite(rate_mps), 2 * variance / dt**2, np.nan)
        variances = (variance, 0 * rate_variance, rate_variance)
        ttc_s, ttc_sigma_s = time_to_collision(distance_m, rate_mps, variances=variances)
        ranges = Ranges(measured.track_id, distance_m, np.sqrt(variance + 0 * distance_m))
        return FilteredRanges(ranges, rate_mps, np.sqrt(rate_variance), ttc_s, ttc_sigma_s)
