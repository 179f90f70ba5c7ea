"""DistanceFilters: distance, closing speed and time to collision, with a Kalman filter per track
and method.

    x = [d, v]'   F = [1 dt; 0 1]    Q = q [dt^3/3 dt^2/2; dt^2/2 dt]         (`foundation.constant_velocity`)
    z = log d     H = [1/d 0]        R = lambda (s sigma / d)^2

d is the distance in m, v its rate (m/s, negative = closing), s the independent fraction of sigma;
time steps dt come from the frames' timestamps. The innovation and its noise are converted to
metres: nu = d (z - log d), and d^2 R. z is a logarithm because the noise is in the box size in px:
in metres, too large distances would also have too large sigmas, and short distances too much
weight. If the ego speed V is known, the target's own speed v + V is taken as constant, with dV the
change of V over the step: d' = d + v dt - dV dt / 2, v' = v - dV. The error of V, with standard
deviation sigma_V, decays over tau: dV has the variance 2 sigma_V^2 (1 - exp(-dt / tau)), which is
added to the state with the variance of dV. This variance is 0 while V does not change, since the
error of V does not change either. In turns, V is the speed with which static objects at the bearing
b come nearer, V - w b d. A new track starts as a static target, v = -V.

A filter runs for each of several models of the motion, static or with another q, and the results
are their mean (`motion_models`). The closing speed of a static object is V, whatever its size.

The sigma of a method has an independent part, new in every frame (box jitter, matching noise), and
a systematic part, constant over a track (the car is larger than average). Only the independent part
averages out, so R is this part alone, scaled by lambda, which is estimated from the innovations of
the method (`NoiseScale`). The systematic part is added to the filter's variance at the output, and
changes with the distance: P_dd grows by kappa (k d)^2 |v| dt / d, where k is its relative standard
deviation. The time to collision d / -v does not contain this part, which is common to distance and
speed. When the condition of a measurement changes (a method joins or leaves the fusion, a nearer
box begins or ceases to hide a side), so does its systematic error: the variances of the old and the
new error are added to the variance of d, so that the step does not appear as speed. A measurement
beyond 3 sigma is down-weighted (Huber); after three in a row the filter restarts.

Where the image border cuts a box, the object's far end is predicted (`cut_boxes`). The growth of
objects in the images is a further measurement (`key_distance`).
"""

import math
from collections.abc import Mapping
from dataclasses import dataclass, replace
from typing import NamedTuple

import numpy as np

from track_range.detection.classes import ROAD_CLASSES
from track_range.foundation.arrays import BoolArray, FloatArray, IntArray
from track_range.foundation.constant_velocity import ConstantVelocity
from track_range.foundation.track_state import TrackState
from track_range.ranging.filtering.cut_boxes import CutBoxes, SideState
from track_range.ranging.filtering.key_distance import Growth, KeyDistance
from track_range.ranging.filtering.motion_models import STATIC_RATE_SIGMA_MPS, MotionModels, mean_of
from track_range.ranging.ranges import Ranges

_CAR = ROAD_CLASSES.index("car")
# smallest closing speed with a time to collision; below, the time is mostly noise
MIN_CLOSING_MPS = 0.3
# of sigma; a method that declares less is filtered with this fraction
_MIN_INDEPENDENT_FRACTION = 0.1
# tau, over which errors of the ego speed are correlated; assumed: that of receivers at 1 Hz
_EGO_CORRELATION_S = 1.0
# kappa, growth of the systematic variance per change of log distance; chosen on 13 of KITTI's
# sequences
_DRIFT = 0.2
_GROWTH_EVIDENCE = 1.0  # exponent of the likelihoods of growths, whose sigma is true
_LONG_DRIFT_HZ, _IS_LONG = 0.15, np.array([name in ("truck", "bus") for name in ROAD_CLASSES])
"""Growth per second of the variance for long vehicles, whose visible sides change in turns."""

