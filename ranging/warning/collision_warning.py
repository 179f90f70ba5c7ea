"""CollisionWarning: probability of contact of all tracks of a video, each with an alarm.

The motion of a track relative to the ego vehicle and its path predicts a contact (`contact`). The
predictions of successive frames are the evidence of a sequential test (`sequential_test`), which
gives the reported probability and starts the alarm; its end has a hysteresis.

Speed of the object along the road:    u = v + V    a Kalman filter with the state [u, u'] and the filtered rate v
Speed of the ego vehicle:              V            another one with the state [V, V']
Yaw rate of the ego vehicle:           w            another one with the state [w, w']
Without ego speed, V = V' = 0. The rate v follows a part of u' itself (`TargetStates`); the gap
is corrected for the rest. A change of u beyond 3 standard deviations means that the track is on
another object. The filtered rate v has a model of the motion, and takes about a second to forget
another object; so a filter without a model has to confirm it before an alarm starts.

Ego path: the yaw rate goes on changing as it does, and its change w' is a random walk with the density q. In its
coordinates, an object at the distance z, which the ego vehicle reaches after T = z / V, has

    o = x - V (w T^2 / 2 + w' T^3 / 6)         o' = u_x - (w T + w' T^2 / 2) u
    var o = P_oo + V^2 (P_ww T^4 / 4 + P_ww' T^5 / 6 + P_w'w' T^6 / 36 + q T^7 / 252)

The size of an object is wrong by one factor 1 + s as long as it is seen from one side. It moves the
distance and the lateral offset in proportion, and their rates as well; the rate of a static object
is the ego speed, whatever its size:

    P_gg += s^2 g^2        P_gv += m s^2 g v        P_vv += m s^2 v^2        m: that it moves
    P_oo += s^2 o^2        P_oo' += s^2 o o'        P_o'o' += s^2 o'^2

o and o' are constant for static objects and for all vehicles that follow the road. Traffic lights
and signs have no probability of contact: they hang above the road, or are beside it.
"""

import math
from dataclasses import dataclass, replace
from typing import NamedTuple

import numpy as np
from scipy.special import expit, logit, ndtr

from track_range.detection.classes import ROAD_CLASSES
from track_range.foundation.arrays import BoolArray, FloatArray, IntArray
from track_range.foundation.constant_velocity import ConstantVelocity
from track_range.foundation.track_state import TrackState
from track_range.ranging.filtering.distance_filter import FilteredRanges
from track_range.ranging.filtering.lateral_motion import (
    LENGTH_M,
    TYPICAL_WIDTH_M,
    LateralMotion,
)
from track_range.ranging.filtering.own_acceleration import MANOEUVRE_S, without_lag
from track_range.ranging.measurement.ranges import Ranges
from track_range.ranging.warning.contact import (
    Encounter,
    contact_probability,
    manoeuvre,
    needed_deceleration,
    overlap_probability,
    stop_s,
    yielding_probability,
)
from track_range.ranging.warning.sequential_test import calibrated, is_due, posterior, soundness
from track_range.ranging.warning.settings import WarningSettings
from track_range.ranging.warning.warnings import Warnings
from track_range.ranging.world.ego_path import UNKNOWN_LATERAL_MPS2, YAW_NOISE_RAD_S
from track_range.stereo.odometry.ego_motion import MAX_EGO_SIGMA_MPS
from track_range.tracking.tracks import Tracks

_MAX_GAP_S = 1.0  # longest time without a value in s; after it the filters restart
# process noise: random walk of accelerations in m/s^2 per square root of a second
_JERK_NOISE = 2.0
_INITIAL_ACCELERATION_MPS2 = 1.0  # standard deviation of the acceleration at the start
_EGO_SPEED_SIGMA_MPS = 0.1  # standard deviation of a value of the ego speed, m/s
_INITIAL_YAW_RAD_S2 = 0.03  # standard deviation of the change of the yaw rate at the start, rad/s^2
_BENDS_S = 0.65  # time constant of the mean square of the lateral acceleration, s
# root mean square of the lateral acceleration at the start of a drive, m/s^2
_INITIAL_LATERAL_MPS2 = 0.5
# speed assumed for the curvature if the yaw rate is known but not the speed, m/s
_TYPICAL_SPEED_MPS = 12.0
_MIN_SPEED_MPS = 2.0  # smallest speed for the curvature, m/s

_PERSON = ROAD_CLASSES.index("person")
# half the width above which the box of a person holds a vehicle that is ridden, too: that of a
# person with half-spread arms, m
_MAX_PERSON_HALF_M = 0.6
_CAN_COLLIDE = np.array([name not in ("traffic light", "traffic sign") for name in ROAD_CLASSES])
"""(road classes,) whether objects of the class can be in the way."""

