"""Distance, closing speed and time to collision per track: one Kalman filter per track, all tracks as arrays.

    x = [d, v]    F = [1 dt; 0 1]    Q = q [dt^3/3 dt^2/2; dt^2/2 dt]
    z = log d     H = [1/d 0]        R = lambda (share sigma / d)^2

d is the distance, v its rate (m/s, negative = closing). z is a logarithm since a box's size in pixels is what jumps:
a small box that looks smaller still is far too far away, and also says that it is uncertain, so that a filter in metres
would believe the near ones more. Where the ego speed V is known, v + V, the target's own speed, is what stays:
d' = d + v dt - dV dt / 2, v' = v - dV, and a new track begins with a target that may stand still, v = -V.

A method's sigma has a part that changes from frame to frame (box jitter, matching noise) and a part that a track keeps
(a tall car stays a tall car): only the first averages out, so it alone is R, with a factor lambda that the method's own
innovations tell (`noise_scale.py`), and the second is added to the filter's own variance afterwards. Distance and speed
share it, so the time to collision d / -v has none of it. Where a measurement comes about in another way than the one
before (a method joined or left the fusion), the kept part is another one, too: its variance is given to d, so that the
step is taken for what it is and not for speed. A measurement beyond 3 sigma is not thrown away but counts less, in
proportion (Huber); three in a row mean that the filter is wrong, and it starts anew. The steps are true time steps.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np

from track_range.foundation.arrays import BoolArray, FloatArray, IntArray
from track_range.foundation.track_state import TrackState
from track_range.ranging.filtering.filtered_ranges import FilteredRanges, time_to_collision
from track_range.ranging.filtering.noise_scale import NoiseScale
from track_range.ranging.ranges import Ranges

_LEAST_NOISE_SHARE = 0.1
"""No measurement is quite free of noise, even where its method says so."""

_NEAREST_M = 0.3
"""Nothing is predicted to be nearer: a track that runs through the camera is a new one."""


@dataclass(frozen=True, slots=True, kw_only=True)
class FilterSettings:
    """Settings of a distance filter.

    Attributes:
        acceleration_noise: q is its square: how far the speed wanders, m/s per root second.
        initial_rate_sigma_mps: how unknown the rate of a new track is,
        target_speed_sigma_mps: and where the ego speed is known the target's own speed: many stand still.
        noise_share: part of sigma that is independent from frame to frame, of a method that does not tell: where
            learning it starts.
        learns_noise: whether the innovations may correct it.
        outlier_sigma: innovations beyond so many standard deviations count less.
        max_outliers: so many of them in a row start the track's filter anew.
        max_gap_s: a track without a measurement for longer is NaN, and starts anew.
        max_rate_sigma_mps: the rate is NaN while less certain,
        min_steady_s: and for so long after the filter's start or a change of way: a false alarm costs more than a
            late one.
    """

    acceleration_noise: float = 1.5
    initial_rate_sigma_mps: float = 12.0
    target_speed_sigma_mps: float = 8.0
    noise_share: float = 0.6
    learns_noise: bool = True
    outlier_sigma: float = 3.0
    max_outliers: int = 3
    max_gap_s: float = 1.0
    max_rate_sigma_mps: float = 1.5
    min_steady_s: float = 0.35


@dataclass(frozen=True, slots=True)
class _State:
    """What each method's filter knows of each track: (M, N) views of (12, M, N) columns, which change with them."""

    distance_m: FloatArray
    rate_mps: FloatArray
    variance: FloatArray  # of the distance,
    covariance: FloatArray  # of both,
    rate_variance: FloatArray  # and of the rate
    kept_variance: FloatArray  # relative to the squared distance
    time_s: FloatArray
    measured_s: FloatArray
    ego_mps: FloatArray
    n_outliers: FloatArray
    way: FloatArray
    steady_since_s: FloatArray


_BLANK = np.array([np.nan, np.nan, 0.0, 0.0, 0.0, np.nan, np.nan, np.nan, np.nan, 0.0, 0.0, np.nan])
"""The state of a new track."""


@dataclass(frozen=True, slots=True)
class _Measured:
    """A frame's measurements as the filters see them, (M, N): variances are of the logarithm."""

    distance_m: FloatArray
    noise: FloatArray
    kept: FloatArray
    there: BoolArray


@dataclass(frozen=True, slots=True)
class _Innovation:
    """(M, N) how far measurements are from their predictions, in metres: d (z - log d); NaN = no filter or measure.

    `excess` is its size in units of the largest one that counts fully.
    """

    step_m: FloatArray
    noise_m2: FloatArray
    excess: FloatArray


