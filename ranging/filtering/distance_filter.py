"""DistanceFilters: distance, closing speed and time to collision, with a Kalman filter per track
and method.

    x = [d v]'     F = [1 dt; 0 1]     Q = q [dt^3/3 dt^2/2; dt^2/2 dt]     H = [1/d 0]     R = lambda (s sigma / d)^2

d is the distance in m, v its rate (m/s, negative = closing), z = log d the measurement, s the
independent fraction of sigma; time steps dt come from the frames' timestamps. `FilterBank` has all
states, matrices and steps. The innovation and its noise are converted to metres: nu = d (z - log
d), and d^2 R. z is a logarithm because the noise is in the box size in px:
in metres, too large distances would also have too large sigmas, and short distances too much
weight. If the ego speed V is known, the target's own speed v + V is taken as constant, with dV the
change of V over the step: d' = d + v dt - dV dt / 2, v' = v - dV. The error of V, with standard
deviation sigma_V, decays over tau: dV has the variance 2 sigma_V^2 (1 - exp(-dt / tau)), which is
added to the state; a part of it that is new in each frame counts in full. This variance is 0 while
V does not change, since the error of V does not change either. In turns, V is the speed with which
static objects at the bearing b come nearer, V - w b d. A new track starts as a static target, v = -V.

A filter runs for each of several models of the motion, static or with other accelerations, and the
results are their mean (`motion_models`). The acceleration of moving objects is a third state
(`TargetStates`). The closing speed of a static object is V, whatever its size.

The sigma of a method has an independent part, new in every frame (box jitter, matching noise), and
a systematic part, constant over a track (the car is larger than average). Only the independent part
averages out, so R is this part alone, scaled by lambda, which is estimated from the innovations of
the method (`NoiseScale`). The systematic part is added to the filter's variance at the output, and
changes with the distance and with the side that is seen: P_dd grows by (k d)^2 (kappa |v| / d +
kappa_w (|w| + |U| / d)) dt, where k is its relative standard deviation, w the yaw rate of the camera
and U its speed across its axis. The time to collision d
/ -v does not contain this part, which is common to distance and speed. When the condition of a
measurement changes (a method joins or leaves the fusion, a nearer box begins or ceases to hide a
side), so does its systematic error: the variances of the old and the new error are added to the
variance of d, so that the step does not appear as speed. A measurement beyond 3 sigma is down-
weighted (Huber); after three in a row the filter restarts.

A change of the size that a method assumes scales the state, and is no motion (`BelievedSizes`).

Where the image border cuts a box, the object's far end is predicted (`cut_boxes`). The growth of
objects in the images is a further measurement (`key_distance`).
"""

import math
from collections.abc import Mapping

import numpy as np

from track_range.detection.classes import ROAD_CLASSES
from track_range.foundation.arrays import BoolArray, FloatArray, IntArray
from track_range.foundation.constant_velocity import ConstantVelocity
from track_range.foundation.track_state import TrackState
from track_range.ranging.filtering.believed_size import BelievedSizes
from track_range.ranging.filtering.cut_boxes import CutBoxes
from track_range.ranging.filtering.filter_bank import (
    FilterBank,
    FilterSettings as FilterSettings,
    Gate,
)
from track_range.ranging.filtering.filtered_ranges import (
    FilteredRanges as FilteredRanges,
    time_to_collision as time_to_collision,
)
from track_range.ranging.filtering.motion_models import (
    STATIC_RATE_SIGMA_MPS,
    InteractingModels,
    mean_of,
)
from track_range.ranging.filtering.noise_scale import MeasuredDistances, NoiseScale as NoiseScale
from track_range.ranging.filtering.observation import EgoStep, FilterStep, Observation
from track_range.ranging.measurement.ranges import Ranges
from track_range.stereo.odometry.ego_motion import EgoMotion