# factor on the variance of filtered rates, whose errors are correlated between frames
_RATE_FACTOR = 2.0
# change of an object's speed in standard deviations above which the track now is on another object
_JUMP_SIGMA = 3.0
# of road users, and across the path of vehicles and people; above, the track is wrong
_MAX_SPEED_MPS, _MAX_ACCELERATION_MPS2 = 70.0, 15.0
_MAX_LATERAL_MPS, _MAX_RUNNING_MPS = 12.0, 5.0
# distance from the ego path, in standard deviations, beyond which a vehicle is beside it, so that
# it may cut in
_BESIDE_SIGMA = 2.0
# fraction of objects whose lateral speed is not that of the prior: they cross or turn in; and the
# prior standard deviations of speeds without a preference, of vehicles and people
_FREE_FRACTION = 0.1
_FREE_LATERAL_MPS, _FREE_PERSON_MPS = 6.0, 3.0
_FREE_ALONG_MPS = 5.0  # the same along the road, of people who ride or run
# longest time since a vehicle was beside the path for a cut-in, s: that of a slow lane change
_BESIDE_S = 4.0
# smallest ego speed of an alarm for a cut-in, m/s; below, vehicles merge closely in queues
_MIN_CUT_IN_SPEED_MPS = 5.0

_FREE_NOISE, _FREE_SIGMA_MPS = 3.0, 30.0
"""Process noise, m/s per square root of a second, and first standard deviation of rates if all
speeds are possible."""

# standard deviations by which such a rate may be above the filtered one when an alarm starts
_CONFIRMED_SIGMA = 2.0
_REACH_SIGMA = 3.0  # standard deviations of the gap beyond which an object is out of reach

# The following values were chosen with those of `WarningSettings`, on the same drives.
_MIN_OFF_S = 0.5  # shortest time below `off_probability` before the end of an alarm
# largest standard deviation of the closing speed, as a fraction of it within these limits; above,
# nothing is predicted
_MAX_CLOSING_FRACTION, _MAX_CLOSING_SIGMA_MPS = 0.35, (2.0, 5.0)
# headway below which a vehicle that cuts in starts an alarm, even if it is not slower
_CUT_IN_HEADWAY_S = 0.6
# smallest gap of a cut-in; nearer boxes beside the ego vehicle are cut by the image border
_MIN_CUT_IN_GAP_M = 3.0
# a vehicle cuts in if it was beside the path and will be in it after this time, with at least this
# probability, and draws away at most at this speed
_CUT_IN_AHEAD_S, _CUT_IN_LOG_ODDS, _MAX_CUT_IN_MPS = 1.0, float(logit(0.8)), 1.5
# standard deviations until contact: of the relative acceleration, and of the lateral acceleration of
# people and of all other road users
_ACCELERATION_MPS2, _PERSON_ACCELERATION_MPS2, _VEHICLE_ACCELERATION_MPS2 = 0.4, 0.2, 0.15
# prior standard deviations of the lateral speed relative to the ego path: of vehicles, static
# objects, oncoming vehicles and people
_LATERAL_MPS, _STATIC_LATERAL_MPS, _ONCOMING_LATERAL_MPS = 1.0, 0.15, 0.3
_VEHICLE_LATERAL_MPS = np.array([[_STATIC_LATERAL_MPS], [_ONCOMING_LATERAL_MPS], [_LATERAL_MPS]])
_PERSON_LATERAL_MPS = 1.5
# the same along the road, of the people of KITTI: the largest likelihood of two fits is at 0.9 and
# 1.05 (without any one of the ten sequences 0.7 to 1.1, of the even ones, with 9 % of the boxes, 0.2)
_PERSON_ALONG_MPS = 1.05
# random walk of the lateral jerk of the ego path, m/s^3 per square root of a second, and the same
# per m/s^2 of recent lateral acceleration, since a driver who steers goes on steering: with
# `_BENDS_S`, the largest likelihood of the paths of the twelve KITTI drives with poses at 1.5 to
# 3 s ahead (of either half of them: 0.01 and 0.08, 0.67 and 0.96; 0.48 and 0.56 s)
_LATERAL_JERK_NOISE, _WINDING_NOISE = 0.04, 0.9