# largest relative sigma that drifts: that of shapes; more is an unknown scale, which is constant
_MAX_DRIFTING = 0.08

# a track that is predicted to be nearer has passed the camera, and its filter restarts
_MIN_DISTANCE_M = 0.3
# measurements: weight of the declared noise, and half-life of lambda
_PRIOR_SAMPLES, _MEMORY_SAMPLES = 30.0, 300.0
# smallest and largest lambda: a fifth to four times the declared standard deviation
_LIMITS = (0.2**2, 4.0**2)
_MAX_RATIO = 9.0  # largest nu^2 / S; innovations beyond 3 sigma are outliers


@dataclass(frozen=True, slots=True)
class FilteredRanges:
    """Filtered distances of one method, with their rate and the time to collision."""

    ranges: Ranges  # distance and sigma, NaN = no recent measurement
    rate_mps: FloatArray  # (N,) change of distance per second, negative = closing; NaN = unknown
    # (N,) standard deviation of the rate, and of the closing speed `-rate_mps`
    rate_sigma_mps: FloatArray
    # (N,) time to collision, distance / closing speed; NaN = not closing, or the rate is unknown
    ttc_s: FloatArray
    ttc_sigma_s: FloatArray  # (N,) standard deviation of `ttc_s`, to first order
    # distance and rate, (N,) each, also where the rate is too uncertain to be reported
    state: ConstantVelocity
    # (N,) probability that the object does not move along the axis; None = unknown
    static: FloatArray | None = None


@dataclass(frozen=True, slots=True, kw_only=True)
class FilterSettings:
    """Settings of a distance filter."""

    # of the only model if `learns_noise` is off, m/s per square root of a second
    acceleration_noise: float = 1.5
    initial_rate_sigma_mps: float = 12.0  # of the rate of a new track if the ego speed is unknown
    # of a new track's own speed if the ego speed is known: many targets are static
    target_speed_sigma_mps: float = 8.0
    # lambda and the model are estimated from the innovations; otherwise lambda is 1
    learns_noise: bool = True
    # innovations beyond this number of standard deviations are down-weighted
    outlier_sigma: float = 3.0
    max_outliers: int = 3  # consecutive outliers that restart a track's filter
    # longest time without a measurement; the track is then NaN, and its filter restarts
    max_gap_s: float = 1.0
    max_rate_sigma_mps: float = 1.5  # largest standard deviation of a reported rate; NaN above
    # time after a start or change of condition with a NaN rate, against false alarms
    min_steady_s: float = 0.35


class NoiseScale:
    """Factors lambda on the noise variances of M methods, estimated separately from the innovations
    of their filters.

        nu = z - z_predicted,   E nu^2 = S = P + lambda R   ->   lambda' = lambda * (mean of nu^2 / S with weights w)
        w = lambda R / S

    P is the variance of the prediction, R the variance of the noise that the method declares. The
    ratio nu^2 / S depends on R where R is a large part of S, and on the motion elsewhere, hence the
    weights w. The jitter of boxes differs between detectors, from half a pixel to two, and
    detectors do not report it; a single number for all tracks of a method converges fast.
    (Covariance matching, Mehra 1972.)
    """

    def __init__(self, n_methods: int = 1) -> None:
        """Start with factors of 1."""
        self.factor = np.ones((n_methods, 1))  # (M, 1) lambda
        self._ratios, self._weights = np.full((2, n_methods, 1), _PRIOR_SAMPLES)

    def learn(
        self, squared: FloatArray, predicted: FloatArray, *, noise: FloatArray, use: BoolArray
    ) -> None:
        """Update the factors with the innovations of one frame where `use`: nu^2, P and lambda R,
        (M, N) each.
        """
        S = predicted + noise
        w = np.where(use, noise / S, 0.0)
        ratio = np.where(use, squared / S, 0.0)
        decay = 0.5 ** (use.sum(axis=1, keepdims=True) / _MEMORY_SAMPLES)
        ratios = (w * np.minimum(ratio, _MAX_RATIO)).sum(axis=1, keepdims=True)
        self._ratios = self._ratios * decay + self.factor * ratios
        self._weights = self._weights * decay + w.sum(axis=1, keepdims=True)
        self.factor = (self._ratios / self._weights).clip(*_LIMITS)