_CAR = ROAD_CLASSES.index("car")
_NOTHING, _UNKNOWN = Observation(), EgoMotion()


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
        # by method, of the variance
        self._fractions = {name: share * share for name, share in noise_shares.items()}
        n_methods = len(noise_shares)
        self._noise_scale = NoiseScale(n_methods)
        self._sizes = BelievedSizes(n_methods)
        self._models = InteractingModels(n_methods)
        if not self._settings.learns_noise:
            noises = np.full(len(ROAD_CLASSES), self._settings.acceleration_noise)
            self._models = InteractingModels(
                n_methods,
                noises=noises,
                accelerations_mps2=np.zeros((1, len(ROAD_CLASSES))),
                has_static=False,
            )
        self._stretch = math.nan  # of the given speed of the last frame
        self._new = FilterBank.new(self._models, self._settings)
        self._tracks = TrackState(self._new.rows[:, 0])

    @property
    def noise_shares(self) -> dict[str, float]:
        """Current estimate of the independent fraction of sigma, by method."""
        declared = np.array(list(self._fractions.values()))
        fractions = np.sqrt(declared * self._noise_scale.factor[:, 0])
        return dict(zip(self._fractions, fractions.tolist(), strict=True))

    def update(
        self,
        by_method: Mapping[str, Ranges],
        time_s: float,
        *,
        observation: Observation = _NOTHING,
        ego: EgoMotion = _UNKNOWN,
    ) -> dict[str, FilteredRanges]:
        """Filtered ranges of every track at `time_s`, by method, after the measurements of this
        frame.

        Args:
            by_method: distances with their total sigmas, of the same tracks in the same order, NaN
                = not measured; methods without a filter are ignored.
            time_s: time of the frame, not earlier than the time of the previous frame.
            observation: what else the frame shows of the tracks.
            ego: motion of the camera; NaN = unknown.
        """
        if not any(name in self._fractions for name in by_method):
            return {}
        track_id = next(iter(by_method.values())).track_id
        bank = self._new.of_tracks(self._tracks.get(track_id))
        step = self._step(bank, by_method, time_s, observation, ego)

        bank.predict(step)
        bank.resize(step)
        bank.interact(step)
        bank.step_of_condition(step)
        gate = bank.gate(step)
        self._learn(bank, step, gate)
        bank.correct_by_distance(gate)
        bank.correct_by_growth(step, gate)
        bank.restart(step, gate)
        bank.start_key_frames(step)
        bank.remember(step, gate)

        self._store(track_id, bank, time_s)
        return self._filtered(bank, step, by_method)

    def _step(
        self,
        bank: FilterBank,
        by_method: Mapping[str, Ranges],
        time_s: float,
        observation: Observation,
        ego: EgoMotion,
    ) -> FilterStep:
        """The step of the filters `bank` of the previous frame to this one."""
        measured = MeasuredDistances.of(by_method, self._fractions, self._noise_scale.factor)
        track_id = next(iter(by_method.values())).track_id
        n = measured.valid.shape[-1]
        dt = np.fmax(time_s - bank.last.time_s, 0.0)  # 0 for a new track
        class_id = observation.class_id
        if class_id is None:
            class_id = np.full(n, _CAR)
        static_mps = _static_mps(ego, observation.cut, bank.states.d, measured.distance_m)
        # Another focal length stretches a given speed, and another scale a measured one: neither
        # moves an object, and only what is static for the filters follows it.
        stretch = ego.scale if math.isnan(ego.stretch) else ego.stretch
        stretched, self._stretch = stretch / self._stretch, stretch
        other_mps = bank.ego_mps * (stretched if math.isfinite(stretched) else 1.0)
        last_mps = np.where(self._models.is_static, bank.ego_mps, other_mps)
        ego_step = EgoStep.of(ego, static_mps, last_mps, dt)
        resized = None
        if observation.heights_px:
            resized = self._resized(track_id, measured, observation.heights_px, time_s)
        is_hidden = np.array(False)
        if observation.is_hidden is not None:
            is_hidden = observation.is_hidden
        may_be_static: BoolArray | bool = ego_step.is_known
        if observation.may_be_static is not None:
            may_be_static = ego_step.is_known & observation.may_be_static
        return FilterStep(
            time_s=time_s,
            dt=dt,
            measured=measured,
            ego=ego_step,
            turn_rad_s=abs(ego.yaw_rad_s) if math.isfinite(ego.yaw_rad_s) else 0.0,
            across_mps=abs(ego.right_mps) if math.isfinite(ego.right_mps) else 0.0,
            observation=observation,
            class_id=class_id,
            condition=self._condition(observation, n),
            is_hidden=is_hidden,
            prior=self._models.prior(class_id, may_be_static),
            slides=bank.slides(observation.cut),
            resized=resized,
        )

    def _resized(
        self,
        track_id: IntArray,
        measured: MeasuredDistances,
        heights_px: Mapping[str, FloatArray],
        time_s: float,
    ) -> FloatArray:
        """(M, 1, N) factors of the believed sizes since the previous frame."""
        nan = np.full(len(track_id), np.nan)
        height_px = np.array([heights_px.get(name, nan) for name in self._fractions])
        factor = self._sizes.update(
            track_id,
            measured.distance_m[:, 0] * height_px,
            time_s,
            independent=measured.independent[:, 0],
            systematic=measured.systematic[:, 0],
        )
        return factor[:, None]

    def _condition(self, observation: Observation, n: int) -> FloatArray:
        """(M, 1, N) codes of the conditions of the measurements; NaN = not given."""
        condition = np.full((len(self._fractions), 1, n), np.nan)
        methods = tuple(self._fractions)
        for name, code in observation.conditions.items():
            condition[methods.index(name)] = code
        return condition

    def _learn(self, bank: FilterBank, step: FilterStep, gate: Gate) -> None:
        """Learn the noise of the methods from the innovations, and the motion of the classes."""
        if not self._settings.learns_noise:
            return
        is_steady = step.time_s - bank.history.steady_since_s >= self._settings.min_steady_s
        use = gate.known & is_steady & ~step.slides
        nu, P_dd, R, w = gate.nu, bank.states.P_dd, gate.R, bank.weight
        squared, predicted, noise = np.where(
            use[:, 0], mean_of(np.array([nu * nu, P_dd, R]), w), np.nan
        )
        self._noise_scale.learn(squared, predicted, noise=noise, use=use[:, 0])
        self._models.count(step.class_id, np.where(use, w, 0.0), step.dt)

    def _store(self, track_id: IntArray, bank: FilterBank, time_s: float) -> None:
        """Keep the states for the next frame, of absent tracks during `max_gap_s`."""
        measured_s = bank.measured_s(self._tracks.known)
        is_recent = (time_s - measured_s <= self._settings.max_gap_s).any(axis=0)
        self._tracks.put(track_id, bank.rows, keep_known=np.asarray(is_recent))

    def _filtered(
        self, bank: FilterBank, step: FilterStep, by_method: Mapping[str, Ranges]
    ) -> dict[str, FilteredRanges]:
        """Combined estimates of the models (step 4 of `InteractingModels`), by method.

        Static objects come nearer with V, whatever their size; the speed of others has the error of
        their size, but not the time to collision.
        """
        systematic = bank.history.systematic[:, 0]
        (d, v, true_v, own_mps2, static), covariances = _combined(bank, step)
        P_dd, P_dv, true_P_dv, P_vv, true_P_vv, rate_variance = covariances
        is_steady = step.time_s - bank.history.steady_since_s[:, 0] >= self._settings.min_steady_s
        is_sure = np.fmin(P_vv, rate_variance) <= self._settings.max_rate_sigma_mps**2
        is_certain = is_sure & is_steady
        rate_mps = np.where(is_certain, true_v, np.nan)
        rate_sigma_mps = np.where(is_certain, np.sqrt(rate_variance), np.nan)
        sigma_m = np.sqrt(P_dd + systematic * d * d)
        ttc_s, ttc_sigma_s = time_to_collision(
            d, np.where(is_steady, v, np.nan), variances=(P_dd, P_dv, P_vv)
        )
        # a longer focal length has longer distances and larger sigmas, but the same times
        is_timed = is_sure | (ttc_sigma_s <= self._settings.max_ttc_sigma * ttc_s)
        ttc_s, ttc_sigma_s = (np.where(is_timed, values, np.nan) for values in (ttc_s, ttc_sigma_s))
        return {
            name: FilteredRanges(
                Ranges(by_method[name].track_id, d[i], sigma_m[i]),
                rate_mps[i],
                rate_sigma_mps[i],
                ttc_s[i],
                ttc_sigma_s[i],
                ConstantVelocity(d[i], true_v[i], P_dd[i], true_P_dv[i], true_P_vv[i]),
                own_mps2[i],
                static[i],
            )
            for i, name in enumerate(self._fractions)
            if name in by_method
        }