class _EgoTrend:
    def __init__(self) -> None:
        # 0 = unknown; yaw_noise: growth of the variance of w' per second
        self.speed_mps = self.acceleration_mps2 = self.yaw_noise = 0.0
        self.change_mps = 0.0  # change of the speeds u where V becomes known, or unknown
        self.path_mps = _TYPICAL_SPEED_MPS  # speed for the shape of the path, never 0
        self.has_speed = self.has_yaw = False
        self._speed: ConstantVelocity | None = None
        self.yaw = _state(0.0, 0.0, 0.0)  # yaw rate w and its change w', rad/s and rad/s^2
        self._lateral_mps2 = _INITIAL_LATERAL_MPS2
        self._time_s, self._scale = -math.inf, 1.0

    def update(self, time_s: float, speed_mps: float, yaw_rad_s: float, scale: float) -> None:
        """Update with the values of a frame; NaN = unknown. Another `scale` is no acceleration."""
        dt, was_known = time_s - self._time_s, self.has_speed
        self._time_s = time_s

        # Speed.
        if self._speed is not None:
            self._speed = self._speed.scaled(scale / self._scale).predict(dt, q=_JERK_NOISE**2)
            if self._speed.P_xx > MAX_EGO_SIGMA_MPS**2:
                self._speed = None
        self._scale = scale
        if math.isfinite(speed_mps):
            R = _EGO_SPEED_SIGMA_MPS**2
            if self._speed is None:
                self._speed = _state(speed_mps, R, _INITIAL_ACCELERATION_MPS2**2)
            self._speed = self._speed.update(speed_mps - self._speed.x, R)
        before_mps, self.has_speed = self.speed_mps, self._speed is not None
        if self._speed is None:
            self.speed_mps = self.acceleration_mps2 = 0.0
        else:
            self.speed_mps = speed_mps if math.isfinite(speed_mps) else float(self._speed.x)
            self.acceleration_mps2 = float(self._speed.v)
            self.path_mps = max(self.speed_mps, _MIN_SPEED_MPS)
        V = self.path_mps
        self.change_mps = 0.0
        if self.has_speed != was_known:
            self.change_mps = self.speed_mps - before_mps

        # Yaw rate.
        was_known, self.has_yaw = self.has_yaw, math.isfinite(yaw_rad_s)
        self.yaw_noise = ((_LATERAL_JERK_NOISE + _WINDING_NOISE * self._lateral_mps2) / V) ** 2
        R = YAW_NOISE_RAD_S**2
        if not self.has_yaw:
            self.yaw = _state(0.0, (UNKNOWN_LATERAL_MPS2 / V) ** 2, 0.0)
        elif not was_known or dt > _MAX_GAP_S:
            self.yaw = _state(yaw_rad_s, R, _INITIAL_YAW_RAD_S2**2)
        else:
            predicted = self.yaw.predict(dt, q=self.yaw_noise)
            self.yaw = predicted.update(yaw_rad_s - predicted.x, R)
            decay = math.exp(-dt / _BENDS_S)
            square = decay * self._lateral_mps2**2 + (1 - decay) * float(self.yaw.x * V) ** 2
            self._lateral_mps2 = math.sqrt(square)


def _state(x: float, P_xx: float, P_vv: float) -> ConstantVelocity:
    return ConstantVelocity(*(np.array(value) for value in (x, 0.0, P_xx, 0.0, P_vv)))


class _WarningState(NamedTuple):
    """State of N tracks, (N,) each: the rows of `TrackState`, in this order; NaN = none."""

    u: FloatArray  # speed along the road, m/s
    a: FloatArray  # u', m/s^2
    P_uu: FloatArray
    P_ua: FloatArray
    P_aa: FloatArray
    d: FloatArray  # measured distance, m, and its rate r, by a filter without a model of the motion
    r: FloatArray
    P_dd: FloatArray
    P_dr: FloatArray
    P_rr: FloatArray
    time_s: FloatArray  # of the state
    start_s: FloatArray  # time of the first frame on this object
    contact: FloatArray  # log odds of a contact
    cut_in: FloatArray  # log odds that the object cuts in
    known_s: FloatArray  # time of the last distance
    beside_s: FloatArray  # last time beside the ego path
    since_s: FloatArray  # since when the condition for the next change of the alarm holds
    is_on: FloatArray  # 1 = alarm

    @property
    def own(self) -> ConstantVelocity:
        """Speed along the road with its change."""
        return ConstantVelocity(self.u, self.a, self.P_uu, self.P_ua, self.P_aa)

    @property
    def free(self) -> ConstantVelocity:
        """Distance and rate without a model of the motion."""
        return ConstantVelocity(self.d, self.r, self.P_dd, self.P_dr, self.P_rr)


_KNOWN_ROW = _WarningState._fields.index("known_s")


