"""CollisionWarning: probability of contact of all tracks of a video, and an alarm with hysteresis for each.

Acceleration of the object:   u = v + V    a Kalman filter with the state [u, u'] and the filtered rate v as measurement
of the ego vehicle:           V            another one with the state [V, V'], from the ego speed
relative acceleration:        a = u' - V'  without ego speed, u = v and a = u'

Ego path: the circle of curvature k = w / V, with the yaw rate w. In its coordinates, an object at the distance z has

    o = x - k z^2 / 2        o' = u_x - k z (v + V)

both of which are constant for static objects and for all that follow the bend. Traffic lights and signs have no
probability of contact: they hang above the road, or are beside it.
"""

from __future__ import annotations

import math

import numpy as np

from track_range.detection.classes import ROAD_CLASSES
from track_range.foundation.arrays import BoolArray, FloatArray
from track_range.foundation.constant_velocity import ConstantVelocity
from track_range.foundation.track_state import TrackState
from track_range.ranging.filtering.filtered_ranges import FilteredRanges
from track_range.ranging.filtering.lateral_motion import LateralMotion
from track_range.ranging.warning.contact import Encounter, contact_probability, overlap_probability
from track_range.ranging.warning.settings import WarningSettings
from track_range.ranging.warning.warnings import Warnings
from track_range.tracking.tracks import Tracks

_PERSON = ROAD_CLASSES.index("person")
_IN_THE_WAY = np.array([name not in ("traffic light", "traffic sign") for name in ROAD_CLASSES])
"""(road classes,) whether objects of the class can be in the way."""

_MAX_GAP_S = 1.0
"""Longest time without a distance in s; after it a track counts as new."""

_JERK_NOISE = 2.0
"""Process noise: random walk of accelerations in m/s^2 per square root of a second."""

_RATE_FACTOR = 4.0
"""Factor on the variance of filtered rates, whose errors are correlated between frames."""

_INITIAL_ACCELERATION_MPS2 = 1.0
"""Standard deviation of the acceleration of a new track."""

_EGO_SPEED_SIGMA_MPS = 0.1
"""Standard deviation of a value of the ego speed, m/s."""

_YAW_S = 0.4
"""Time constant of the mean of the yaw rate, s."""

_MAX_LAG_S = 0.6
"""Largest lag of a distance filter that is corrected, s."""

_BESIDE_SIGMA = 2.0
"""Distance from the ego path, in standard deviations, beyond which a vehicle is beside it."""

_STATIC_MPS = 2.0
"""Speed of an object along the road below which it counts as static, m/s."""

_GATE_SIGMA = 3.0
"""Lateral speed in standard deviations of the prior and its error above which the prior does not apply."""

_BENDS_S = 5.0
"""Time constant of the mean square of the lateral acceleration, s."""

_INITIAL_LATERAL_MPS2 = 0.5
"""Root mean square of the lateral acceleration at the start of a drive, m/s^2."""

_TYPICAL_SPEED_MPS = 12.0
"""Speed assumed for the curvature if the yaw rate is known but not the speed, m/s."""

_MIN_SPEED_MPS = 2.0
"""Smallest speed for the curvature, m/s."""

_BESIDE_S = 4.0
"""Longest time since a vehicle was beside the path for a cut-in, s: that of a slow lane change."""

_MIN_CUT_IN_SPEED_MPS = 5.0
"""Smallest ego speed of an alarm for a cut-in, m/s; below, vehicles merge closely in queues."""

_N_STATE = 11
"""Values per track: u, u', P_uu, P_uu', P_u'u', time of the state, times of the first and of the last distance, last
time beside the ego path, since when the condition for the next state of the alarm holds, alarm (0 or 1)."""