def _combined(bank: FilterBank, step: FilterStep) -> tuple[FloatArray, FloatArray]:
    """Means and covariances over the models (step 4 of `InteractingModels`): (5, M, N) of d, v,
    the true v, a and whether the object is static, and (6, M, N) P_dd, P_dv, P_vv of the true v in
    their places, P_vv of both.

    The true v has no error of the size where the object is static, since its speed is -V; the last
    covariance contains that of the size where it moves.
    """
    states, weight, systematic = bank.states, bank.weight, bank.history.systematic
    P, v = states.P, states.v
    is_static = bank.models.is_static & np.isfinite(bank.ego_mps)
    static_variance = STATIC_RATE_SIGMA_MPS**2 + step.ego.sigma_mps**2
    true_v = np.where(is_static, -bank.ego_mps, v)
    x = np.array([states.d, v, true_v, states.a, is_static])
    mean = mean_of(x, weight)
    d_d, d_v, d_true = x[:3] - mean[:3, :, None]
    moving = ~is_static
    second = np.array(
        [
            P[0, 0] + d_d * d_d,
            P[0, 1] + d_d * d_v,
            moving * P[0, 1] + d_d * d_true,
            P[1, 1] + d_v * d_v,
            np.where(is_static, static_variance, P[1, 1]) + d_true * d_true,
            np.where(is_static, static_variance, P[1, 1] + systematic * v * v) + d_true * d_true,
        ]
    )
    return mean, mean_of(second, weight)


def _static_mps(ego: EgoMotion, cut: CutBoxes | None, d: FloatArray, z: FloatArray) -> FloatArray:
    """Speed V - w b d with which static objects come nearer, () or (M, G, N); the distances z are
    those of new tracks.
    """
    if cut is None or not math.isfinite(ego.speed_mps + ego.yaw_rad_s):
        return np.array(ego.speed_mps)
    distance_m = np.where(np.isnan(d), np.fmax(z, 0.0), d)
    return np.asarray(ego.speed_mps - ego.yaw_rad_s * cut.bearing * distance_m)