@dataclass(frozen=True, slots=True)
class _Objects:
    """The N objects of a frame relative to the ego vehicle and its path, (N,) each."""

    is_person: BoolArray
    own: ConstantVelocity  # speed u along the road, and its change
    gap: ConstantVelocity  # distance from the camera, and its rate
    offset: ConstantVelocity  # lateral, from the ego path
    half_width_m: FloatArray  # half the sum of both widths
    since_beside_s: FloatArray  # time since the object was beside the path; NaN = never


class CollisionWarning:
    """Probability of contact and alarm of all tracks of a video.

    Example:
        >>> import numpy as np, track_range as tr
        >>> camera = tr.PinholeCamera(700.0, 700.0, 320.0, 180.0, width_px=640, height_px=360)
        >>> distances, lateral = tr.DistanceFilters({"fused": 0.35}), tr.LateralFilters(camera)
        >>> warning, ids = tr.CollisionWarning(tr.WarningSettings(front_m=1.0)), np.array([1])
        >>> for i in range(10):  # a standing car straight ahead, 45 m away at first, at 15 m/s
        ...     time_s, z_m = 0.1 * i, 45.0 - 1.5 * i
        ...     box = np.array([[320 - 630 / z_m, 180 - 300 / z_m, 320 + 630 / z_m, 180 + 750 / z_m]])
        ...     tracks = tr.Tracks(ids, box, np.array([tr.class_id("car")]), np.array([0.9]), np.array([True]))
        ...     motion = distances.update({"fused": tr.Ranges(ids, np.array([z_m]), np.array([0.5]))}, time_s)["fused"]
        ...     sideways = lateral.update(tracks, motion.ranges.distance_m, time_s)
        ...     warnings = warning.update(tracks, motion, sideways, time_s, ego_mps=15.0, yaw_rad_s=0.0)
        >>> warnings.active.tolist(), round(float(warnings.probability[0]), 2)
        ([True], 0.9)
    """

    def __init__(self, settings: WarningSettings | None = None) -> None:
        """Start without tracks; None = default settings."""
        self.settings = settings or WarningSettings()
        new_track = np.full(len(_WarningState._fields), np.nan)
        new_track[_WarningState._fields.index("is_on")] = 0.0
        self._tracks = TrackState(new_track)
        self._ego = _EgoTrend()

    def update(
        self,
        tracks: Tracks,
        motion: FilteredRanges,
        lateral: LateralMotion,
        time_s: float,
        *,
        ego_mps: float = math.nan,
        ego_scale: float = 1.0,
        yaw_rad_s: float = math.nan,
        ranges: Ranges | None = None,
    ) -> Warnings:
        """Warnings of this frame.

        Args:
            tracks: N tracks.
            motion: their filtered distances.
            lateral: their lateral motion.
            time_s: time of the frame, not earlier than the time of the previous frame.
            ego_mps: speed V of the ego vehicle; NaN = unknown.
            ego_scale: factor of it by an estimated scale.
            yaw_rad_s: its yaw rate, positive = to the right; NaN = unknown.
            ranges: their distances in this frame, not filtered, which confirm the closing speed;
                None = unknown.
        """
        settings, ego = self.settings, self._ego
        ego.update(time_s, ego_mps, yaw_rad_s, ego_scale)
        last = _WarningState._make(self._tracks.get(tracks.track_id))
        is_rider = lateral.half_width_m > _MAX_PERSON_HALF_M  # False for NaN
        is_person = (tracks.class_id == _PERSON) & ~is_rider

        # Motion of the objects along the road.
        state = self._with_prior_speed(motion.state, is_person)
        is_known = np.isfinite(state.x) & np.isfinite(lateral.state.x)
        own, starts = self._own_motion(state, last, time_s, is_known)

        # Position relative to the ego path.
        moving, gap, offset = self._position(is_person, motion, own, state, lateral.state)
        half_m, spread_m = _half_widths(tracks.class_id, lateral.half_width_m, own.x, offset.v)
        half_width_m = half_m + settings.ego_width_m / 2
        offset_sigma_m = np.sqrt(offset.P_xx)
        is_beside = np.abs(offset.x) > half_width_m + _BESIDE_SIGMA * offset_sigma_m
        beside_s = np.where(is_known & is_beside, time_s, last.beside_s)
        extent = ConstantVelocity(
            offset.x, offset.v, offset.P_xx + spread_m**2, offset.P_xv, offset.P_vv
        )
        objects = _Objects(is_person, moving, gap, extent, half_width_m, time_s - beside_s)
        can_collide = lateral.is_current & _CAN_COLLIDE[tracks.class_id]
        is_usable = is_known & can_collide & _is_plausible(objects)

        # Evidence, and what it says together with that of earlier frames.
        predicted, needed_mps2 = self._predicted(objects, is_usable)
        start_s = np.where(starts | np.isnan(last.start_s), time_s, last.start_s)
        sound = np.where(is_person, 1.0, soundness(time_s - start_s))
        known = np.array([last.contact, last.cut_in])
        known[:, starts] = np.nan
        contact, cut_in = posterior(known, sound * predicted, time_s - last.time_s)
        log_odds = calibrated(contact)
        probability = np.where(is_usable, expit(log_odds), np.nan)

        # Alarm.
        free = _free_motion(ranges, last, time_s)
        is_refuted = free.v - gap.v > _CONFIRMED_SIGMA * np.sqrt(free.P_vv)  # False for NaN
        may_start = self._may_start(objects, log_odds, needed_mps2)
        may_start |= cut_in >= _CUT_IN_LOG_ODDS
        may_end = ~(probability >= settings.off_probability)  # True for NaN
        active, since_s = self._alarm(last, time_s, may_start & is_usable & ~is_refuted, may_end)

        new = _WarningState(
            *own.columns,
            *free.columns,
            time_s=np.full(len(tracks), time_s),
            start_s=start_s,
            contact=contact,
            cut_in=cut_in,
            known_s=np.where(is_known, time_s, last.known_s),
            beside_s=beside_s,
            since_s=since_s,
            is_on=active.astype(np.float64),
        )
        known_s = self._tracks.known[_KNOWN_ROW]
        self._tracks.put(tracks.track_id, np.array(new), keep_known=time_s - known_s <= _MAX_GAP_S)
        return Warnings(probability, active, offset.x, offset_sigma_m)

    def _position(
        self,
        is_person: BoolArray,
        motion: FilteredRanges,
        own: ConstantVelocity,
        state: ConstantVelocity,
        x: ConstantVelocity,
    ) -> tuple[ConstantVelocity, ConstantVelocity, ConstantVelocity]:
        """The own motion of the objects, if they move; their distances, whose `state` lags behind it;
        and their lateral offsets from the ego path, at x from the camera: with the error of their
        scale.
        """
        moves, scale_variance = self._moving(motion), _scale_variance(motion)
        moving = ConstantVelocity(own.x, moves * own.v, own.P_xx, own.P_xv, moves * own.P_vv)
        gap = without_lag(state, moving.v - motion.own_mps2, moving.P_vv)
        gap = _with_scale(gap, scale_variance, moving=moves)
        offset = self._offset(is_person, gap, _with_scale(x, scale_variance), moves)
        return moving, gap, offset

    def _with_prior_speed(self, state: ConstantVelocity, is_person: BoolArray) -> ConstantVelocity:
        """The distances and rates, with the prior speed of people along the road."""
        if not self._ego.has_speed or not is_person.any():
            return state
        walking = np.ones((1, len(is_person)))
        free_mps = np.full(len(is_person), _FREE_ALONG_MPS)
        people = _with_rate(
            state, -self._ego.speed_mps, _PERSON_ALONG_MPS * walking, free_mps, walking
        )
        return ConstantVelocity(*np.where(is_person, people.columns, state.columns))

    def _moving(self, motion: FilteredRanges) -> FloatArray:
        """(N,) probability that the objects move; 1 = unknown."""
        if motion.static is None or not self._ego.has_speed:
            return np.ones_like(motion.state.x)
        return 1.0 - motion.static

    def _own_motion(
        self, measured: ConstantVelocity, last: _WarningState, time_s: float, is_known: BoolArray
    ) -> tuple[ConstantVelocity, BoolArray]:
        """Speed u of the objects along the road with its change, and which objects are new or have
        changed.

        `is_known` (N,) is whether their distances are known.
        """
        predicted = last.own.predict(time_s - last.time_s, q=_JERK_NOISE**2)
        if self._ego.change_mps:
            predicted = replace(predicted, x=predicted.x + self._ego.change_mps)
        u, R = measured.v + self._ego.speed_mps, _RATE_FACTOR * measured.P_vv
        nu = u - predicted.x
        is_stale = ~(time_s - last.known_s <= _MAX_GAP_S)
        is_same = nu * nu <= _JUMP_SIGMA**2 * (predicted.P_xx + R)  # False for NaN
        starts = is_known & (is_stale | ~is_same)
        state = predicted.update(nu, R, valid=is_known)
        if starts.any():
            state = _started(starts, u, R, _INITIAL_ACCELERATION_MPS2**2, state)
        return state, starts

    def _may_start(
        self, objects: _Objects, log_odds: FloatArray, needed_mps2: FloatArray
    ) -> BoolArray:
        """(N,) whether the sequential test is for an alarm, by the log odds of a contact."""
        settings = self.settings
        on = np.where(objects.is_person, settings.person_probability, settings.on_probability)
        is_closing = -objects.gap.v >= settings.min_closing_mps
        return is_closing & is_due(log_odds, on, needed_mps2, settings.min_deceleration_mps2)

    def _alarm(
        self, last: _WarningState, time_s: float, may_start: BoolArray, may_end: BoolArray
    ) -> tuple[BoolArray, FloatArray]:
        """Whether each alarm is on, and since when the condition for its next change holds; NaN =
        it does not hold.
        """
        settings, is_on = self.settings, last.is_on > 0
        needed_s = np.where(is_on, _MIN_OFF_S, max(settings.min_on_s, settings.uncertain_on_s))
        since_s = np.where(
            np.where(is_on, may_end, may_start), np.fmin(last.since_s, time_s), np.nan
        )
        changes = time_s - since_s >= needed_s - 1e-9
        return is_on ^ changes, np.where(changes, np.nan, since_s)

    def _may_touch(self, gap: ConstantVelocity, own: ConstantVelocity) -> BoolArray:
        """(N,) False where the probability of contact is below 0.2 %, since the object is too far
        away.
        """
        settings = self.settings
        H, h = settings.horizon_s, manoeuvre(settings.horizon_s, MANOEUVRE_S)
        least_m = gap.x - settings.front_m + H * np.minimum(gap.v, 0.0)
        least_m += h * np.minimum(own.v - self._ego.acceleration_mps2, 0.0)
        variance = (
            gap.P_xx
            + H * (2 * gap.P_xv + H * gap.P_vv)
            + h * h * (own.P_vv + _ACCELERATION_MPS2**2)
        )
        return np.asarray(least_m <= _REACH_SIGMA * np.sqrt(variance))

    def _predicted(self, objects: _Objects, is_usable: BoolArray) -> tuple[FloatArray, FloatArray]:
        """(2, N) probabilities of a contact and a cut-in by the motion of this frame, and (N,) the
        deceleration that the ego vehicle needs.

        They are 0 without a computation for objects that are too far away, NaN for those whose
        motion is not usable.
        """
        settings = self.settings
        predicted = np.zeros((2, len(is_usable)))
        predicted[:, ~is_usable] = np.nan
        needed_mps2 = np.zeros(len(is_usable))
        near_m = _CUT_IN_HEADWAY_S * self._ego.speed_mps
        is_near = objects.gap.x - settings.front_m < near_m
        rows = np.flatnonzero(is_usable & (self._may_touch(objects.gap, objects.own) | is_near))
        if len(rows):
            encounter = self._encounter(objects, rows)
            is_person = objects.is_person[rows]
            if_it_goes_on = contact_probability(
                encounter,
                horizon_s=settings.horizon_s,
                manoeuvre_s=MANOEUVRE_S,
                ego_length_m=settings.ego_length_m,
            )
            goes_on = np.where(is_person, 1.0, 1.0 - yielding_probability(encounter))
            predicted[0, rows] = if_it_goes_on * goes_on
            enters = self._cut_ins(encounter, objects.since_beside_s[rows])
            predicted[1, rows] = np.where(is_person, 0.0, enters)
            needed_mps2[rows] = needed_deceleration(encounter, settings.reaction_s)
        return predicted, needed_mps2

    def _encounter(self, objects: _Objects, rows: IntArray) -> Encounter:
        """Motion of the objects in the given rows relative to the ego vehicle and its path."""
        settings, ego, own = self.settings, self._ego, objects.own
        gap, offset = (
            ConstantVelocity(*np.array(state.columns).take(rows, axis=1))
            for state in (objects.gap, objects.offset)
        )
        gap = ConstantVelocity(gap.x - settings.front_m, *gap.columns[1:])
        u, u_change = gap.v + ego.speed_mps, own.v[rows]
        stops_s = np.full(len(rows) + 1, np.inf)
        if ego.has_speed:
            speeds, changes = np.empty((2, len(rows) + 1))
            speeds[:-1], speeds[-1] = u, ego.speed_mps
            changes[:-1], changes[-1] = u_change, ego.acceleration_mps2
            stops_s = stop_s(speeds, changes, MANOEUVRE_S)
        return Encounter(
            gap=gap,
            object_mps=u,
            object_mps2=u_change,
            # people need no time to stop or start
            object_stop_s=np.where(objects.is_person[rows], np.inf, stops_s[:-1]),
            acceleration_sigma_mps2=np.sqrt(own.P_vv[rows] + _ACCELERATION_MPS2**2),
            ego_mps=ego.speed_mps,
            ego_mps2=ego.acceleration_mps2,
            ego_stop_s=float(stops_s[-1]),
            offset=offset,
            half_width_m=objects.half_width_m[rows],
            lateral_acceleration_mps2=np.where(
                objects.is_person[rows],
                _PERSON_ACCELERATION_MPS2,
                _VEHICLE_ACCELERATION_MPS2,
            ),
        )

    def _offset(
        self,
        is_person: BoolArray,
        gap: ConstantVelocity,
        x: ConstantVelocity,
        moves: FloatArray,
    ) -> ConstantVelocity:
        """Lateral offset of the objects, at x from the camera, from the ego path and its rate, with
        the errors of the path; `moves` is the probability that they move.
        """
        ego, w, V = self._ego, self._ego.yaw, self._ego.path_mps
        T = np.maximum(gap.x, 0.0) / V
        T2 = T * T
        T3, T4 = T2 * T, T2 * T2
        u = gap.v + ego.speed_mps if ego.has_speed else np.zeros_like(gap.v)
        turning = u if ego.has_yaw else gap.v
        P_ww, P_wa, P_aa, q = w.P_xx, w.P_xv, w.P_vv, ego.yaw_noise
        offset = ConstantVelocity(
            x.x - V * T2 * (w.x / 2 + T * w.v / 6),
            x.v - T * (w.x + T * w.v / 2) * u,
            x.P_xx + V * V * T4 * (P_ww / 4 + T * (P_wa / 6 + T * (P_aa / 36 + T * (q / 252)))),
            x.P_xv
            + V * T3 * (P_ww / 2 + T * (5 * P_wa / 12 + T * (P_aa / 12 + T * (q / 72)))) * turning,
            x.P_vv + T2 * (P_ww + T * (P_wa + T * (P_aa / 4 + T * (q / 20)))) * turning**2,
        )
        # Prior of the rate: of static, oncoming and other vehicles; people may all cross.
        oncoming = moves * ndtr(-u / np.sqrt(gap.P_vv)) if ego.has_speed else np.zeros_like(u)
        weights = np.array([1.0 - moves, oncoming, moves - oncoming])
        sigmas_mps = np.where(is_person, _PERSON_LATERAL_MPS, _VEHICLE_LATERAL_MPS)
        free_mps = np.where(is_person, _FREE_PERSON_MPS, _FREE_LATERAL_MPS)
        return _with_rate(offset, 0.0, sigmas_mps, free_mps, weights)

    def _cut_ins(self, encounter: Encounter, since_beside_s: FloatArray) -> FloatArray:
        """(K,) probability that an object moves from the side into the ego path at a short
        headway.
        """
        ego, gap, offset = self._ego, encounter.gap, encounter.offset
        is_near = (gap.x < _CUT_IN_HEADWAY_S * ego.speed_mps) & (gap.x > _MIN_CUT_IN_GAP_M)
        if ego.speed_mps < _MIN_CUT_IN_SPEED_MPS or not is_near.any():
            return np.zeros(len(gap.x))
        fraction = overlap_probability(
            offset,
            encounter.half_width_m,
            encounter.lateral_acceleration_mps2,
            _CUT_IN_AHEAD_S,
        )
        enters = (since_beside_s <= _BESIDE_S) & (offset.x * offset.v < 0)
        is_along = ndtr(encounter.object_mps / np.sqrt(gap.P_vv))
        enters &= is_near & (gap.v <= _MAX_CUT_IN_MPS)
        return np.where(enters, fraction * is_along, 0.0)


