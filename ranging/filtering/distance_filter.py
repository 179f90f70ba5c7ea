"""Distance, closing speed and time to collision per track: one Kalman filter per track, all tracks as arrays.

    x = [d, v]    F = [1 dt; 0 1]    Q = q [dt^3/3 dt^2/2; dt^2/2 dt]         (`foundation.constant_velocity`)
    z = log d     H = [1/d 0]        R = lambda (share sigma / d)^2           so nu = d (z - log d), R in metres d^2 R

d is the distance, v its rate (m/s, negative = closing). z is a logarithm since a box's size in pixels is what jumps:
a small box that looks smaller still is far too far away, and also has a large sigma, so that a filter in metres would
believe the near ones more. Where the ego speed V is known, v + V, the target's own speed, is what stays:
d' = d + v dt - dV dt / 2, v' = v - dV, and a new track begins with a target that may stand still, v = -V.

The sigma of a method has a part that is independent from frame to frame (box jitter, matching noise) and a systematic
one that a track keeps (a tall car stays a tall car): only the first averages out, so it alone is R, with a factor
lambda that is learnt from the method's own innovations (`noise_scale`), and the second is added to the filter's own
variance afterwards. Distance and speed share it, so the time to collision d / -v has none of it. Where the condition of
a measurement is another one than before (a method joined or left the fusion), the systematic error is another one, too:
both variances are given to d, so that the step is taken for what it is and not for speed. A measurement beyond 3 sigma
is not thrown away but counts less, in proportion (Huber); three in a row mean that the filter is wrong, and it
restarts. The steps are true time steps.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np

from track_range.foundation.arrays import BoolArray, FloatArray, IntArray
from track_range.foundation.constant_velocity import ConstantVelocity
from track_range.foundation.track_state import TrackState
from track_range.ranging.filtering.filtered_ranges import FilteredRanges, time_to_collision
from track_range.ranging.filtering.noise_scale import NoiseScale
from track_range.ranging.ranges import Ranges

_MIN_INDEPENDENT_SHARE = 0.1
"""Least part of sigma that is taken to be independent, also where a method declares less."""

_MIN_DISTANCE_M = 0.3
"""No track is predicted to be nearer: one that runs through the camera starts anew."""


@dataclass(frozen=True, slots=True, kw_only=True)
class FilterSettings:
    """Settings of a distance filter.

    Attributes:
        acceleration_noise: random walk of the speed, m/s per root second; q is its square.
        initial_rate_sigma_mps: standard deviation of the rate of a new track where the ego speed is unknown.
        target_speed_sigma_mps: standard deviation of a new track's own speed where the ego speed is known: many stand
            still.
        learns_noise: whether lambda is learnt from the innovations; else it is 1.
        outlier_sigma: innovations beyond so many standard deviations count less.
        max_outliers: so many of them in a row restart the track's filter.
        max_gap_s: a track without a measurement for longer is NaN, and starts anew.
        max_rate_sigma_mps: the rate is NaN while its standard deviation is larger.
        min_steady_s: the rate is NaN for so long after a start or a change of condition: a false alarm costs more than
            a late one.
    """

    acceleration_noise: float = 1.5
    initial_rate_sigma_mps: float = 12.0
    target_speed_sigma_mps: float = 8.0
    learns_noise: bool = True
    outlier_sigma: float = 3.0
    max_outliers: int = 3
    max_gap_s: float = 1.0
    max_rate_sigma_mps: float = 1.5
    min_steady_s: float = 0.35


@dataclass(frozen=True, slots=True)
class _Measured:
    """Measurements of one frame, (M, N).

    Attributes:
        distance_m: NaN where there is none, and so the variances.
        independent: variance of log distance that is new in every frame, lambda included.
        systematic: variance of log distance that a track keeps.
        valid: whether there is a measurement.
    """

    distance_m: FloatArray
    independent: FloatArray
    systematic: FloatArray
    valid: BoolArray


_INITIAL = (np.nan, np.nan, 0.0, 0.0, 0.0, np.nan, np.nan, np.nan, np.nan, 0.0, 0.0, np.nan)
"""State of a new track: d, v, P_xx, P_xv, P_vv, systematic variance, time of the state, time of the last measurement,
ego speed, outliers in a row, condition of the last measurement, time of the start or last change of condition."""

_MEASURED_S = 7


class DistanceFilters:
    """The filters of M methods for all tracks of a video; a track is remembered through short absences.

    Example:
        >>> import numpy as np, track_range as tr
        >>> filters, ids = tr.DistanceFilters({"fused": 0.35}), np.array([1])
        >>> for i in range(20):  # 10 frames per second, closing at 5 m/s
        ...     measured = {"fused": tr.Ranges(ids, np.array([40.0 - 0.5 * i]), np.array([0.5]))}
        ...     filtered = filters.update(measured, time_s=0.1 * i)["fused"]
        >>> round(float(filtered.rate_mps[0]))
        -5
    """

    def __init__(self, noise_shares: Mapping[str, float], settings: FilterSettings | None = None) -> None:
        """Start without tracks.

        Args:
            noise_shares: by method, the part of its sigma that is independent from frame to frame, where learning it
                starts; not used where `Ranges` give that part box by box.
            settings: of all filters.
        """
        self._settings = settings or FilterSettings()
        self._methods = tuple(noise_shares)
        self._independent_share = np.array(list(noise_shares.values()))[:, None] ** 2  # of the variance
        self._noise_scale = NoiseScale(len(self._methods))
        self._tracks = TrackState(np.repeat(np.array(_INITIAL)[:, None], len(self._methods), axis=1))

    @property
    def noise_shares(self) -> dict[str, float]:
        """Part of each method's sigma that is independent from frame to frame, as learnt so far."""
        shares = np.sqrt(self._independent_share * self._noise_scale.factor)[:, 0]
        return dict(zip(self._methods, shares.tolist(), strict=True))

    def update(
        self,
        by_method: Mapping[str, Ranges],
        time_s: float,
        *,
        conditions: Mapping[str, IntArray] | None = None,
        ego_speed_mps: float = math.nan,
    ) -> dict[str, FilteredRanges]:
        """The filtered ranges of every track at `time_s`, by method, after the measurements of this frame.

        Args:
            by_method: distances and their whole sigmas, of the same tracks in the same order, NaN = not measured;
                methods without a filter are ignored.
            time_s: of the frame; never earlier than the last one.
            conditions: of methods whose measurements come about in different ways, (N,) a number for each way.
            ego_speed_mps: of the camera along its axis, now; NaN = unknown.
        """
        given = [name for name in self._methods if name in by_method]
        if not given:
            return {}
        settings, track_id = self._settings, by_method[given[0]].track_id
        measured = self._measured(by_method, len(track_id))
        columns = self._tracks.get(track_id)
        state = ConstantVelocity(*columns[:5])
        systematic, state_s, measured_s, state_ego_mps, n_outliers, condition, steady_since_s = columns[5:]

        # Predict.
        dt = np.fmax(time_s - state_s, 0.0)  # 0 for a new track
        faster_mps = np.nan_to_num(ego_speed_mps - state_ego_mps)  # 0 where unknown, before or now
        state = state.predict(dt, q=settings.acceleration_noise**2)
        d, v = state.x - dt * faster_mps / 2, state.v - faster_mps
        is_over = (time_s - measured_s > settings.max_gap_s) | (d < _MIN_DISTANCE_M)
        d[is_over] = v[is_over] = np.nan

        # Change of condition: the old systematic error and the new one may be the step between them.
        is_changed = np.zeros_like(measured.valid)
        for name, number in (conditions or {}).items():
            i = self._methods.index(name)
            is_changed[i] = measured.valid[i] & (number != condition[i]) & np.isfinite(d[i])
            np.copyto(condition[i], number, where=measured.valid[i])
        P_xx = state.P_xx + np.where(is_changed, d * d * (systematic + measured.systematic), 0.0)
        steady_since_s[is_changed] = time_s

        # Gate.
        nu = d * np.log(measured.distance_m / d)
        R = d * d * measured.independent
        excess = np.abs(nu) / (settings.outlier_sigma * np.sqrt(P_xx + R))
        np.copyto(n_outliers, (excess > 1) * (n_outliers + 1), where=measured.valid)
        is_lost = np.isnan(d) | (n_outliers >= settings.max_outliers)
        known, starts = measured.valid & ~is_lost, measured.valid & is_lost
        if settings.learns_noise:
            is_steady = time_s - steady_since_s >= settings.min_steady_s
            self._noise_scale.learn(nu * nu, P_xx, noise=R, use=known & is_steady)

        # Update.
        state = ConstantVelocity(d, v, P_xx, state.P_xv, state.P_vv)
        state = state.update(nu, R * np.maximum(1.0, excess) ** 2, valid=known)
        columns[:5] = np.maximum(state.x, _MIN_DISTANCE_M), state.v, state.P_xx, state.P_xv, state.P_vv

        # Restart.
        if starts.any():
            z = measured.distance_m
            is_ego_known = math.isfinite(ego_speed_mps)
            rate_mps = -ego_speed_mps if is_ego_known else 0.0
            rate_sigma_mps = settings.target_speed_sigma_mps if is_ego_known else settings.initial_rate_sigma_mps
            initial = np.broadcast_arrays(z, rate_mps, z * z * measured.independent, 0.0, rate_sigma_mps**2)
            np.copyto(columns[:5], initial, where=starts)
            n_outliers[starts] = 0.0
            steady_since_s[starts] = time_s

        state_s[:], state_ego_mps[:] = time_s, ego_speed_mps
        np.copyto(measured_s, time_s, where=measured.valid)
        np.copyto(systematic, measured.systematic, where=measured.valid)
        is_recent = (time_s - self._tracks.known[_MEASURED_S] <= settings.max_gap_s).any(axis=0)
        self._tracks.put(track_id, columns, keep_known=is_recent)
        is_steady = time_s - steady_since_s >= settings.min_steady_s
        filtered = self._filtered(ConstantVelocity(*columns[:5]), systematic, is_steady, track_id)
        return {name: filtered[name] for name in given}

    def _measured(self, by_method: Mapping[str, Ranges], n: int) -> _Measured:
        """The measurements of N tracks; a method that is missing has measured nothing."""
        distance_m, sigma_m = np.full((2, len(self._methods), n), np.nan)
        share = np.repeat(self._independent_share, n, axis=1)
        for i, name in enumerate(self._methods):
            if name in by_method:
                ranges = by_method[name]
                distance_m[i], sigma_m[i] = ranges.distance_m, ranges.sigma_m
                if ranges.sigma_systematic_m is not None:
                    independent = 1.0 - (ranges.sigma_systematic_m / ranges.sigma_m) ** 2
                    share[i] = np.maximum(independent, _MIN_INDEPENDENT_SHARE**2)
        valid = np.isfinite(distance_m) & (distance_m > 0) & (sigma_m > 0)
        distance_m = np.where(valid, distance_m, np.nan)
        variance, factor = (sigma_m / distance_m) ** 2, self._noise_scale.factor
        # Where there is less noise than declared the rest of sigma is still uncertain: it is systematic.
        systematic = (1 - share * np.minimum(factor, 1.0)) * variance
        return _Measured(distance_m, share * factor * variance, systematic, valid)

    def _filtered(
        self, state: ConstantVelocity, systematic: FloatArray, is_steady: BoolArray, track_id: IntArray
    ) -> dict[str, FilteredRanges]:
        """Distances, rates and times to collision by method."""
        sigma_m = np.sqrt(state.P_xx + systematic * state.x**2)
        is_certain = (state.P_vv <= self._settings.max_rate_sigma_mps**2) & is_steady
        rate_mps = np.where(is_certain, state.v, np.nan)
        rate_sigma_mps = np.sqrt(state.P_vv + systematic * rate_mps**2)
        ttc_s, ttc_sigma_s = time_to_collision(state.x, rate_mps, variances=(state.P_xx, state.P_xv, state.P_vv))
        return {
            name: FilteredRanges(
                Ranges(track_id, state.x[i], sigma_m[i]), rate_mps[i], rate_sigma_mps[i], ttc_s[i], ttc_sigma_s[i]
            )
            for i, name in enumerate(self._methods)
        }
