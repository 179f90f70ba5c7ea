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

from dataclasses import dataclass

import numpy as np

from detection.detections import BoolArray, FloatArray, IntArray
from ranging.noise_scale import NoiseScale
from ranging.ranges import Ranges
from ranging.remembered import TrackRows

MIN_CLOSING_MPS = 0.3
"""Slower than this is not closing: the time to collision would be minutes of noise."""

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
class FilteredRanges:
    """Filtered ranges, their rate, and what follows from both.

    Attributes:
        ranges: distance and sigma, NaN = no recent measurement.
        rate_mps: (N,) change of distance per second, negative = closing; NaN while unknown.
        rate_sigma_mps: (N,) its standard deviation, and so that of the closing speed, `-rate_mps`.
        ttc_s: (N,) time to collision, distance / closing speed; NaN where it does not close, or the rate is unknown.
        ttc_sigma_s: (N,) its standard deviation, to first order.
    """

    ranges: Ranges
    rate_mps: FloatArray
    rate_sigma_mps: FloatArray
    ttc_s: FloatArray
    ttc_sigma_s: FloatArray


@dataclass(slots=True)
class _State(TrackRows):
    """Parallel arrays over the tracks remembered: mean (N, 2), covariance (N, 2, 2), and (N,) each of the rest."""

    mean: FloatArray
    covariance: FloatArray
    kept_variance: FloatArray  # relative to the squared distance
    time_s: FloatArray
    measured_s: FloatArray
    ego_mps: FloatArray
    n_outliers: IntArray
    way: IntArray
    steady_since_s: FloatArray

    @classmethod
    def blank(cls, track_id: IntArray) -> _State:
        n = len(track_id)
        kept_variance, time_s, measured_s, ego_mps, steady_since_s = np.full((5, n), np.nan)
        n_outliers, way = np.zeros((2, n), np.int64)
        return cls(
            track_id=track_id,
            mean=np.full((n, 2), np.nan),
            covariance=np.zeros((n, 2, 2)),
            kept_variance=kept_variance,
            time_s=time_s,
            measured_s=measured_s,
            ego_mps=ego_mps,
            n_outliers=n_outliers,
            way=way,
            steady_since_s=steady_since_s,
        )


@dataclass(frozen=True, slots=True)
class _Measured:
    """A frame's measurements as the filter sees them: (N,) log distance, variances of it, and which there are."""

    log_m: FloatArray
    noise: FloatArray
    kept: FloatArray
    there: BoolArray