def _half_widths(
    class_id: IntArray, seen_m: FloatArray, along_mps: FloatArray, across_mps: FloatArray
) -> tuple[FloatArray, FloatArray]:
    """(2, N) half the extents of objects across the ego path when it reaches them, and their
    standard deviations.

    A box that is `seen_m` wide on either side of its middle holds the side of a vehicle that has
    turned, too. A vehicle that drives along the road, or is parked, will be as wide as it is;
    one that crosses as long. The extent is between that of its class in the direction in which it
    moves, and the seen one.
    """
    along_mps = np.abs(along_mps) + _LATERAL_MPS
    sizes_m = LENGTH_M[class_id], TYPICAL_WIDTH_M[class_id]
    turned_m = sizes_m[0] * np.abs(across_mps) + sizes_m[1] * along_mps
    moved_m = turned_m / (2 * np.hypot(along_mps, across_mps))
    least_m = np.where(class_id == _PERSON, seen_m, np.minimum(seen_m, moved_m))
    return (least_m + seen_m) / 2, (seen_m - least_m) / math.sqrt(12)


def _is_plausible(objects: _Objects) -> BoolArray:
    """(N,) whether the motion is one that road users have, and known well enough."""
    own, gap = objects.own, objects.gap
    least_mps, largest_mps = _MAX_CLOSING_SIGMA_MPS
    most_mps = np.minimum(np.maximum(_MAX_CLOSING_FRACTION * np.abs(gap.v), least_mps), largest_mps)
    most_lateral_mps = np.where(objects.is_person, _MAX_RUNNING_MPS, _MAX_LATERAL_MPS)
    is_certain = gap.P_vv <= most_mps**2
    is_along = (np.abs(own.x) < _MAX_SPEED_MPS) & (np.abs(own.v) < _MAX_ACCELERATION_MPS2)
    return np.asarray(is_certain & is_along & (np.abs(objects.offset.v) < most_lateral_mps))