class DistanceFilters:
    """The filters of several methods for all tracks of a video; a track is remembered through short absences."""

    def __init__(self, noise_shares: Mapping[str, float], settings: FilterSettings | None = None) -> None:
        """Start without tracks; `noise_shares` has the methods' names, and `FilterSettings.noise_share` for each."""
        self._settings = settings or FilterSettings()
        self._methods = tuple(noise_shares)
        self._shares = np.array(list(noise_shares.values()))[:, None] ** 2
        self._noise = NoiseScale(len(self._methods))
        self._tracks = TrackState(np.repeat(_BLANK[:, None], len(self._methods), axis=1))

    @property
    def noise_shares(self) -> dict[str, float]:
        """As at the start, as far as they are known by now."""
        shares = np.sqrt(self._shares * self._noise.factor)[:, 0]
        return dict(zip(self._methods, shares.tolist(), strict=True))

    def update(
        self,
        by_method: Mapping[str, Ranges],
        time_s: float,
        *,
        ways: Mapping[str, IntArray] | None = None,
        ego_speed_mps: float = math.nan,
    ) -> dict[str, FilteredRanges]:
        """Predict to `time_s`, take in the measurements (NaN = none), and give every track's filtered ranges.

        Args:
            by_method: distances and their whole sigmas, of the same tracks in the same order; others are ignored.
            time_s: of the frame; never earlier than the last one.
            ways: of methods that have several, (N,) a number for how each measurement came about.
            ego_speed_mps: of the camera along its axis, now; NaN = unknown.
        """
        given = [name for name in self._methods if name in by_method]
        if not given:
            return {}
        track_id = by_method[given[0]].track_id
        columns = self._tracks.get(track_id)
        state, seen = _State(*columns), self._seen(by_method, len(track_id))
        self._predict(state, time_s, ego_speed_mps)
        self._take_ways(state, seen, ways or {})
        found = self._innovation(state, seen)
        self._count_outliers(state, seen, found)
        is_lost = np.isnan(state.distance_m) | (state.n_outliers >= self._settings.max_outliers)
        known, fresh = seen.there & ~is_lost, seen.there & is_lost
        self._learn(state, found, use=known)
        self._correct(state, found, known)
        if fresh.any():
            self._start(state, seen, fresh)
        np.copyto(state.measured_s, time_s, where=seen.there)
        np.copyto(state.kept_variance, seen.kept, where=seen.there)
        is_recent = time_s - _State(*self._tracks.known).measured_s <= self._settings.max_gap_s
        self._tracks.put(track_id, columns, keep=np.logical_or.reduce(is_recent))
        results = self._results(state, track_id)
        return {name: results[name] for name in given}

    def _seen(self, by_method: Mapping[str, Ranges], n: int) -> _Measured:
        distance_m, sigma_m = np.full((2, len(self._methods), n), np.nan)
        share = np.repeat(self._shares, n, axis=1)  # of the variance: what is new in every frame
        for i, name in enumerate(self._methods):
            if name in by_method:
                one = by_method[name]
                distance_m[i], sigma_m[i] = one.distance_m, one.sigma_m
                if one.sigma_kept_m is not None:
                    share[i] = np.maximum(1.0 - (one.sigma_kept_m / one.sigma_m) ** 2, _LEAST_NOISE_SHARE**2)
        there = np.isfinite(distance_m) & (distance_m > 0) & (sigma_m > 0)
        distance_m = np.where(there, distance_m, np.nan)
        variance, factor = (sigma_m / distance_m) ** 2, self._noise.factor
        kept = 1 - share * np.minimum(factor, 1.0)  # noise that is not there was not told as noise, but as doubt
        return _Measured(distance_m, share * factor * variance, kept * variance, there)

    def _predict(self, state: _State, time_s: float, ego_speed_mps: float) -> None:
        dt = np.fmax(time_s - state.time_s, 0.0)  # NaN: a new track
        faster_mps = ego_speed_mps - state.ego_mps
        faster_mps[np.isnan(faster_mps)] = 0.0  # unknown before or now
        state.distance_m[:] += dt * (state.rate_mps - faster_mps / 2)
        state.rate_mps[:] -= faster_mps
        is_over = (time_s - state.measured_s > self._settings.max_gap_s) | (state.distance_m < _NEAREST_M)
        state.distance_m[is_over] = state.rate_mps[is_over] = np.nan
        wander = self._settings.acceleration_noise**2 * dt
        reached = state.covariance + dt * state.rate_variance
        state.variance[:] += dt * (state.covariance + reached + wander * dt / 3)
        state.covariance[:] = reached + wander * dt / 2
        state.rate_variance[:] += wander
        state.time_s[:] = time_s
        state.ego_mps[:] = ego_speed_mps

    def _take_ways(self, state: _State, seen: _Measured, ways: Mapping[str, IntArray]) -> None:
        """Where the way is another one, what the old and the new one keep may be the step between them."""
        for name, way in ways.items():
            i = self._methods.index(name)
            is_another = seen.there[i] & (way != state.way[i]) & np.isfinite(state.distance_m[i])
            kept = (state.kept_variance[i] + seen.kept[i])[is_another]
            state.variance[i, is_another] += state.distance_m[i, is_another] ** 2 * kept
            state.steady_since_s[i, is_another] = state.time_s[i, is_another]
            np.copyto(state.way[i], way, where=seen.there[i])

    def _innovation(self, state: _State, seen: _Measured) -> _Innovation:
        step_m = state.distance_m * np.log(seen.distance_m / state.distance_m)
        noise_m2 = state.distance_m * state.distance_m * seen.noise
        largest_m = self._settings.outlier_sigma * np.sqrt(state.variance + noise_m2)
        return _Innovation(step_m, noise_m2, np.abs(step_m) / largest_m)

    def _count_outliers(self, state: _State, seen: _Measured, found: _Innovation) -> None:
        """A measurement that fits ends the row."""
        np.copyto(state.n_outliers, (found.excess > 1) * (state.n_outliers + 1), where=seen.there)

    def _is_steady(self, state: _State) -> BoolArray:
        return np.asarray(state.time_s - state.steady_since_s >= self._settings.min_steady_s)  # NaN: not yet begun

    def _learn(self, state: _State, found: _Innovation, *, use: BoolArray) -> None:
        if self._settings.learns_noise:
            steady = use & self._is_steady(state)
            self._noise.learn(found.step_m * found.step_m, state.variance, noise=found.noise_m2, use=steady)

    def _correct(self, state: _State, found: _Innovation, known: BoolArray) -> None:
        total_m2 = state.variance + found.noise_m2 * np.maximum(1.0, found.excess) ** 2
        weight, step_m = np.where(known, (1.0 / total_m2, found.step_m), 0.0)
        of_distance, of_rate = weight * state.variance, weight * state.covariance
        state.distance_m[:] = np.maximum(state.distance_m + of_distance * step_m, _NEAREST_M)
        state.rate_mps[:] += of_rate * step_m
        state.rate_variance[:] -= of_rate * state.covariance
        state.covariance[:] -= of_distance * state.covariance
        state.variance[:] -= of_distance * state.variance

    def _start(self, state: _State, seen: _Measured, fresh: BoolArray) -> None:
        is_known = np.isfinite(state.ego_mps[fresh])
        sigma_mps = np.where(is_known, self._settings.target_speed_sigma_mps, self._settings.initial_rate_sigma_mps)
        state.n_outliers[fresh] = 0.0
        state.steady_since_s[fresh] = state.time_s[fresh]
        state.distance_m[fresh] = seen.distance_m[fresh]
        state.rate_mps[fresh] = np.where(is_known, -state.ego_mps[fresh], 0.0)
        state.variance[fresh] = seen.distance_m[fresh] ** 2 * seen.noise[fresh]
        state.covariance[fresh] = 0.0
        state.rate_variance[fresh] = sigma_mps**2

    def _results(self, state: _State, track_id: IntArray) -> dict[str, FilteredRanges]:
        sigma_m = np.sqrt(state.variance + state.kept_variance * state.distance_m**2)
        certain = (state.rate_variance <= self._settings.max_rate_sigma_mps**2) & self._is_steady(state)
        rate_mps = np.where(certain, state.rate_mps, np.nan)
        rate_sigma_mps = np.sqrt(state.rate_variance + state.kept_variance * rate_mps**2)
        variances = (state.variance, state.covariance, state.rate_variance)
        ttc_s, ttc_sigma_s = time_to_collision(state.distance_m, rate_mps, variances=variances)
        columns = zip(state.distance_m, sigma_m, rate_mps, rate_sigma_mps, ttc_s, ttc_sigma_s, strict=True)
        return {
            name: FilteredRanges(Ranges(track_id, distance_m, sigma_m), *motion)
            for name, (distance_m, sigma_m, *motion) in zip(self._methods, columns, strict=True)
        }


class DistanceFilter:
    """The filter of one method, see `DistanceFilters`."""

    def __init__(self, settings: FilterSettings | None = None) -> None:
        """Start without tracks."""
        settings = settings or FilterSettings()
        self._filters = DistanceFilters({"": settings.noise_share}, settings)

    @property
    def noise_share(self) -> float:
        """As in the settings, as far as it is known by now."""
        return self._filters.noise_shares[""]

    def update(
        self, measured: Ranges, time_s: float, *, way: IntArray | None = None, ego_speed_mps: float = math.nan
    ) -> FilteredRanges:
        """The filtered ranges of every track at `time_s`; `way` None = always in the same way."""
        ways = None if way is None else {"": way}
        return self._filters.update({"": measured}, time_s, ways=ways, ego_speed_mps=ego_speed_mps)[""]