class _FilterState(NamedTuple):
    """State of the filters of M methods, G models, N tracks, (M, G, N) each: the rows of
    `TrackState` in this order.
    """

    d: FloatArray  # distance, m; NaN = new track
    v: FloatArray  # its rate, m/s
    P_dd: FloatArray
    P_dv: FloatArray
    P_vv: FloatArray
    systematic: FloatArray  # systematic variance of log d at the last measurement
    time_s: FloatArray  # of the state
    measured_s: FloatArray  # time of the last measurement
    ego_mps: FloatArray
    n_outliers: FloatArray  # consecutive ones
    condition: FloatArray  # of the last measurement
    steady_since_s: FloatArray  # time of the start or of the last change of condition
    is_hidden: FloatArray  # of the last measurement; 1 = True
    q: FloatArray  # the `SideState`
    k: FloatArray
    P_dk: FloatArray
    P_vk: FloatArray
    P_kk: FloatArray
    r: FloatArray  # the `KeyDistance`
    P_dr: FloatArray
    P_vr: FloatArray
    P_rr: FloatArray
    weight: FloatArray  # probability of the model


_N, _Z = np.array(np.nan), np.array(0.0)
_NEW_TRACK = _FilterState._make(
    [_N, _N, _Z, _Z, _Z, _N, _N, _N, _N, _Z, _Z, _N, *[_Z] * 6, _N, *[_Z] * 4]
)