def _scale_variance(motion: FilteredRanges) -> FloatArray:
    """(N,) variance s^2 of the relative error that all distances of a track have in common."""
    common_m2 = np.maximum(motion.ranges.sigma_m**2 - motion.state.P_xx, 0.0)
    return np.asarray(common_m2 / motion.state.x**2)


def _with_scale(
    state: ConstantVelocity, variance: FloatArray, *, moving: FloatArray | float = 1.0
) -> ConstantVelocity:
    """The states with a common relative error of this variance, which the rates share as far as
    objects are `moving`.
    """
    x, v = state.x, state.v
    of_rates = moving * variance
    return ConstantVelocity(
        x=x,
        v=v,
        P_xx=state.P_xx + variance * x**2,
        P_xv=state.P_xv + of_rates * x * v,
        P_vv=state.P_vv + of_rates * v**2,
    )


def _free_motion(ranges: Ranges | None, last: _WarningState, time_s: float) -> ConstantVelocity:
    """Distances and rates of the tracks by a filter in which every speed is equally probable."""
    state = last.free.predict(time_s - last.time_s, q=_FREE_NOISE**2)
    if ranges is None:
        return state
    z, R = ranges.distance_m, ranges.sigma_m**2
    updated = state.update(z - state.x, R, valid=np.isfinite(z))
    is_new = np.isnan(state.x)
    return _started(is_new, z, R, _FREE_SIGMA_MPS**2, updated) if is_new.any() else updated