class CollisionWarning:
    """Probability of contact and alarm of all tracks of a video."""

    def __init__(self, settings: WarningSettings | None = None) -> None:
        """Start without tracks; None = default settings."""
        self.settings = settings or WarningSettings()
        initial = np.full(_N_STATE, np.nan)
        initial[-1] = 0.0
        self._tracks = TrackState(initial)
        self._ego = _EgoTrend()

    def update(
        self,
        tracks: Tracks,
        motion: FilteredRanges,
        lateral: LateralMotion,
        time_s: float,
        *,
        ego_mps: float = math.nan,
        yaw_rad_s: float = math.nan,
    ) -> Warnings:
        """Warnings of this frame.

        Args:
            tracks: N tracks.
            motion: their filtered distances.
            lateral: their lateral motion.
            time_s: time of the frame, not earlier than that of the previous frame.
            ego_mps: speed V of the ego vehicle; NaN = unknown.
            yaw_rad_s: its yaw rate, positive = to the right; NaN = unknown.
        """
        settings = self.settings
        self._ego.update(time_s, ego_mps, yaw_rad_s)
        columns = self._tracks.get(tracks.track_id)
        *trend, state_s, first_s, last_s, beside_s, since_s, is_on = columns
        d, v = motion.state.x, motion.state.v
        is_known = np.isfinite(d) & np.isfinite(lateral.state.x)
        is_stale = ~(time_s - last_s <= _MAX_GAP_S)

        # Relative acceleration.
        V = np.nan_to_num(ego_mps)
        state = ConstantVelocity(*trend).predict(time_s - state_s, q=_JERK_NOISE**2)
        R = _RATE_FACTOR * motion.state.P_vv
        state = state.update(v + V - state.x, R, valid=is_known)
        starts = is_known & (is_stale | np.isnan(state.x))
        filtered = np.array([state.x, state.v, state.P_xx, state.P_xv, state.P_vv])
        np.copyto(filtered, np.array([v + V, 0 * v, R, 0 * v, 0 * v + _INITIAL_ACCELERATION_MPS2**2]), where=starts)
        a = filtered[1] - self._ego.acceleration_mps2
        a_sigma = np.hypot(np.sqrt(filtered[4]), settings.acceleration_mps2)

        # Probability of contact.
        rate_variance = (motion.ranges.sigma_m / settings.drift_s) ** 2
        gap = _without_lag(motion.state, filtered[1], filtered[4])
        gap = ConstantVelocity(gap.x, gap.v, gap.P_xx, gap.P_xv, gap.P_vv + rate_variance)
        encounter = self._encounter(tracks, gap, lateral, a, a_sigma)
        probability = contact_probability(
            encounter,
            horizon_s=settings.horizon_s,
            manoeuvre_s=settings.manoeuvre_s,
            ego_length_m=settings.ego_length_m,
        )
        is_certain = motion.state.P_vv <= settings.max_closing_sigma_mps**2
        probability = np.where(is_known & is_certain & _IN_THE_WAY[tracks.class_id], probability, np.nan)

        # Alarm.
        first_s = np.where(is_stale & is_known, time_s, first_s)
        is_beside = np.abs(encounter.offset.x) > encounter.half_width_m + _BESIDE_SIGMA * np.sqrt(encounter.offset.P_xx)
        beside_s = np.where(is_known & is_beside, time_s, beside_s)
        may_start = self._is_urgent(encounter) & (probability >= self._on_probability(tracks))
        may_start |= self._cuts_in(tracks, encounter, time_s - beside_s)
        is_person = tracks.class_id == _PERSON
        may_start &= time_s - first_s >= np.where(is_person, settings.min_person_s, settings.min_track_s)
        may_end = ~(probability >= settings.off_probability)
        is_uncertain = motion.ranges.sigma_m > settings.certain_share * d
        needed_s = np.where(is_uncertain, settings.uncertain_on_s, settings.min_on_s)
        needed_s = np.where(is_on > 0, settings.min_off_s, needed_s)
        active, since_s = _alarm(np.where(is_on > 0, may_end, may_start), needed_s, time_s, since_s, is_on > 0)
        last_s = np.where(is_known, time_s, last_s)
        new = np.vstack([filtered, np.full(len(tracks), time_s), first_s, last_s, beside_s, since_s, active])
        is_recent = time_s - self._tracks.known[7] <= _MAX_GAP_S
        self._tracks.put(tracks.track_id, new, keep_known=is_recent)
        return Warnings(probability, active, encounter.offset.x)

    def _encounter(
        self, tracks: Tracks, gap: ConstantVelocity, lateral: LateralMotion, a: FloatArray, a_sigma: FloatArray
    ) -> Encounter:
        """Motion of the objects relative to the ego vehicle and its path."""
        settings = self.settings
        lateral_mps2 = np.where(
            tracks.class_id == _PERSON, settings.person_acceleration_mps2, settings.vehicle_acceleration_mps2
        )
        return Encounter(
            gap=ConstantVelocity(gap.x - settings.front_m, gap.v, gap.P_xx, gap.P_xv, gap.P_vv),
            acceleration_mps2=a,
            acceleration_sigma_mps2=a_sigma,
            offset=self._offset(tracks, gap, lateral.state),
            half_width_m=lateral.half_width_m + settings.ego_width_m / 2,
            lateral_acceleration_mps2=lateral_mps2,
        )

    def _offset(self, tracks: Tracks, gap: ConstantVelocity, x: ConstantVelocity) -> ConstantVelocity:
        """Lateral offset of the objects from the ego path and its rate, with the errors of the path."""
        settings, ego = self.settings, self._ego
        z, v, k = gap.x, gap.v, ego.curvature
        V = ego.speed_mps if ego.has_speed else _TYPICAL_SPEED_MPS
        V = max(V, _MIN_SPEED_MPS)
        own_mps = v + ego.speed_mps if ego.has_speed else np.zeros_like(v)
        k_sigma = settings.yaw_sigma_rad_s / V if ego.has_yaw else settings.unknown_lateral_mps2 / V**2
        turning_mps = own_mps if ego.has_yaw else v
        bend = _path_errors(k_sigma * z * z / 2, k_sigma * z * turning_mps)
        clothoid_sigma = max(settings.min_lateral_jerk_mps3, ego.lateral_mps2 * settings.bend_rate_hz) / V**3
        change = _path_errors(clothoid_sigma * z**3 / 6, clothoid_sigma * z * z / 2 * own_mps)
        P_xx, P_xv, P_vv = np.array([x.P_xx, x.P_xv, x.P_vv]) + bend + change
        offset = ConstantVelocity(x.x - k * z * z / 2, x.v - k * z * own_mps, P_xx, P_xv, P_vv)
        return _with_prior(offset, self._rate_sigma_mps(tracks, own_mps))

    def _rate_sigma_mps(self, tracks: Tracks, own_mps: FloatArray) -> FloatArray:
        """(N,) prior standard deviation of the rate of the offset from the ego path."""
        settings = self.settings
        sigma = np.full(len(tracks), settings.lateral_speed_mps)
        if self._ego.has_speed:
            sigma = np.where(np.abs(own_mps) < _STATIC_MPS, settings.static_lateral_mps, sigma)
            sigma = np.where(own_mps < -_STATIC_MPS, settings.oncoming_lateral_mps, sigma)
        return np.where(tracks.class_id == _PERSON, settings.person_lateral_mps, sigma)

    def _is_urgent(self, encounter: Encounter) -> BoolArray:
        """(N,) whether the driver has to brake at least moderately after the reaction time."""
        settings, gap, a = self.settings, encounter.gap, encounter.acceleration_mps2
        closing_mps, t = -gap.v, settings.reaction_s
        later_mps = np.maximum(closing_mps - a * t, 0.0)
        left_m = np.maximum(gap.x - closing_mps * t + a * t * t / 2, 0.0)
        is_hard = later_mps**2 >= 2 * (settings.min_deceleration_mps2 + a) * left_m
        return np.asarray((closing_mps >= settings.min_closing_mps) & is_hard)

    def _on_probability(self, tracks: Tracks) -> FloatArray:
        """(N,) probability at which the alarm of a track starts."""
        settings = self.settings
        return np.where(tracks.class_id == _PERSON, settings.person_probability, settings.on_probability)

    def _cuts_in(self, tracks: Tracks, encounter: Encounter, since_beside_s: FloatArray) -> BoolArray:
        """(N,) whether a vehicle moves from the side into the ego path at a short headway."""
        settings, gap, offset = self.settings, encounter.gap, encounter.offset
        if self._ego.speed_mps < _MIN_CUT_IN_SPEED_MPS:
            return np.zeros(len(tracks), np.bool_)
        is_near = (gap.x < settings.cut_in_headway_s * self._ego.speed_mps) & (gap.x > settings.min_cut_in_gap_m)
        is_along = gap.v + self._ego.speed_mps > _STATIC_MPS
        share = overlap_probability(
            offset, encounter.half_width_m, encounter.lateral_acceleration_mps2, settings.cut_in_ahead_s
        )
        enters = (share >= settings.cut_in_probability) & (since_beside_s <= _BESIDE_S) & (offset.x * offset.v < 0)
        return np.asarray(
            is_near & is_along & enters & (gap.v <= settings.max_cut_in_mps) & (tracks.class_id != _PERSON)
        )


