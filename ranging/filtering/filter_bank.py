"""FilterBank: Kalman filters of the distances of N tracks by M methods with G models of the motion,
and the steps of a filter.

    motion   x = [d v]'   (2)     distance in m and its rate in m/s

                 F = [1 dt; 0 1]                  (2, 2)
                 B = [-dt/2 -1]'                  (2)       input: dV, change of the ego speed
                 Q = q [dt^3/3 dt^2/2; dt^2/2 dt] + B B' var(dV) + [drift dt, 0; 0, 0]    (2, 2), q of the model
                 H = [1/d 0]                      (2)       z = log d
                 R = lambda (s sigma / d)^2

    side     [d v k]'     (3)     heading parameter k of a box that the image border cuts (`cut_boxes`)
    key      [d v r]'     (3)     distance r in the key frame of the growth in the images (`key_distance`)
    own      [d v a]'     (3)     acceleration a of moving objects over ground (`own_acceleration`)

The matrices are of one filter. The code is written out by their elements, P by P_dd, P_dv, P_vv,
and each element is an array (M, G, N) over all filters. No filter has k and r at the same time:
boxes that are cut have no key frame.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import NamedTuple

import numpy as np

from track_range.detection.classes import ROAD_CLASSES
from track_range.foundation.arrays import BoolArray, FloatArray
from track_range.foundation.constant_velocity import ConstantVelocity
from track_range.ranging.filtering.cut_boxes import CutBoxes, SideState
from track_range.ranging.filtering.key_distance import KeyDistance
from track_range.ranging.filtering.motion_models import InteractingModels
from track_range.ranging.filtering.observation import FilterStep
from track_range.ranging.filtering.own_acceleration import OwnAcceleration

# kappa, growth of the systematic variance per change of log distance; chosen on 13 of KITTI's
# sequences
_DRIFT = 0.2
_LONG_DRIFT_HZ, _IS_LONG = 0.15, np.array([name in ("truck", "bus") for name in ROAD_CLASSES])
"""Growth per second of the variance for long vehicles, whose visible sides change in turns."""
# growth of the variance per radian that the camera turns: other sides of objects come into view,
# and the road at their wheels has another slope than the road ahead; chosen like `_DRIFT`
_TURN_DRIFT = 2.0

# largest relative sigma that drifts: that of shapes; more is an unknown scale, which is constant
_MAX_DRIFTING = 0.08

_N_STATES = 20  # numbers per filter, see `FilterBank.rows`
# a track that is predicted to be nearer has passed the camera, and its filter restarts
_MIN_DISTANCE_M = 0.3


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


class History(NamedTuple):
    """What the filters of M methods keep of the last frames, the same for all models, (M, 1, N)
    each, or of a shape that is repeated to this one.
    """

    systematic: FloatArray  # systematic variance of log d at the last measurement; NaN = none
    time_s: FloatArray  # of the state; NaN = new track
    measured_s: FloatArray  # time of the last measurement
    n_outliers: FloatArray  # consecutive ones
    condition: FloatArray  # of the last measurement
    steady_since_s: FloatArray  # time of the start or of the last change of condition
    is_hidden: FloatArray  # of the last measurement; 1 = True
    edge_ratio: FloatArray  # q of the last box (`CutBoxes`)


class Gate(NamedTuple):
    """Innovations of one frame's distances, and what follows from their size."""

    nu: FloatArray  # (M, G, N) m
    R: FloatArray  # (M, G, N) m^2
    # (M, 1, N) |nu| in units of the outlier limit, of the model that expects the distance most
    excess: FloatArray
    n_outliers: FloatArray  # (M, 1, N) consecutive ones
    is_lost: BoolArray  # (M, 1, N) filters that are new, expired or have only outliers
    known: BoolArray  # (M, 1, N) measured by a running filter
    starts: BoolArray  # (M, 1, N) measured by a lost filter