def _started(
    starts: BoolArray, x: FloatArray, P_xx: FloatArray, P_vv: float, state: ConstantVelocity
) -> ConstantVelocity:
    """The states, of which some start at x with the rate 0 and these variances."""
    zero = np.zeros_like(x)
    first = np.array([x, zero, P_xx, zero, zero + P_vv])
    return ConstantVelocity(*np.where(starts, first, np.array(state.columns)))


def _with_rate(
    state: ConstantVelocity,
    rate_mps: float,
    sigmas_mps: FloatArray,
    free_mps: FloatArray,
    weights: FloatArray,
) -> ConstantVelocity:
    """The states after a pseudo-measurement of their rates, with one of the sigmas (K, N) of the
    probabilities `weights` (K, N) for most objects, and the larger sigma `free_mps` for a fraction
    `_FREE_FRACTION` of them: mean and covariance of all.
    """
    R = np.array([*sigmas_mps, free_mps]) ** 2
    S = state.P_vv + R
    nu = rate_mps - state.v
    prior = np.empty_like(S)
    prior[:-1], prior[-1] = (1.0 - _FREE_FRACTION) * weights, _FREE_FRACTION
    likelihood = prior * np.exp(-nu * nu / (2.0 * S)) / np.sqrt(S)
    w = likelihood / np.maximum(np.add.reduce(likelihood), 1e-300)
    K_x, K_v = state.P_xv / S, state.P_vv / S
    x, v = state.x + K_x * nu, state.v + K_v * nu
    mean_x, mean_v = np.add.reduce(w * np.array([x, v]), axis=1)
    dx, dv = x - mean_x, v - mean_v
    P_xx, P_xv, P_vv = np.add.reduce(
        w
        * np.array(
            [
                state.P_xx - K_x * state.P_xv + dx * dx,
                state.P_xv - K_x * state.P_vv + dx * dv,
                state.P_vv - K_v * state.P_vv + dv * dv,
            ]
        ),
        axis=1,
    )
    return ConstantVelocity(mean_x, mean_v, P_xx, P_xv, P_vv)
