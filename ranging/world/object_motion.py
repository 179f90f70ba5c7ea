"""ObjectMotion: speed over ground, heading, world position and state of tracks, from distances and
ego motion.

    u = v + V - w x    speed along the optical axis: filtered rate v of the distance, ego speed V, yaw rate w
    x'                 speed to the right of it over ground (`LateralFilters`, which removes the motion of the camera)

The filter has the probability q that an object moves along the axis, and the moments of u over both
cases; the moments of u for moving objects follow, with the variance A. With odds of r, these have
stopped (S), whose u is 0. x' has the variance B = f P_x'x' (f since errors of filtered rates are
correlated). An object that does not move along the axis is at rest (R) or
crosses it (C, a fraction c); of the objects that move along it (M), three quarters have small
speeds m across it; the rest and C have any speed of 1 sigma M. With L_a = N(x'; B + a^2) / N(x';
B):

    R + S : C : M = (1 - q) (1 - c) + q r / L_M(u; A) : (1 - q) c L_M : q (3/4 L_m + 1/4 L_M)

The speed is the mean over these, 0, |x'| and |(u_M, x')|, and its variance contains their
differences. A wrong size scales the motion across the axis, too, of objects at rest if the camera
moves to its right: the variance of its speed U and s^2 (x' - U)^2 are part of B, with the systematic
error s of the distance.

The probabilities of the states are those of R + S, and of C and both parts of M times the fractions
of their velocities (Gaussians) that point along the drive, against it, and across. The sigmas of
the ego speed and of the size are part of A, so that neither makes a car oncoming. The filter has
weighed all frames so far in q: the probabilities of a frame are not multiplied over time.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Literal, NamedTuple, get_args

import numpy as np
from scipy.special import ndtr

from track_range.detection.classes import ROAD_CLASSES
from track_range.foundation.arrays import FloatArray, IntArray
from track_range.foundation.track_state import TrackState
from track_range.ranging.filtering.distance_filter import FilteredRanges
from track_range.ranging.filtering.lateral_motion import LateralMotion
from track_range.ranging.filtering.motion_models import STATIC_RATE_SIGMA_MPS
from track_range.ranging.world.ego_path import EgoPose
from track_range.stereo.odometry.ego_motion import EgoMotion

MotionState = Literal["parked", "moving", "oncoming", "crossing"]
# codes: at rest, along the drive, against it, across
MOTION_STATES: tuple[MotionState, ...] = get_args(MotionState)
_PARKED = 0
# f, as in the collision warning: errors of filtered rates last longer than the filter assumes
RATE_FACTOR = 2.0
# (road classes,) c of vehicles and of people
_CROSSING_OF_CLASS = np.array([0.5 if name == "person" else 0.1 for name in ROAD_CLASSES])
_STOPPED = 0.1  # r
_MIN_MOVING = 1e-3  # smallest q, against a division by zero
# (road classes,) M of vehicles and of people
_FREE_MPS = np.array([1.5 if name == "person" else 8.0 for name in ROAD_CLASSES])
_ACROSS_MPS, _ALONG_FRACTION = 0.3, 0.75  # m, and the fraction of moving objects along the road

_REST_SIGMA_MPS = STATIC_RATE_SIGMA_MPS  # of the speed of an object at rest, as in the filter
_UNKNOWN_EGO_SIGMA_MPS = 0.1  # sigma_V of an ego speed without one
_MAX_SIGMA_MPS = 3.0  # largest standard deviation of a reported speed
# probability from which a state is stated, after this time, and below which it is so no longer
_SURE, _HOLD_S, _KEPT = 0.8, 0.3, 0.5
# time constant with which a state is forgotten while the ego speed is not measured
_FORGET_S = 20.0
_STATES_MIXED = 1.0 / len(MOTION_STATES)  # probability of each state if nothing is known
# (Q, 1, 1) nodes in standard deviations, and their weights, for the mean over a Gaussian
_NODES = np.linspace(-3.2, 3.2, 17)[:, None, None]
_NODE_WEIGHTS = np.exp(-(_NODES**2) / 2) / np.exp(-(_NODES**2) / 2).sum()
_MAX_GAP_S = 1.0  # longest time without a track, after which its state is unknown again


@dataclass(frozen=True, slots=True)
class OverGround:
    """Motion of N tracks over ground, (N,) each; NaN = unknown. `along_mps` and `right_mps` are in
    camera axes.
    """

    speed_mps: FloatArray
    sigma_mps: FloatArray  # standard deviation of `speed_mps`
    # direction of motion, counterclockwise from the camera's optical axis; NaN also at rest
    heading_rad: FloatArray
    states: FloatArray  # (4, N) probabilities of `MOTION_STATES`
    along_mps: FloatArray  # u, if it moves
    right_mps: FloatArray  # x'

    @property
    def moving(self) -> FloatArray:
        """(N,) probability that the object moves, 0..1."""
        return np.asarray(1.0 - self.states[_PARKED])


@dataclass(frozen=True, slots=True)
class ObjectMotion:
    """Motion of N tracks in the world, (N,) each; NaN = unknown.

    Attributes:
        speed_mps: speed over ground; the mean over being at rest and moving.
        speed_sigma_mps: its standard deviation.
        heading_deg: direction of motion in the frame `map`, counterclockwise from its x axis, -180
            to 180; NaN also at rest.
        world_x_m: position in the frame `map` of the middle of the object's visible side, at the
            filtered distance.
        world_y_m: the same along y.
        state: index into `MOTION_STATES`.
        state_probability: probability that the state is right.
    """

    speed_mps: FloatArray
    speed_sigma_mps: FloatArray
    heading_deg: FloatArray
    world_x_m: FloatArray
    world_y_m: FloatArray
    state: FloatArray
    state_probability: FloatArray

    @classmethod
    def unknown(cls, n: int) -> ObjectMotion:
        """Motion of n tracks whose motion is unknown."""
        return cls(*np.full((len(cls.__slots__), n), np.nan))


class GroundVelocity(NamedTuple):
    """Velocities of N tracks over ground in camera axes, (N,) each; NaN = unknown."""

    along_mps: FloatArray  # u
    right_mps: FloatArray  # x'
    along_variance: FloatArray  # of u, over being at rest and moving
    right_variance: FloatArray  # B

    @classmethod
    def of(cls, motion: FilteredRanges, lateral: LateralMotion, ego: EgoMotion) -> GroundVelocity:
        """The velocities by filtered distances and lateral positions."""
        v, x = motion.state, lateral.state
        sigma_V, yaw_rad_s, s2 = _errors(motion, ego)
        u = v.v + ego.speed_mps - yaw_rad_s * x.x
        A = v.P_vv + s2 * v.v**2 + sigma_V**2
        B = RATE_FACTOR * x.P_vv + s2 * (x.v - ego.right_mps) ** 2 + ego.right_sigma_mps**2
        return cls(u, x.v, A, B)

    @classmethod
    def of_courses(cls, motion: ObjectMotion, pose: EgoPose) -> GroundVelocity:
        """The velocities by the speeds and headings in the frame `map`, in which the camera has a
        `pose`.
        """
        heading_rad = np.radians(motion.heading_deg) - pose.heading_rad
        speed_mps = np.where(np.isnan(heading_rad), 0.0 * motion.speed_mps, motion.speed_mps)
        heading_rad, variance = np.nan_to_num(heading_rad), motion.speed_sigma_mps**2
        along_mps, right_mps = speed_mps * np.cos(heading_rad), -speed_mps * np.sin(heading_rad)
        return cls(along_mps, right_mps, variance, variance)


def _errors(motion: FilteredRanges, ego: EgoMotion) -> tuple[float, float, FloatArray]:
    """sigma_V, yaw rate w, and variance s^2 (N,) of the distances that all frames share."""
    sigma_V = ego.speed_sigma_mps
    sigma_V = sigma_V if math.isfinite(sigma_V) else _UNKNOWN_EGO_SIGMA_MPS
    yaw_rad_s = ego.yaw_rad_s if math.isfinite(ego.yaw_rad_s) else 0.0
    state = motion.state
    s2 = np.maximum(motion.ranges.sigma_m**2 - state.P_xx, 0.0) / state.x**2
    return sigma_V, yaw_rad_s, s2


def over_ground(
    motion: FilteredRanges,
    lateral: LateralMotion,
    class_id: IntArray,
    ego: EgoMotion,
    axis_rad: float = 0.0,
) -> OverGround:
    """Motion over ground of N tracks of road classes `class_id` (N,), from their filtered distances
    and positions.

    `motion` and `lateral` are of one frame; the lateral filter must know the yaw rate of `ego`,
    too. Speeds are NaN without an ego speed, and where their standard deviation is above 3 m/s.
    `axis_rad` is the direction of the axis from that of the drive, positive = to the left.
    """
    v, V = motion.state.v, ego.speed_mps
    sigma_V, _, s2 = _errors(motion, ego)
    u, right, _, B = GroundVelocity.of(motion, lateral, ego)

    # Moments of u where the object moves along the axis.
    static = np.zeros_like(v) if motion.static is None else motion.static
    q = np.maximum(1.0 - static, _MIN_MOVING)
    u_M = u / q
    A = (motion.state.P_vv + u**2 - (1 - q) * (_REST_SIGMA_MPS**2 + sigma_V**2)) / q - u_M**2
    A = np.maximum(A, _REST_SIGMA_MPS**2) + s2 * (u_M - V) ** 2 + sigma_V**2

    # Probabilities of rest, and of moving along with a small or any speed across, and across only.
    M2, c = _FREE_MPS[class_id] ** 2, _CROSSING_OF_CLASS[class_id]
    m2 = np.full_like(M2, _ACROSS_MPS**2)
    log_u, log_m, log_M = _log_ratio(
        np.array([u_M, right, right]), np.array([A, B, B]), np.array([M2, m2, M2])
    )
    largest = np.maximum(np.maximum(log_m, log_M), 0.0)  # against an overflow
    L_0, L_m, L_M, of_stopped = np.exp(
        np.array([-largest, log_m - largest, log_M - largest, -log_u])
    )
    at_rest = ((1 - q) * (1 - c) + q * _STOPPED * of_stopped) * L_0
    parts = np.array(
        [q * _ALONG_FRACTION * L_m, q * (1 - _ALONG_FRACTION) * L_M, (1 - q) * c * L_M]
    )
    total = at_rest + (parts[0] + parts[1] + parts[2])
    at_rest, parts = at_rest / total, parts / total
    shrink = np.array([m2 / (m2 + B), M2 / (M2 + B), M2 / (M2 + B)])
    no_speed, rest_variance = np.zeros_like(u), np.full_like(u, _REST_SIGMA_MPS**2)
    velocity = np.array([u_M, u_M, no_speed]), shrink * right
    variances = np.array([A, A, rest_variance]), shrink * B
    directions = _directions(velocity, variances, axis_rad)

    # The speed at rest, across and along, and its mean.
    along_mps, across_mps = np.hypot(u_M, right), np.abs(right)
    along_variance = (u_M**2 * A + right**2 * B) / np.maximum(along_mps, 1e-6) ** 2
    along, across = parts[0] + parts[1], parts[2]
    speed_mps = across * across_mps + along * along_mps
    variance = (
        at_rest * (rest_variance + speed_mps**2)
        + across * (B + (across_mps - speed_mps) ** 2)
        + along * (along_variance + (along_mps - speed_mps) ** 2)
    )
    sigma_mps = np.sqrt(variance)
    unknown = np.where(sigma_mps <= _MAX_SIGMA_MPS, 0.0, np.nan)  # NaN for a sigma of NaN
    u_moving = u_M * along / (across + along)
    heading_rad = np.where(at_rest <= 0.5, np.arctan2(-right, u_moving), np.nan)
    states = np.empty((len(MOTION_STATES), len(u)))
    states[_PARKED], states[1:] = at_rest, (parts * directions).sum(axis=1)
    return OverGround(
        speed_mps + unknown, sigma_mps + unknown, heading_rad + unknown, states, u_moving, right
    )


def _directions(
    velocity: tuple[FloatArray, FloatArray],
    variances: tuple[FloatArray, FloatArray],
    axis_rad: float,
) -> FloatArray:
    """(3, K, N) probabilities that velocities point along the drive, against it, and across.

    The velocities and their variances, (K, N) each, are along the camera's axis and to the right of
    it, Gaussian and independent.
    """
    c, s = math.cos(axis_rad), math.sin(axis_rad)
    (along, right), (along_variance, right_variance) = velocity, variances
    forward, left = c * along + s * right, s * along - c * right
    forward_variance = c * c * along_variance + s * s * right_variance
    covariance = c * s * (along_variance - right_variance)
    # of the speed to the left, given the one forward
    left_sigma = np.sqrt(along_variance * right_variance / forward_variance)
    step = _NODES * np.sqrt(forward_variance)
    at, left = forward + step, left + step * (covariance / forward_variance)
    reach = np.abs(at)
    within = ndtr((reach - left) / left_sigma) - ndtr((-reach - left) / left_sigma)
    within *= _NODE_WEIGHTS
    is_ahead = at > 0
    ahead, against = (within * is_ahead).sum(axis=0), (within * ~is_ahead).sum(axis=0)
    return np.array([ahead, against, 1.0 - ahead - against])


def _log_ratio(rate: FloatArray, variance: FloatArray, sigma2: FloatArray) -> FloatArray:
    """Log N(rate; variance + sigma2) / N(rate; variance), in arrays of one shape."""
    total = variance + sigma2
    return np.asarray((rate**2 * (1 / variance - 1 / total) - np.log(total / variance)) / 2)


class ObjectMotions:
    """Motion of all tracks of a video in the world; their states have a memory."""

    def __init__(self, axis_rad: float = 0.0) -> None:
        """`axis_rad` is the direction of the camera's axis from that of the drive, positive = to the
        left, since states are relative to the drive.
        """
        self._axis_rad = axis_rad
        # probabilities of the states, state, next state, since when it is sure, time
        self._tracks = TrackState(np.full(len(MOTION_STATES) + 4, np.nan))

    def update(
        self,
        track_id: IntArray,
        class_id: IntArray,
        motion: FilteredRanges,
        lateral: LateralMotion,
        time_s: float,
        *,
        ego: EgoMotion,
        pose: EgoPose,
    ) -> ObjectMotion:
        """Motion of N tracks (N,) of one frame at `time_s`, with the motion and the pose of the
        camera.
        """
        ground = over_ground(motion, lateral, class_id, ego, self._axis_rad)
        x_m, y_m = pose.to_world(motion.state.x, lateral.state.x)
        heading_rad = ground.heading_rad + pose.heading_rad
        heading_deg = np.degrees(np.arctan2(np.sin(heading_rad), np.cos(heading_rad)))
        shown = np.full_like(ground.states, np.nan) if ego.is_predicted else ground.states
        state, probability = self._stated(track_id, shown, time_s)
        return ObjectMotion(
            ground.speed_mps, ground.sigma_mps, heading_deg, x_m, y_m, state, probability
        )

    def _stated(
        self, track_id: IntArray, shown: FloatArray, time_s: float
    ) -> tuple[FloatArray, FloatArray]:
        """(N,) states after this frame, and their probabilities: sure ones for some time, until
        they are less probable than the others together.

        `shown` (4, N) are the probabilities by this frame; NaN = it shows nothing.
        """
        columns = self._tracks.get(track_id)
        before, (last, pending, since_s, last_s) = columns[:-4], columns[-4:]
        forgotten = np.exp((last_s - time_s) / _FORGET_S)
        held = _STATES_MIXED + (before - _STATES_MIXED) * forgotten
        is_shown = np.isfinite(shown).all(axis=0)
        p = np.where(is_shown, shown, held)
        best = np.fmax(p, 0.0).argmax(axis=0)
        is_sure = is_shown & (p.max(axis=0) >= _SURE)
        target = np.where(is_sure, best, np.nan)
        since_s = np.where(target == pending, since_s, time_s)
        is_stated = is_sure & (time_s - since_s >= _HOLD_S - 1e-9)
        state = np.where(is_stated, target, last)
        is_known = np.isfinite(state)
        index = np.where(is_known, state, 0.0).astype(np.int64)
        probability = p[index, np.arange(len(index))]
        is_kept = is_known & (probability >= _KEPT)
        state, probability = np.where(is_kept, np.array([state, probability]), np.nan)
        columns[:-4] = p
        for row, part in enumerate((state, target, since_s, time_s), start=len(p)):
            columns[row] = part
        is_recent = time_s - self._tracks.known[-1] <= _MAX_GAP_S
        self._tracks.put(track_id, columns, keep_known=is_recent)
        return state, probability