class DistanceFilters:
    """Kalman filters of M methods for all tracks of a video; states survive gaps up to
    `FilterSettings.max_gap_s`.

    Example:
        >>> import numpy as np, track_range as tr
        >>> filters, ids = tr.DistanceFilters({"fused": 0.35}), np.array([1])
        >>> for i in range(20):  # 10 frames per second, closing at 5 m/s
        ...     measured = {"fused": tr.Ranges(ids, np.array([40.0 - 0.5 * i]), np.array([0.5]))}
        ...     filtered = filters.update(measured, time_s=0.1 * i)["fused"]
        >>> round(float(filtered.rate_mps[0]))
        -5
    """

    def __init__(
        self, noise_shares: Mapping[str, float], settings: FilterSettings | None = None
    ) -> None:
        """Start without tracks.

        `noise_shares` are the initial independent fractions s of sigma by method, for `Ranges`
        without a systematic part per box.
        """
        self._settings = settings or FilterSettings()
        self._methods = tuple(noise_shares)
        # of the variance
        self._independent_fraction = np.array(list(noise_shares.values()))[:, None] ** 2
        self._noise_scale = NoiseScale(len(self._methods))
        self._models = MotionModels(len(self._methods))
        if not self._settings.learns_noise:
            noises = (self._settings.acceleration_noise,)
            self._models = MotionModels(len(self._methods), noises=noises, has_static=False)
        shape = (len(_NEW_TRACK), len(self._methods), len(self._models.q))
        self._tracks = TrackState(
            np.broadcast_to(np.array(_NEW_TRACK)[:, None, None], shape).copy()
        )

    @property
    def noise_shares(self) -> dict[str, float]:
        """Current estimate of the independent fraction of sigma, by method."""
        fractions = np.sqrt(self._independent_fraction * self._noise_scale.factor)[:, 0]
        return dict(zip(self._methods, fractions.tolist(), strict=True))

    def update(
        self,
        by_method: Mapping[str, Ranges],
        time_s: float,
        *,
        conditions: Mapping[str, IntArray] | None = None,
        ego_speed_mps: float = math.nan,
        ego_sigma_mps: float = math.nan,
        yaw_rad_s: float = math.nan,
        cut: CutBoxes | None = None,
        is_hidden: BoolArray | None = None,
        growth: Growth | None = None,
        class_id: IntArray | None = None,
        may_be_static: BoolArray | None = None,
    ) -> dict[str, FilteredRanges]:
        """Filtered ranges of every track at `time_s`, by method, after the measurements of this
        frame.

        Args:
            by_method: distances with their total sigmas, of the same tracks in the same order, NaN
                = not measured; methods without a filter are ignored.
            time_s: time of the frame, not earlier than the time of the previous frame.
            conditions: (N,) code of the condition of each measurement, by method; a change of the
                code is a change of the systematic error.
            ego_speed_mps: current speed of the camera along its axis; NaN = unknown.
            ego_sigma_mps: its standard deviation; NaN = 0.
            yaw_rad_s: its yaw rate, positive = to the right; NaN = 0.
            cut: boxes of the tracks that the image border cuts; None = no box is cut, and all are
                on the camera's axis.
            is_hidden: (N,) whether distances come from boxes with hidden sides
                (`have_hidden_sides`); None = no box.
            growth: growth of the tracks in the images, not used of boxes that are cut; None = not
                measured.
            class_id: (N,) road class of each track, whose motion is learnt; None = all are cars.
            may_be_static: (N,) False = the track certainly moves; None = all may be static.
        """
        if by_method.keys().isdisjoint(self._methods):
            return {}
        settings, track_id = self._settings, next(iter(by_method.values())).track_id
        z, independent, systematic, valid = self._measured(by_method, len(track_id))
        last = _FilterState._make(self._tracks.get(track_id))
        classes = np.full(len(track_id), _CAR) if class_id is None else class_id
        is_ego_known = math.isfinite(ego_speed_mps)
        models = self._models
        prior = models.prior(
            classes, is_ego_known if may_be_static is None else is_ego_known & may_be_static
        )

        # Predict.
        dt = np.fmax(time_s - last.time_s, 0.0)  # 0 for a new track
        w_b = 0.0 if cut is None else (0.0 if math.isnan(yaw_rad_s) else yaw_rad_s) * cut.bearing
        ego_mps = ego_speed_mps - w_b * np.where(np.isnan(last.d), np.fmax(z, 0.0), last.d)
        dV, dV_variance = (
            _speed_step(ego_mps - last.ego_mps, ego_sigma_mps, dt) if is_ego_known else (_Z, _Z)
        )
        state, side, q = (
            ConstantVelocity(*last[:5]),
            SideState._make(getattr(last, name) for name in SideState._fields),
            models.q,
        )
        is_side = (side.P_kk > 0) if cut is None else (side.P_kk > 0) | cut.is_cut
        if cut is not None and is_side.any():
            state, side, edge_variance = side.predicted(state, cut, dt, q=q)
            independent = independent + edge_variance
        else:
            state = state.predict(dt, q=q)
            side = side if cut is None else side._replace(q=np.broadcast_to(cut.q, dt.shape))
        d, v = state.x - dt * dV / 2, state.v - dV
        is_expired = (time_s - last.measured_s > settings.max_gap_s) | (d < _MIN_DISTANCE_M)
        d, v = np.where(is_expired.any(axis=1, keepdims=True), np.nan, (d, v))
        changing = np.abs(last.d * last.v) * _DRIFT + last.d**2 * _LONG_DRIFT_HZ * _IS_LONG[classes]
        # 0 for a new track
        drift = np.fmax(np.minimum(last.systematic, _MAX_DRIFTING**2) * changing, 0.0)
        P_dd, P_dv = (
            state.P_xx + dt * dt / 4 * dV_variance + dt * drift * settings.learns_noise,
            state.P_xv + dt / 2 * dV_variance,
        )
        P_vv = state.P_vv + dV_variance
        key = KeyDistance(
            np.where(is_side, np.nan, last.r), last.P_dr, last.P_vr, last.P_rr
        ).predicted(dt)
        possible = prior
        if is_ego_known:
            static_mps = models.start_sigma_mps(
                classes, 0.0, np.sqrt(np.fmax(last.systematic, 0.0)) * ego_mps
            )
            # A static model that follows a moving object is no longer static: no object changes to
            # it.
            is_moving = np.abs(v + ego_mps) > settings.outlier_sigma * static_mps
            possible = prior * ~(models.is_static & is_moving)
        weight = models.predicted(last.weight, possible, dt)
        # the ego speed was unknown
        joins = np.isnan(last.ego_mps) & is_ego_known & settings.learns_noise
        if joins.any():
            weight = np.where(joins & (last.weight[:, :1] == 0), prior, weight)
            joins = joins & models.is_static
            v, P_dv = np.where(joins, -ego_mps, v), np.where(joins, 0.0, P_dv)
            P_vv = np.where(joins, static_mps**2, P_vv)
            key = key._replace(P_vr=np.where(joins, 0.0, key.P_vr))

        # A change of condition: the step may be as large as the old and the new systematic error
        # together.
        condition, is_changed = last.condition, np.zeros(d.shape, np.bool_)
        for name, code in (conditions or {}).items():
            i = self._methods.index(name)
            is_changed[i] = valid[i] & (code != condition[i]) & np.isfinite(d[i])
            condition[i] = np.where(valid[i], code, condition[i])
        hidden = np.where(valid, 0.0 if is_hidden is None else is_hidden, last.is_hidden)
        may_step = is_changed | (hidden != last.is_hidden)
        if may_step.any():
            step = np.where(may_step & np.isfinite(d), d * d * (last.systematic + systematic), 0.0)
            P_dd, key = P_dd + step, key.stepped(d, step)
        steady_since_s = np.where(is_changed, time_s, last.steady_since_s)

        # Gate.
        nu = d * np.log(z / d)
        R = d * d * independent
        excess = np.abs(nu) / (settings.outlier_sigma * np.sqrt(P_dd + R))
        excess = excess.min(axis=1, keepdims=True)  # of the model that expects the measurement most
        n_outliers = np.where(valid, (excess > 1) * (last.n_outliers + 1), last.n_outliers)
        is_lost = np.isnan(d) | (n_outliers >= settings.max_outliers)
        known, starts = valid & ~is_lost, valid & is_lost
        if settings.learns_noise:
            is_steady = time_s - steady_since_s >= settings.min_steady_s
            use = (known & is_steady & ~is_side)[:, 0]
            expected = [np.where(use, mean_of(part, weight), np.nan) for part in (nu * nu, P_dd, R)]
            self._noise_scale.learn(*expected[:2], noise=expected[2], use=use)
            models.count(classes, np.where(use[:, None], weight, 0.0), dt)

        # Update.
        state = ConstantVelocity(d, v, P_dd, P_dv, P_vv)
        R = R * np.maximum(1.0, excess) ** 2
        weight = models.updated(weight, nu, P_dd + R, valid=np.asarray(known))
        side, key = side.updated(state, nu, R, valid=known), key.updated(state, nu, R, valid=known)
        state = state.update(nu, R, valid=known)
        if growth is not None:
            state, key, nu, S = key.grown(
                state, growth, valid=~is_lost, outlier_sigma=settings.outlier_sigma
            )
            is_grown = np.asarray(np.isfinite(nu).all(axis=1, keepdims=True))
            weight = models.updated(
                weight, nu, S, valid=np.asarray(is_grown), evidence=_GROWTH_EVIDENCE
            )
        state = replace(state, x=np.maximum(state.x, _MIN_DISTANCE_M))

        # Restart.
        if starts.any():
            rate_mps = -ego_mps if is_ego_known else np.zeros_like(ego_mps)
            sigma_mps = (
                settings.target_speed_sigma_mps if is_ego_known else settings.initial_rate_sigma_mps
            )
            rate_sigma_mps = np.asarray(sigma_mps)
            if settings.learns_noise and is_ego_known:
                rate_sigma_mps = models.start_sigma_mps(
                    classes, sigma_mps, np.sqrt(systematic) * rate_mps
                )
            weight = np.where(starts, prior, weight)
            initial: tuple[FloatArray | float, ...] = (
                z,
                rate_mps,
                z * z * independent,
                0.0,
                rate_sigma_mps**2,
            )
            state = ConstantVelocity(
                *(np.where(starts, *pair) for pair in zip(initial, state.columns, strict=True))
            )
            side = side._replace(
                P_dk=np.where(starts, 0.0, side.P_dk), P_vk=np.where(starts, 0.0, side.P_vk)
            )
            n_outliers, steady_since_s = (
                np.where(starts, 0.0, n_outliers),
                np.where(starts, time_s, steady_since_s),
            )
            key = key._replace(r=np.where(starts, np.nan, key.r))
        if growth is not None:
            key = key.started(state, growth.is_key)

        new = last._replace(
            **dict(zip(_FilterState._fields, state.columns, strict=False)),
            systematic=np.where(valid, systematic, last.systematic),
            time_s=np.full(d.shape, time_s),
            measured_s=np.where(valid, time_s, last.measured_s),
            ego_mps=ego_mps,
            n_outliers=n_outliers,
            condition=condition,
            steady_since_s=steady_since_s,
            is_hidden=hidden,
            weight=weight,
            **side._asdict() | key._asdict(),
        )
        is_recent = time_s - _FilterState._make(self._tracks.known).measured_s <= settings.max_gap_s
        self._tracks.put(track_id, np.array(new), keep_known=np.asarray(is_recent.any(axis=(0, 1))))
        return self._filtered(new, by_method, time_s, ego_sigma_mps if is_ego_known else math.nan)

    def _measured(
        self, by_method: Mapping[str, Ranges], n: int
    ) -> tuple[FloatArray, FloatArray, FloatArray, BoolArray]:
        """Measurements of N tracks in one frame by M methods, (M, 1, N) each; NaN = not measured.

        These are the distance, the variance R of log distance that is independent from frame to
        frame, with lambda, the variance that is constant over a track, and whether the track is
        measured.
        """
        distance_m, sigma_m = np.full((2, len(self._methods), n), np.nan)
        fraction = np.repeat(self._independent_fraction, n, axis=1)
        for i, name in enumerate(self._methods):
            if name in by_method:
                ranges = by_method[name]
                distance_m[i], sigma_m[i] = ranges.distance_m, ranges.sigma_m
                if ranges.sigma_systematic_m is not None:
                    independent = 1.0 - (ranges.sigma_systematic_m / ranges.sigma_m) ** 2
                    fraction[i] = np.maximum(independent, _MIN_INDEPENDENT_FRACTION**2)
        valid = np.isfinite(distance_m) & (distance_m > 0) & (sigma_m > 0)
        distance_m = np.where(valid, distance_m, np.nan)
        variance, factor = (sigma_m / distance_m) ** 2, self._noise_scale.factor
        # If the noise is smaller than declared, the remainder of sigma counts as systematic.
        systematic = (1 - fraction * np.minimum(factor, 1.0)) * variance
        return (
            distance_m[:, None],
            (fraction * factor * variance)[:, None],
            systematic[:, None],
            valid[:, None],
        )

    def _filtered(
        self,
        state: _FilterState,
        by_method: Mapping[str, Ranges],
        time_s: float,
        ego_sigma_mps: float,
    ) -> dict[str, FilteredRanges]:
        w, systematic = state.weight, state.systematic[:, 0]
        d, v = mean_of(state.d, w), mean_of(state.v, w)
        # deviations of the models from their mean
        dd, dv = state.d - d[:, None], state.v - v[:, None]
        P_dd, P_dv = mean_of(state.P_dd + dd * dd, w), mean_of(state.P_dv + dd * dv, w)
        P_vv = mean_of(state.P_vv + dv * dv, w)

        # Static objects come nearer with V, whatever their size; the speed of others has the error
        # of their size.
        is_static = self._models.is_static & np.isfinite(state.ego_mps)
        static_P = STATIC_RATE_SIGMA_MPS**2 + (
            0.0 if math.isnan(ego_sigma_mps) else ego_sigma_mps**2
        )
        true_v = np.where(is_static, -state.ego_mps, state.v)
        mean_v = mean_of(true_v, w)
        true_dv = true_v - mean_v[:, None]
        true_P = np.where(is_static, static_P, state.P_vv + state.systematic * state.v**2)
        is_steady = time_s - state.steady_since_s[:, 0] >= self._settings.min_steady_s
        rate_variance = mean_of(true_P + true_dv * true_dv, w)
        is_certain = (
            np.fmin(P_vv, rate_variance) <= self._settings.max_rate_sigma_mps**2
        ) & is_steady
        rate_mps = np.where(is_certain, mean_v, np.nan)
        rate_sigma_mps = np.where(is_certain, np.sqrt(rate_variance), np.nan)
        sigma_m = np.sqrt(P_dd + systematic * d**2)
        ttc_s, ttc_sigma_s = time_to_collision(
            d, np.where(is_certain, v, np.nan), variances=(P_dd, P_dv, P_vv)
        )
        # The state has the rate of static objects, too, without the errors of sizes.
        true_P = np.where(is_static, static_P, state.P_vv)
        v, P_dv = mean_v, mean_of(np.where(is_static, 0.0, state.P_dv) + dd * true_dv, w)
        P_vv = mean_of(true_P + true_dv * true_dv, w)
        static = mean_of(is_static.astype(np.float64), w)
        return {
            name: FilteredRanges(
                Ranges(by_method[name].track_id, d[i], sigma_m[i]),
                rate_mps[i],
                rate_sigma_mps[i],
                ttc_s[i],
                ttc_sigma_s[i],
                ConstantVelocity(d[i], v[i], P_dd[i], P_dv[i], P_vv[i]),
                static[i],
            )
            for i, name in enumerate(self._methods)
            if name in by_method
        }