def _alarm(
    holds: BoolArray, needed_s: FloatArray, time_s: float, since_s: FloatArray, is_on: BoolArray
) -> tuple[BoolArray, FloatArray]:
    """Whether each alarm is on, and since when the condition for its next change holds; NaN = it does not.

    Args:
        holds: (N,) whether the condition holds in this frame.
        needed_s: (N,) time for which it has to hold.
        time_s: time of the frame.
        since_s: (N,) since when it held before; NaN = it did not.
        is_on: (N,) whether the alarm was on.
    """
    since_s = np.where(holds, np.fmin(since_s, time_s), np.nan)
    changes = time_s - since_s >= needed_s - 1e-9
    return is_on ^ changes, np.where(changes, np.nan, since_s)


def _path_errors(offset_m: FloatArray, rate_mps: FloatArray) -> FloatArray:
    """(3, N) variance, covariance and variance of the rate of an error of the path with the given size and rate."""
    return np.array([offset_m**2, offset_m * rate_mps, rate_mps**2])


def _with_prior(offset: ConstantVelocity, rate_sigma_mps: FloatArray) -> ConstantVelocity:
    """The offset after a pseudo-measurement of its rate, 0 with the given sigma; not where that is implausible."""
    S = offset.P_vv + rate_sigma_mps**2
    weight = np.where(offset.v**2 < _GATE_SIGMA**2 * S, 1.0 / S, 0.0)
    K_x, K_v = weight * offset.P_xv, weight * offset.P_vv
    return ConstantVelocity(
        x=offset.x - K_x * offset.v,
        v=offset.v - K_v * offset.v,
        P_xx=offset.P_xx - K_x * offset.P_xv,
        P_xv=offset.P_xv - K_x * offset.P_vv,
        P_vv=offset.P_vv - K_v * offset.P_vv,
    )


