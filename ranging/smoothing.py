"""Distance and closing speed per track: one constant-speed Kalman filter per track, all tracks as arrays.

    x = [d, v]   F = [1 dt; 0 1]   Q = q [dt^3/3 dt^2/2; dt^2/2 dt]   z = d   R = (noise_share sigma)^2

d is the distance, v its rate (m/s, negative = closing). A method's sigma has a part that changes from frame to frame
(box jitter, matching noise) and a part that a track keeps (a tall car stays a tall car): only the first averages out,
so it alone is R, and the second is added to the filter's own variance afterwards. Where a measurement comes about in
another way than the one before (a method joined or left the fusion), the kept part is another one, too: its variance is
given to d, so that the step is taken for what it is and not for speed. A measurement beyond 3 sigma is not thrown away
but counts less, in proportion (Huber); three in a row mean that the filter is wrong, and it starts anew. The steps are
true time steps.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from detection.detections import BoolArray, FloatArray, IntArray
from ranging.ranges import Ranges


@dataclass(frozen=True, slots=True, kw_only=True)
class FilterSettings:
    """Settings of a distance filter.

    Attributes:
        acceleration_noise: q is its square: how far the speed wanders, m/s per root second.
        initial_rate_sigma_mps: how unknown the rate of a new track is.
        noise_share: part of a method's sigma that is independent from frame to frame.
        outlier_sigma: innovations beyond so many standard deviations count less.
        max_outliers: so many of them in a row start the track's filter anew.
        max_gap_s: a track without a measurement for longer is NaN, and starts anew.
        max_rate_sigma_mps: the rate is NaN while less certain,
        min_steady_s: and for so long after the filter's start or a change of way: a false alarm costs more than a
            late one.
    """

    acceleration_noise: float = 2.0
    initial_rate_sigma_mps: float = 15.0
    noise_share: float = 0.4
    outlier_sigma: float = 3.0
    max_outliers: int = 3
    max_gap_s: float = 1.0
    max_rate_sigma_mps: float = 3.0
    min_steady_s: float = 0.35


@dataclass(frozen=True, slots=True)
class FilteredRanges:
    """Filtered ranges and their rate.

    Attributes:
        ranges: distance and sigma, NaN = no recent measurement.
        rate_mps: (N,) change of distance per second, negative = closing; NaN while unknown.
    """

    ranges: Ranges
    rate_mps: FloatArray


@dataclass(slots=True)
class _State:
    """Parallel arrays over the tracks remembered: mean (N, 2), covariance (N, 2, 2), and (N,) each of the rest."""

    track_id: IntArray
    mean: FloatArray
    covariance: FloatArray
    kept_variance: FloatArray
    time_s: FloatArray
    measured_s: FloatArray
    n_outliers: IntArray
    way: IntArray
    steady_since_s: FloatArray

    @classmethod
    def blank(cls, track_id: IntArray) -> _State:
        n = len(track_id)
        kept_variance, time_s, measured_s, steady_since_s = np.full((4, n), np.nan)
        n_outliers, way = np.zeros((2, n), np.int64)
        return cls(
            track_id=track_id,
            mean=np.full((n, 2), np.nan),
            covariance=np.zeros((n, 2, 2)),
            kept_variance=kept_variance,
            time_s=time_s,
            measured_s=measured_s,
            n_outliers=n_outliers,
            way=way,
            steady_since_s=steady_since_s,
        )

    def rows(self, keep: IntArray) -> _State:
        return _State(*(getattr(self, name)[keep] for name in self.__slots__))

    def joined(self, other: _State) -> _State:
        pairs = ((getattr(self, name), getattr(other, name)) for name in self.__slots__)
        return _State(*(np.concatenate(pair) for pair in pairs))


class DistanceFilter:
    """The filter of one method for all tracks of a video; a track is remembered through short absences."""

    def __init__(self, settings: FilterSettings | None = None) -> None:
        """Start without tracks."""
        self._settings = settings or FilterSettings()
        self._state = _State.blank(np.zeros(0, np.int64))

    def update(self, measured: Ranges, time_s: float, *, way: IntArray | None = None) -> FilteredRanges:
        """Predict to `time_s`, take in the measurements (NaN = none), and give every track's filtered range.

        `way` (N,): a number for how each measurement came about; None = always in the same way.
        """
        state = self._predicted(self._aligned(measured.track_id), time_s)
        has_measurement = np.isfinite(measured.distance_m) & (measured.sigma_m > 0)
        way = np.zeros(len(measured), np.int64) if way is None else way
        kept_variance = (1 - self._settings.noise_share**2) * measured.sigma_m**2
        is_another = has_measurement & (way != state.way) & np.isfinite(state.mean[:, 0])
        state.covariance[is_another, 0, 0] += (state.kept_variance + kept_variance)[is_another]
        state.steady_since_s[is_another] = time_s
        state.way = np.where(has_measurement, way, state.way)
        fresh = has_measurement & (np.isnan(state.mean[:, 0]) | self._is_lost(state, measured))
        self._start(state, measured, fresh)
        self._correct(state, measured, has_measurement & ~fresh)
        state.measured_s[has_measurement] = time_s
        state.kept_variance[has_measurement] = kept_variance[has_measurement]
        absent = self._state.rows(np.flatnonzero(~np.isin(self._state.track_id, measured.track_id)))
        recent = np.flatnonzero(time_s - absent.measured_s <= self._settings.max_gap_s)
        self._state = state.joined(absent.rows(recent))
        return self._result(state)

    def _aligned(self, track_id: IntArray) -> _State:
        """The remembered rows of `track_id` in its order, blank for new tracks."""
        state = _State.blank(track_id)
        _, here, there = np.intersect1d(track_id, self._state.track_id, assume_unique=True, return_indices=True)
        for name in _State.__slots__[1:]:
            getattr(state, name)[here] = getattr(self._state, name)[there]
        return state

    def _predicted(self, state: _State, time_s: float) -> _State:
        stale = time_s - state.measured_s > self._settings.max_gap_s
        state.mean[stale] = np.nan
        dt = np.where(np.isnan(state.time_s), 0.0, time_s - state.time_s)
        state.mean[:, 0] += dt * state.mean[:, 1]
        transition = np.tile(np.eye(2), (len(dt), 1, 1))
        transition[:, 0, 1] = dt
        q = self._settings.acceleration_noise**2
        noise = q * np.stack([dt**3 / 3, dt**2 / 2, dt**2 / 2, dt], axis=1).reshape(-1, 2, 2)
        state.covariance = transition @ state.covariance @ transition.transpose(0, 2, 1) + noise
        state.time_s = np.full(len(dt), time_s)
        return state

    def _is_lost(self, state: _State, measured: Ranges) -> BoolArray:
        """(N,) whether this measurement completes a row of outliers; one that fits ends the row instead."""
        is_outlier = self._excess(state, measured) > 1  # NaN, where there is no filter or no measurement, is none
        state.n_outliers = np.where(
            np.isfinite(measured.distance_m), is_outlier * (state.n_outliers + 1), state.n_outliers
        )
        return np.asarray(state.n_outliers >= self._settings.max_outliers)

    def _excess(self, state: _State, measured: Ranges) -> FloatArray:
        """(N,) size of the innovation in units of the largest one that counts fully."""
        noise = (self._settings.noise_share * measured.sigma_m) ** 2
        innovation = np.abs(measured.distance_m - state.mean[:, 0])
        return innovation / np.sqrt(state.covariance[:, 0, 0] + noise) / self._settings.outlier_sigma

    def _start(self, state: _State, measured: Ranges, fresh: BoolArray) -> None:
        rate_variance = self._settings.initial_rate_sigma_mps**2
        noise = (self._settings.noise_share * measured.sigma_m[fresh]) ** 2
        state.n_outliers[fresh] = 0
        state.steady_since_s[fresh] = state.time_s[fresh]
        state.mean[fresh] = np.stack([measured.distance_m[fresh], np.zeros(len(noise))], axis=1)
        state.covariance[fresh] = np.stack([noise, 0 * noise, 0 * noise, 0 * noise + rate_variance], axis=1).reshape(
            -1, 2, 2
        )

    def _correct(self, state: _State, measured: Ranges, known: BoolArray) -> None:
        mean, covariance = state.mean[known], state.covariance[known]
        noise = (self._settings.noise_share * measured.sigma_m[known]) ** 2
        innovation = measured.distance_m[known] - mean[:, 0]
        noise = noise * np.maximum(1.0, self._excess(state, measured)[known]) ** 2
        gain = covariance[:, :, 0] / (covariance[:, 0, 0] + noise)[:, None]
        state.mean[known] = mean + gain * innovation[:, None]
        state.covariance[known] = covariance - gain[:, :, None] * covariance[:, None, 0, :]

    def _result(self, state: _State) -> FilteredRanges:
        sigma_m = np.sqrt(state.covariance[:, 0, 0] + state.kept_variance)
        distance_m = np.where(state.mean[:, 0] > 0, state.mean[:, 0], np.nan)
        certain = np.sqrt(state.covariance[:, 1, 1]) <= self._settings.max_rate_sigma_mps
        certain &= state.time_s - state.steady_since_s >= self._settings.min_steady_s
        ranges = Ranges(state.track_id, distance_m, np.where(np.isnan(distance_m), np.nan, sigma_m))
        return FilteredRanges(ranges, np.where(certain & np.isfinite(distance_m), state.mean[:, 1], np.nan))