def _speed_step(
    dV: FloatArray, ego_sigma_mps: float, dt: FloatArray
) -> tuple[FloatArray, FloatArray]:
    """Changes dV of the ego speed in the times dt, 0 where it was unknown (NaN), and their
    variances.
    """
    variance = 0.0 if math.isnan(ego_sigma_mps) else 2 * ego_sigma_mps**2
    dV = np.where(np.isnan(dV), 0.0, dV)
    return dV, np.where(dV == 0, 0.0, variance * -np.expm1(-dt / _EGO_CORRELATION_S))


def time_to_collision(
    distance_m: FloatArray,
    rate_mps: FloatArray,
    *,
    variances: tuple[FloatArray, FloatArray, FloatArray],
) -> tuple[FloatArray, FloatArray]:
    """Time to collision T = d / -v in s and its standard deviation, (...) each; NaN = not closing.

    (sigma_T / T)^2 = P_dd / d^2 - 2 P_dv / (d v) + P_vv / v^2        to first order; `variances` are P_dd, P_dv, P_vv
    """
    closing_mps = np.where(rate_mps < -MIN_CLOSING_MPS, -rate_mps, np.nan)
    ttc_s = distance_m / closing_mps
    P_dd, P_dv, P_vv = variances
    relative = P_dd / distance_m**2 + 2 * P_dv / (distance_m * closing_mps) + P_vv / closing_mps**2
    return ttc_s, ttc_s * np.sqrt(np.maximum(relative, 0.0))