def _without_lag(gap: ConstantVelocity, a: FloatArray, a_variance: FloatArray) -> ConstantVelocity:
    """The filtered distance corrected for the lag of a constant-velocity filter behind an acceleration.

    In the steady state, the filter is behind by e_v = a T and e_x = a T^2 / 2 with T = P_xx / P_xv.
    """
    T = np.clip(gap.P_xx / np.maximum(gap.P_xv, 1e-9), 0.0, _MAX_LAG_S)
    return ConstantVelocity(
        gap.x + a * T * T / 2,
        gap.v + a * T,
        gap.P_xx + a_variance * T**4 / 4,
        gap.P_xv + a_variance * T**3 / 2,
        gap.P_vv + a_variance * T * T,
    )


class _EgoTrend:
    """Speed, acceleration and path curvature of the ego vehicle.

    Attributes:
        speed_mps: speed; 0 = unknown.
        acceleration_mps2: its change; 0 = unknown.
        curvature: of the path, 1/m, positive = to the right; 0 = unknown.
        lateral_mps2: root mean square of the recent lateral acceleration.
        has_speed, has_yaw: whether speed and yaw rate are known.
    """

    def __init__(self) -> None:
        self.speed_mps = self.acceleration_mps2 = self.curvature = 0.0
        self.has_speed = self.has_yaw = False
        self._state: ConstantVelocity | None = None
        self._yaw_rad_s = 0.0
        self.lateral_mps2 = _INITIAL_LATERAL_MPS2
        self._time_s = -math.inf

    def update(self, time_s: float, speed_mps: float, yaw_rad_s: float) -> None:
        """Update with the values of a frame; NaN = unknown."""
        dt = time_s - self._time_s
        self._time_s = time_s
        was_speed, self.has_speed = self.has_speed, math.isfinite(speed_mps)
        was_yaw, self.has_yaw = self.has_yaw, math.isfinite(yaw_rad_s)
        R = _EGO_SPEED_SIGMA_MPS**2
        if not self.has_speed:
            self._state = None
        elif self._state is None or not was_speed or dt > _MAX_GAP_S:
            zero = np.zeros(())
            self._state = ConstantVelocity(zero + speed_mps, zero, zero + R, zero, zero + _INITIAL_ACCELERATION_MPS2**2)
        else:
            predicted = self._state.predict(dt, q=_JERK_NOISE**2)
            self._state = predicted.update(speed_mps - predicted.x, R)
        self.acceleration_mps2 = 0.0 if self._state is None else float(self._state.v)
        self.speed_mps = speed_mps if self.has_speed else 0.0
        if not self.has_yaw:
            self.curvature = 0.0
            return
        weight = 1.0 if not was_yaw or dt > _MAX_GAP_S else -math.expm1(-dt / _YAW_S)
        self._yaw_rad_s += weight * (yaw_rad_s - self._yaw_rad_s)
        speed = max(speed_mps, _MIN_SPEED_MPS) if self.has_speed else _TYPICAL_SPEED_MPS
        if dt <= _MAX_GAP_S:
            decay = math.exp(-dt / _BENDS_S)
            square = decay * self.lateral_mps2**2 + (1 - decay) * (self._yaw_rad_s * speed) ** 2
            self.lateral_mps2 = math.sqrt(square)
        self.curvature = self._yaw_rad_s / speed