class FilterBank(NamedTuple):
    """Filters of M methods, G models and N tracks: their state, in arrays (M, G, N), and its steps.

    Each step of a frame returns the bank with the next state. (A named tuple: copies of dataclasses
    take three times as long, a tenth of the time of a frame.)
    """

    models: InteractingModels
    settings: FilterSettings
    motion: ConstantVelocity  # d, v and their covariance; NaN = new track
    weight: FloatArray  # probabilities of the models; 0 = new track
    ego_mps: FloatArray  # V of the last frame, see `EgoStep`; NaN = unknown
    side: SideState | None  # None = no box is cut
    key: KeyDistance | None  # None = there is no key frame
    acceleration: OwnAcceleration
    history: History
    # relative variance of d by the noise of the free edges of this frame's boxes
    edge_variance: FloatArray | float = 0.0

    @classmethod
    def new(cls, models: InteractingModels, settings: FilterSettings, n_methods: int) -> FilterBank:
        """Filters of one track without a measurement, (M, G, 1)."""
        shape = (n_methods, len(models.q), 1)
        nan, zero = np.full(shape, np.nan), np.zeros(shape)
        none, n_none = nan[:, :1], zero[:, :1]
        return cls(
            models=models,
            settings=settings,
            motion=ConstantVelocity(x=nan, v=nan, P_xx=zero, P_xv=zero, P_vv=zero),
            weight=zero,
            ego_mps=nan,
            side=None,
            key=None,
            acceleration=OwnAcceleration(zero, zero, zero, zero, zero),
            history=History(
                systematic=none,
                time_s=none,
                measured_s=none,
                n_outliers=n_none,
                condition=n_none,
                steady_since_s=none,
                is_hidden=n_none,
                edge_ratio=n_none,
            ),
        )

    def rows(self) -> FloatArray:
        """(rows, N) the state for `TrackState`.

        The first 20 M G rows are of the models, (20, M, G, N): d v P_dd P_dv P_vv, probability, V,
        k P_dk P_vk P_kk, r P_dr P_vr P_rr, a P_da P_va P_aa P_ra; the last 8 M are the history,
        (8, M, 1, N).
        """
        side, key = self.side, self.key
        if side is None:
            side = SideState.none()
        if key is None:
            key = KeyDistance.none()
        M, G, N = self.weight.shape
        rows = np.empty(((_N_STATES * G + len(self.history)) * M, N))
        states, history = self._split(rows)
        own = (*self.motion.columns, self.weight, self.ego_mps)
        _fill(states, (*own, *side, *key, *self.acceleration))
        _fill(history, self.history)
        return rows

    def with_rows(self, rows: FloatArray) -> FilterBank:
        """Filters with the state `rows()` of other tracks."""
        states, history = self._split(rows)
        return self._replace(
            motion=ConstantVelocity(*states[:5]),
            weight=states[5],
            ego_mps=states[6],
            side=SideState(*states[7:11]),
            key=KeyDistance(*states[11:15]),
            acceleration=OwnAcceleration(*states[15:]),
            history=History(*history),
        )

    def history_of(self, rows: FloatArray) -> History:
        """The history in the state `rows()` of other tracks."""
        return History(*self._split(rows)[1])

    def _split(self, rows: FloatArray) -> tuple[FloatArray, FloatArray]:
        """The states (20, M, G, N) and the history (8, M, 1, N) in `rows`."""
        M, G, _ = self.weight.shape
        N, n = rows.shape[-1], _N_STATES * M * G
        return rows[:n].reshape(_N_STATES, M, G, N), rows[n:].reshape(len(self.history), M, 1, N)

    def slides(self, cut: CutBoxes | None) -> BoolArray:
        """(M, G, N) whether the box is cut, or was in the previous frame."""
        was_cut = np.zeros(self.weight.shape, np.bool_) if self.side is None else self.side.is_cut
        return was_cut if cut is None else was_cut | cut.is_cut

    def with_needed_states(self, step: FilterStep) -> FilterBank:
        """Filters without side states if no box is cut, and without key states if there is no key
        frame.
        """
        side, key = self.side, self.key
        if not step.slides.any():
            side = None
        if key is not None and step.observation.growth is None and not key.exists.any():
            key = None
        return self._replace(side=side, key=key)

    def predict(self, step: FilterStep) -> FilterBank:
        """The state at the time of this frame: x' = F x + B dV, P' = F P F' + Q.

        Filters without a recent measurement, and of tracks that have passed the camera, become NaN.
        """
        motion, side, edge_variance = self._moved(step)
        sigma_mps2 = self._acceleration_sigma(step)
        motion, acceleration = self.acceleration.predict(motion, step.dt, sigma_mps2)
        if step.ego.is_known:
            motion = _with_input(motion, step)
        P_dd = motion.P_xx
        if self.settings.learns_noise:
            P_dd = P_dd + step.dt * self._systematic_drift(step)
        has_gap = step.time_s - self.history.measured_s > self.settings.max_gap_s
        has_passed = (motion.x < _MIN_DISTANCE_M).any(axis=1, keepdims=True)
        is_expired = has_gap | has_passed
        motion = ConstantVelocity(
            x=np.where(is_expired, np.nan, motion.x),
            v=np.where(is_expired, np.nan, motion.v),
            P_xx=P_dd,
            P_xv=motion.P_xv,
            P_vv=motion.P_vv,
        )
        key = self.key
        if key is not None:
            key = self.acceleration.predict_key(key, step.dt)
            if side is not None:
                key = key.drop(step.slides)
        return self._replace(
            motion=motion,
            side=side,
            key=key,
            acceleration=acceleration,
            edge_variance=edge_variance,
        )

    def resize(self, step: FilterStep) -> FilterBank:
        """The state in the scale of this frame's believed sizes."""
        if step.resized is None:
            return self
        key = None if self.key is None else self.key.scaled(step.resized)
        acceleration = self.acceleration.scaled(step.resized)
        return self._replace(
            motion=self.motion.scaled(step.resized), key=key, acceleration=acceleration
        )

    def _acceleration_sigma(self, step: FilterStep) -> FloatArray:
        """(G, N) sigma_a in m/s^2."""
        return self.models.acceleration_sigma(step.class_id, is_ego_known=step.ego.is_known)

    def _moved(
        self, step: FilterStep
    ) -> tuple[ConstantVelocity, SideState | None, FloatArray | float]:
        """Motion and side after the time step, and the variance by free edges; along a cut box,
        it is the far end that moves.
        """
        cut, q = step.observation.cut, self.models.q[:, step.class_id]
        if self.side is None or cut is None:
            return self.motion.predict(step.dt, q=q), self.side, 0.0
        return self.side.predict(
            self.motion, self.history.edge_ratio, cut, step.dt, noise=q, slides=step.slides
        )

    def _systematic_drift(self, step: FilterStep) -> FloatArray:
        """Variance of d in m^2 per second by the changing systematic error; 0 for new tracks."""
        d, v = self.motion.x, self.motion.v
        turn_rad_s = step.turn_rad_s + step.across_mps / d
        per_s = _LONG_DRIFT_HZ * _IS_LONG[step.class_id] + _TURN_DRIFT * turn_rad_s
        changing = np.abs(d * v) * _DRIFT + d**2 * per_s
        variance = np.minimum(self.history.systematic, _MAX_DRIFTING**2)
        return np.asarray(np.fmax(variance * changing, 0.0))

    def interact(self, step: FilterStep) -> FilterBank:
        """The models after objects may have changed theirs (step 1 of `InteractingModels`).

        It follows the prediction, whose rates show where a static model follows a moving object: it
        is no longer static, and no object changes to it.
        """
        models = self.models
        if not step.ego.is_known:
            return self._replace(weight=models.interact(self.weight, step.prior, step.dt))
        V = step.ego.speed_mps
        size_sigma = np.sqrt(np.fmax(self.history.systematic, 0.0))
        static_mps = models.start_sigma_mps(step.class_id, 0.0, size_sigma * V)
        known_mps = np.hypot(static_mps, step.ego.sigma_mps)
        is_moving = np.abs(self.motion.v + V) > self.settings.outlier_sigma * known_mps
        possible = step.prior * ~(models.is_static & is_moving)
        weight = models.interact(self.weight, possible, step.dt)
        joins = np.isnan(self.ego_mps)
        if not self.settings.learns_noise or not joins.any():
            return self._replace(weight=weight)
        weight = np.where(joins & (self.weight[:, :1] == 0), step.prior, weight)
        return self._replace(weight=weight)._join_static(joins & models.is_static, V, static_mps)

    def _join_static(self, joins: BoolArray, V: FloatArray, static_mps: FloatArray) -> FilterBank:
        """The state where static models start, since the ego speed is known from now on: v = -V."""
        motion = replace(
            self.motion,
            v=np.where(joins, -V, self.motion.v),
            P_xv=np.where(joins, 0.0, self.motion.P_xv),
            P_vv=np.where(joins, static_mps**2, self.motion.P_vv),
        )
        key = self.key
        if key is not None:
            key = key._replace(P_vr=np.where(joins, 0.0, key.P_vr))
        return self._replace(motion=motion, key=key)

    def step_of_condition(self, step: FilterStep) -> FilterBank:
        """The state where the condition of a measurement changes, or a nearer box begins or ceases
        to hide a side.

        The distance may step by the old and the new systematic error together, which is no motion:
        P_dd' = P_dd + d^2 (s_old^2 + s_new^2).
        """
        last, measured, d = self.history, step.measured, self.motion.x
        is_given = measured.valid & np.isfinite(step.condition)
        is_changed = is_given & (step.condition != last.condition) & np.isfinite(d[:, :1])
        is_hidden = np.where(measured.valid, step.is_hidden, last.is_hidden)
        history = last._replace(
            condition=np.where(is_given, step.condition, last.condition),
            steady_since_s=np.where(is_changed, step.time_s, last.steady_since_s),
            is_hidden=is_hidden,
        )
        may_step = is_changed | (is_hidden != last.is_hidden)
        if not may_step.any():
            return self._replace(history=history)
        variance = d * d * (last.systematic + measured.systematic)
        variance = np.where(may_step & np.isfinite(d), variance, 0.0)
        motion = replace(self.motion, P_xx=self.motion.P_xx + variance)
        key = None if self.key is None else self.key.step(d, variance)
        return self._replace(motion=motion, key=key, history=history)

    def gate(self, step: FilterStep) -> Gate:
        """Innovations of the distances, nu = d (log z - log d), and which filters they correct."""
        measured, d = step.measured, self.motion.x
        nu = d * np.log(measured.distance_m / d)
        R = d * d * (measured.independent + self.edge_variance)
        limit = self.settings.outlier_sigma * np.sqrt(self.motion.P_xx + R)
        excess = (np.abs(nu) / limit).min(axis=1, keepdims=True)
        before = self.history.n_outliers
        n_outliers = np.where(measured.valid, (excess > 1) * (before + 1), before)
        is_lost = np.isnan(d[:, :1]) | (n_outliers >= self.settings.max_outliers)
        return Gate(
            nu=nu,
            R=R,
            excess=excess,
            n_outliers=n_outliers,
            is_lost=is_lost,
            known=measured.valid & ~is_lost,
            starts=measured.valid & is_lost,
        )

    def correct_by_distance(self, gate: Gate) -> FilterBank:
        """The state after the distances: K = P H' / S, x' = x + K nu, P' = P - K S K'.

        R of distances beyond the gate is larger, so that they count as little as at its limit
        (Huber). S is infinite without a distance, so that K = 0.
        """
        motion, side, key, known = self.motion, self.side, self.key, gate.known
        R = gate.R * np.maximum(1.0, gate.excess) ** 2
        S = np.where(known, motion.P_xx + R, np.inf)
        nu = np.where(known, gate.nu, 0.0)
        weight = self.models.update_probabilities(self.weight, nu, S, valid=known)
        P_dr = 0.0 if key is None else key.P_dr
        acceleration = self.acceleration.correct(motion, P_dr, nu, S)
        if side is not None:
            side = side.correct(motion, nu, S)
        if key is not None:
            key = key.correct(motion, nu, S)
        motion = motion.correct(nu, S)
        return self._replace(
            weight=weight, motion=motion, side=side, key=key, acceleration=acceleration
        )

    def correct_by_growth(self, step: FilterStep, gate: Gate) -> FilterBank:
        """The state after the growth in the images since the key frames, by the same equations."""
        growth = step.observation.growth
        if growth is None or self.key is None:
            return self
        innovation = self.key.innovation(self.motion, growth, valid=~gate.is_lost)
        motion, key, used = self.key.correct_by_growth(
            self.motion, innovation, outlier_sigma=self.settings.outlier_sigma
        )
        acceleration = self.acceleration.correct_by_growth(innovation, used)
        weight = self.models.update_probabilities(
            self.weight,
            innovation.nu,
            innovation.P_zz + innovation.R,
            valid=np.asarray(innovation.valid.all(axis=1, keepdims=True)),
        )
        return self._replace(motion=motion, weight=weight, key=key, acceleration=acceleration)

    def restart(self, step: FilterStep, gate: Gate) -> FilterBank:
        """The state where measured filters start: d = z, v = -V, and the models at their prior."""
        starts, motion, side, key = gate.starts, self.motion, self.side, self.key
        motion = replace(motion, x=np.maximum(motion.x, _MIN_DISTANCE_M))
        if not starts.any():
            return self._replace(motion=motion)
        z = step.measured.distance_m
        variance = z * z * (step.measured.independent + self.edge_variance)
        rate_mps, rate_sigma_mps = self._first_rate(step)
        motion = ConstantVelocity(
            x=np.where(starts, z, motion.x),
            v=np.where(starts, rate_mps, motion.v),
            P_xx=np.where(starts, variance, motion.P_xx),
            P_xv=np.where(starts, 0.0, motion.P_xv),
            P_vv=np.where(starts, rate_sigma_mps**2, motion.P_vv),
        )
        if side is not None:
            side = side.restart(starts)
        if key is not None:
            key = key.restart(starts)
        sigma_mps2 = self._acceleration_sigma(step)
        return self._replace(
            motion=motion,
            weight=np.where(starts, step.prior, self.weight),
            side=side,
            key=key,
            acceleration=self.acceleration.restart(starts, sigma_mps2),
        )

    def _first_rate(self, step: FilterStep) -> tuple[FloatArray, FloatArray]:
        """Rates of new tracks, and their standard deviations."""
        settings = self.settings
        if not step.ego.is_known:
            return np.array(0.0), np.array(settings.initial_rate_sigma_mps)
        rate_mps = -step.ego.speed_mps
        own_sigma_mps = settings.target_speed_sigma_mps
        if not settings.learns_noise:
            return rate_mps, np.array(own_sigma_mps)
        size_mps = np.sqrt(step.measured.systematic) * rate_mps
        return rate_mps, self.models.start_sigma_mps(step.class_id, own_sigma_mps, size_mps)

    def start_key_frames(self, step: FilterStep) -> FilterBank:
        """The state with this frame as the key frame of the tracks whose growth begins with it."""
        growth = step.observation.growth
        if growth is None or self.key is None or not growth.is_key.any():
            return self
        return self._replace(
            key=self.key.start(self.motion, growth.is_key),
            acceleration=self.acceleration.start_key(growth.is_key),
        )

    def remember(self, step: FilterStep, gate: Gate) -> FilterBank:
        """The state with what the next frame has to know of this one."""
        last, measured, starts = self.history, step.measured, gate.starts
        history = last._replace(
            systematic=np.where(measured.valid, measured.systematic, last.systematic),
            time_s=np.array(step.time_s),
            measured_s=np.where(measured.valid, step.time_s, last.measured_s),
            n_outliers=np.where(starts, 0.0, gate.n_outliers),
            steady_since_s=np.where(starts, step.time_s, last.steady_since_s),
        )
        if step.observation.cut is not None:
            history = history._replace(edge_ratio=step.observation.cut.q)
        return self._replace(history=history, ego_mps=step.ego.speed_mps)


def _fill(rows: FloatArray, parts: Sequence[FloatArray]) -> None:
    """Write the parts into the rows, repeated to their shape."""
    for row, part in zip(rows, parts, strict=True):
        row[...] = part


def _with_input(motion: ConstantVelocity, step: FilterStep) -> ConstantVelocity:
    """The state after the change dV of the ego speed: x' = x + B dV, P' = P + B B' var(dV)."""
    dt, dV, variance = step.dt, step.ego.change_mps, step.ego.change_variance
    return ConstantVelocity(
        x=motion.x - dt * dV / 2,
        v=motion.v - dV,
        P_xx=motion.P_xx + dt * dt / 4 * variance,
        P_xv=motion.P_xv + dt / 2 * variance,
        P_vv=motion.P_vv + variance,
    )