class DistanceFilter:
    """The filter of one method for all tracks of a video; a track is remembered through short absences."""

    def __init__(self, settings: FilterSettings | None = None) -> None:
        """Start without tracks."""
        self._settings = settings or FilterSettings()
        self._state = _State.blank(np.zeros(0, np.int64))
        self._noise = NoiseScale()

    @property
    def noise_share(self) -> float:
        """As in the settings, as far as it is known by now."""
        return float(self._settings.noise_share * np.sqrt(self._noise.factor))

    def update(
        self, measured: Ranges, time_s: float, *, way: IntArray | None = None, ego_speed_mps: float = np.nan
    ) -> FilteredRanges:
        """Predict to `time_s`, take in the measurements (NaN = none), and give every track's filtered range.

        Args:
            measured: distances and their whole sigmas.
            time_s: of the frame; never earlier than the last one.
            way: (N,) a number for how each measurement came about; None = always in the same way.
            ego_speed_mps: of the camera along its axis, now; NaN = unknown.
        """
        state = self._predicted(_State.blank(measured.track_id).recalling(self._state), time_s, ego_speed_mps)
        seen = self._seen(measured)
        self._take_way(state, seen, np.zeros(len(measured), np.int64) if way is None else way)
        excess = self._excess(state, seen)
        fresh = seen.there & (np.isnan(state.mean[:, 0]) | self._is_lost(state, seen, excess))
        self._learn(state, seen, ~fresh)
        self._correct(state, seen, excess, known=seen.there & ~fresh)
        self._start(state, seen, fresh)
        state.measured_s[seen.there] = time_s
        state.kept_variance[seen.there] = seen.kept[seen.there]
        is_recent = time_s - self._state.measured_s <= self._settings.max_gap_s
        self._state = state.with_absent(self._state, is_recent=is_recent)
        return self._result(state)

    def _seen(self, measured: Ranges) -> _Measured:
        there = np.isfinite(measured.distance_m) & (measured.distance_m > 0) & (measured.sigma_m > 0)
        distance_m = np.where(there, measured.distance_m, np.nan)
        variance = (measured.sigma_m / distance_m) ** 2
        share, factor = self._noise_part(measured), self._noise.factor
        kept = 1 - share * min(factor, 1.0)  # noise that is not there was not told as noise, but as doubt
        return _Measured(np.log(distance_m), share * factor * variance, kept * variance, there)

    def _noise_part(self, measured: Ranges) -> FloatArray | float:
        """Of the variance: what is new in every frame."""
        if measured.sigma_kept_m is None:
            return self._settings.noise_share**2
        told = 1.0 - (measured.sigma_kept_m / measured.sigma_m) ** 2
        return np.asarray(np.maximum(told, _LEAST_NOISE_SHARE**2))

    def _predicted(self, state: _State, time_s: float, ego_speed_mps: float) -> _State:
        dt = np.where(np.isnan(state.time_s), 0.0, time_s - state.time_s)
        faster_mps = np.nan_to_num(ego_speed_mps - state.ego_mps)  # NaN: unknown before or now
        state.mean[:, 0] += dt * (state.mean[:, 1] - faster_mps / 2)
        state.mean[:, 1] -= faster_mps
        is_over = (time_s - state.measured_s > self._settings.max_gap_s) | (state.mean[:, 0] < _NEAREST_M)
        state.mean[is_over] = np.nan
        transition = np.tile(np.eye(2), (len(dt), 1, 1))
        transition[:, 0, 1] = dt
        q = self._settings.acceleration_noise**2
        noise = q * np.stack([dt**3 / 3, dt**2 / 2, dt**2 / 2, dt], axis=1).reshape(-1, 2, 2)
        state.covariance = transition @ state.covariance @ transition.transpose(0, 2, 1) + noise
        state.time_s = np.full(len(dt), time_s)
        state.ego_mps = np.full(len(dt), ego_speed_mps)
        return state

    def _take_way(self, state: _State, seen: _Measured, way: IntArray) -> None:
        """Where the way is another one, what the old and the new one keep may be the step between them."""
        is_another = seen.there & (way != state.way) & np.isfinite(state.mean[:, 0])
        step = state.mean[:, 0] ** 2 * (state.kept_variance + seen.kept)
        state.covariance[is_another, 0, 0] += step[is_another]
        state.steady_since_s[is_another] = state.time_s[is_another]
        state.way = np.where(seen.there, way, state.way)

    def _excess(self, state: _State, seen: _Measured) -> FloatArray:
        """(N,) size of the innovation in units of the largest one that counts fully; NaN = no filter or no measure."""
        predicted = state.covariance[:, 0, 0] / state.mean[:, 0] ** 2
        innovation = np.abs(seen.log_m - np.log(state.mean[:, 0]))
        return innovation / np.sqrt(predicted + seen.noise) / self._settings.outlier_sigma

    def _is_lost(self, state: _State, seen: _Measured, excess: FloatArray) -> BoolArray:
        """(N,) whether this measurement completes a row of outliers; one that fits ends the row instead."""
        state.n_outliers = np.where(seen.there, (excess > 1) * (state.n_outliers + 1), state.n_outliers)
        return np.asarray(state.n_outliers >= self._settings.max_outliers)

    def _learn(self, state: _State, seen: _Measured, is_old: BoolArray) -> None:
        if not self._settings.learns_noise:
            return
        is_steady = state.time_s - state.steady_since_s >= self._settings.min_steady_s  # NaN: not yet begun
        squared = (seen.log_m - np.log(state.mean[:, 0])) ** 2
        predicted = state.covariance[:, 0, 0] / state.mean[:, 0] ** 2
        self._noise.learn(squared, predicted, noise=seen.noise, use=seen.there & is_old & is_steady)

    def _correct(self, state: _State, seen: _Measured, excess: FloatArray, *, known: BoolArray) -> None:
        mean, covariance = state.mean[known], state.covariance[known]
        per_m = 1 / mean[:, 0]
        noise = seen.noise[known] * np.maximum(1.0, excess[known]) ** 2
        innovation = seen.log_m[known] - np.log(mean[:, 0])
        gain = covariance[:, :, 0] * (per_m / (covariance[:, 0, 0] * per_m**2 + noise))[:, None]
        mean = mean + gain * innovation[:, None]
        mean[:, 0] = np.maximum(mean[:, 0], _NEAREST_M)
        state.mean[known] = mean
        state.covariance[known] = covariance - gain[:, :, None] * (per_m[:, None] * covariance[:, 0, :])[:, None, :]

    def _start(self, state: _State, seen: _Measured, fresh: BoolArray) -> None:
        distance_m = np.exp(seen.log_m[fresh])
        rate_mps = -np.nan_to_num(state.ego_mps[fresh])
        is_known = np.isfinite(state.ego_mps[fresh])
        sigma_mps = np.where(is_known, self._settings.target_speed_sigma_mps, self._settings.initial_rate_sigma_mps)
        variance = distance_m**2 * seen.noise[fresh]
        state.n_outliers[fresh] = 0
        state.steady_since_s[fresh] = state.time_s[fresh]
        state.mean[fresh] = np.stack([distance_m, rate_mps], axis=1)
        state.covariance[fresh] = 0.0
        state.covariance[fresh, 0, 0] = variance
        state.covariance[fresh, 1, 1] = sigma_mps**2

    def _result(self, state: _State) -> FilteredRanges:
        distance_m, rate_mps = state.mean.T.copy()
        of_distance, of_rate = state.covariance[:, 0, 0], state.covariance[:, 1, 1]
        sigma_m = np.sqrt(of_distance + state.kept_variance * distance_m**2)
        certain = np.sqrt(of_rate) <= self._settings.max_rate_sigma_mps
        certain &= state.time_s - state.steady_since_s >= self._settings.min_steady_s
        rate_mps = np.where(certain, rate_mps, np.nan)
        variances = np.stack([of_distance, state.covariance[:, 0, 1], of_rate])
        return FilteredRanges(
            Ranges(state.track_id, distance_m, sigma_m),
            rate_mps,
            np.sqrt(of_rate + state.kept_variance * rate_mps**2),
            *time_to_collision(distance_m, rate_mps, variances=variances),
        )


def time_to_collision(
    distance_m: FloatArray, rate_mps: FloatArray, *, variances: FloatArray
) -> tuple[FloatArray, FloatArray]:
    """(N,) seconds until the distance is 0 at this rate, and their sigma to first order; NaN where it does not close.

    Args:
        distance_m: (N,) distance.
        rate_mps: (N,) its rate, negative = closing.
        variances: (3, N) variance of the distance, its covariance with the rate, variance of the rate.
    """
    closes_mps = np.where(-rate_mps > MIN_CLOSING_MPS, -rate_mps, np.nan)
    ttc_s = distance_m / closes_mps
    of_distance, of_both, of_rate = variances
    relative = of_distance / distance_m**2 + 2 * of_both / (distance_m * closes_mps) + of_rate / closes_mps**2
    return ttc_s, ttc_s * np.sqrt(np.maximum(relative, 0.0))
