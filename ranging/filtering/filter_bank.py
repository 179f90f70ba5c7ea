"""FilterBank: Kalman filters of the distances of N tracks by M methods with G models of the motion,
and the steps of a filter.

    states   x = [d v a r]'  (4)     `TargetStates`

                 F, Q                (4, 4)      steps of time
                 B = [-dt/2 -1 0 0]' (4)         input: dV, change of the ego speed
                 Q + B B' var(dV) + [drift dt]   (4, 4)
                 H = [1/d 0 0 0]     (4)         z = log d
                 R = lambda (s sigma / d)^2

    side     [d v k]'        (3)     heading parameter k of a box that the image border cuts (`cut_boxes`)
    growth   H = [-1/d 0 0 1/r]      of the object in the images (`key_distance`)

The matrices are of one filter; arrays are over all filters, (M, G, N) each. No filter has k and r
at the same time: boxes that are cut have no key frame.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cache
from typing import NamedTuple

import numpy as np

from track_range.detection.classes import ROAD_CLASSES
from track_range.foundation.arrays import BoolArray, FloatArray, IntArray
from track_range.foundation.constant_velocity import ConstantVelocity
from track_range.ranging.filtering.cut_boxes import CutBoxes, SideState
from track_range.ranging.filtering.key_distance import correct_by_growth, innovation
from track_range.ranging.filtering.motion_models import STATIC_SIGMA_MPS, InteractingModels
from track_range.ranging.filtering.observation import FilterStep
from track_range.ranging.filtering.target_states import N_STATES, TargetStates

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
    # the same of a time to collision whose rate has a larger one, relative to it
    max_ttc_sigma: float = 0.5
    # time after a start or change of condition with a NaN rate, against false alarms
    min_steady_s: float = 0.35


class History(NamedTuple):
    """What the filters of M methods keep of the last frames, the same for all models, (M, 1, N)
    each.
    """

    systematic: FloatArray  # systematic variance of log d at the last measurement; NaN = none
    measured_s: FloatArray  # time of the last measurement; NaN = none
    n_outliers: FloatArray  # consecutive ones
    condition: FloatArray  # of the last measurement
    steady_since_s: FloatArray  # time of the start or of the last change of condition
    is_hidden: FloatArray  # of the last measurement; 1 = True


class LastFrame(NamedTuple):
    """What the filters keep of the last frame of each track, (N,) each."""

    time_s: FloatArray  # NaN = new track
    edge_ratio: FloatArray  # q of the box (`CutBoxes`)
    was_cut: FloatArray  # 1 = the border cut the box


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


_FIRST = (np.nan, np.nan, 0.0, 0.0, np.nan, 0.0), (np.nan, 0.0, 0.0)
"""`History` and `LastFrame` of a new track."""


class FilterBank:
    """Filters of M methods, G models and N tracks: their state, in arrays (M, G, N), and its steps,
    which change it in place.

    The state is one array `rows` (R, N) for `TrackState`, of which all others are views. Its rows
    are, in this order and raveled: `states` (4, 5, M, G, N), `weight` and `ego_mps` (M, G, N),
    `side` (4, M, G, N), `history` (6, M, 1, N), `last` (3, N).
    """

    def __init__(
        self, models: InteractingModels, settings: FilterSettings, rows: FloatArray
    ) -> None:
        """The filters with this state, which is not copied."""
        self.models, self.settings, self.rows = models, settings, rows
        M, G, N = models.n_methods, models.n_models, rows.shape[-1]
        ends = _row_ends(M, G)
        self.states = TargetStates(rows[: ends[0]].reshape(N_STATES, N_STATES + 1, M, G, N))
        # probabilities of the models, 0 = new track; V of the last frame, see `EgoStep`, NaN =
        # unknown
        self.weight, self.ego_mps = rows[ends[0] : ends[1]].reshape(2, M, G, N)
        self._side_rows = rows[ends[1] : ends[2]].reshape(len(SideState._fields), M, G, N)
        self.side = SideState(*self._side_rows)
        self.history = History(*rows[ends[2] : ends[3]].reshape(len(History._fields), M, 1, N))
        self.last = LastFrame(*rows[ends[3] :])
        # relative variance of d by the noise of the free edges of this frame's boxes
        self.edge_variance: FloatArray | float = 0.0

    @classmethod
    def new(cls, models: InteractingModels, settings: FilterSettings) -> FilterBank:
        """Filters of one track without a measurement."""
        n_rows = _row_ends(models.n_methods, models.n_models)[-1]
        bank = cls(models, settings, np.zeros((n_rows, 1)))
        bank.states.x[[0, 1, 3]] = np.nan
        bank.ego_mps[...] = np.nan
        for parts, first in zip((bank.history, bank.last), _FIRST, strict=True):
            for part, value in zip(parts, first, strict=True):
                part[...] = value
        return bank

    def of_tracks(self, rows: FloatArray) -> FilterBank:
        """Filters with the state `rows` of other tracks."""
        return FilterBank(self.models, self.settings, rows)

    def measured_s(self, rows: FloatArray) -> FloatArray:
        """(M, N) times of the last measurements in the state `rows` of other tracks."""
        M, G = self.models.n_methods, self.models.n_models
        start = _row_ends(M, G)[2] + M * History._fields.index("measured_s")
        return rows[start : start + M]

    def slides(self, cut: CutBoxes | None) -> BoolArray:
        """(N,) whether the box is cut, or was in the previous frame."""
        was_cut = self.last.was_cut > 0
        return was_cut if cut is None else was_cut | cut.is_cut

    def predict(self, step: FilterStep) -> None:
        """The state at the time of this frame: x' = F x + B dV, P' = F P F' + Q.

        Filters without a recent measurement, and of tracks that have passed the camera, become NaN.
        """
        states, dt = self.states, step.dt
        drift = self._systematic_drift(step) if self.settings.learns_noise else 0.0
        q, sigma_mps2 = self.models.q[:, step.class_id], self._acceleration_sigma(step)
        tracks = step.slides.nonzero()[0]
        of_slide = self._slide(step, tracks, q) if len(tracks) else None
        states.predict(dt, q=q, sigma_mps2=sigma_mps2)
        if of_slide is not None:
            states.add_motion(of_slide, tracks)
            states.forget_key(step.slides)
        if step.ego.is_known:
            states.add_input(dt, step.ego.change_mps, step.ego.change_variance)
        states.P_dd[...] += dt * drift
        has_gap = step.time_s - self.history.measured_s > self.settings.max_gap_s
        has_passed = (states.d < _MIN_DISTANCE_M).any(axis=1, keepdims=True)
        states.forget_distance(has_gap | has_passed)

    def _slide(self, step: FilterStep, tracks: IntArray, q: FloatArray) -> ConstantVelocity | None:
        """What the predictions of cut boxes differ by from those of other boxes, since along them,
        it is the far end that moves.
        """
        cut = step.observation.cut
        if cut is None:
            return None
        dt, noise = step.dt[tracks], q[:, tracks]
        motion = self.states.motion_of(tracks)
        side = SideState(*self._side_rows[..., tracks])
        moved, side, variance = side.predict(
            motion, self.last.edge_ratio[tracks], cut.of_tracks(tracks), dt, noise=noise
        )
        self._side_rows[..., tracks] = side
        self.edge_variance = np.zeros(self.weight.shape)
        self.edge_variance[..., tracks] = variance
        plain = motion.predict(dt, q=noise)
        pairs = zip(moved.columns, plain.columns, strict=True)
        return ConstantVelocity(*(one - other for one, other in pairs))

    def resize(self, step: FilterStep) -> None:
        """The state in the scale of this frame's believed sizes."""
        if step.resized is not None:
            self.states.scale(step.resized)

    def _acceleration_sigma(self, step: FilterStep) -> FloatArray:
        """(G, N) sigma_a in m/s^2."""
        return self.models.acceleration_sigma(step.class_id, is_ego_known=step.ego.is_known)

    def _systematic_drift(self, step: FilterStep) -> FloatArray:
        """Variance of d in m^2 per second by the changing systematic error; 0 for new tracks."""
        d, v = self.states.d, self.states.v
        per_s = _LONG_DRIFT_HZ * _IS_LONG[step.class_id] + _TURN_DRIFT * step.turn_rad_s
        if step.across_mps:
            per_s = per_s + _TURN_DRIFT * step.across_mps / d
        changing = np.abs(d * v) * _DRIFT + d * d * per_s
        variance = np.minimum(self.history.systematic, _MAX_DRIFTING**2)
        return np.asarray(np.fmax(variance * changing, 0.0))

    def interact(self, step: FilterStep) -> None:
        """The models after objects may have changed theirs (step 1 of `InteractingModels`).

        It follows the prediction, whose rates show where a static model follows a moving object: it
        is no longer static, and no object changes to it.
        """
        models, before = self.models, self.weight
        if not step.ego.is_known:
            self.weight[...] = models.interact(before, step.prior, step.dt)
            return
        V = step.ego.speed_mps
        by_size = np.fmax(self.history.systematic, 0.0) * V * V
        static_variance = by_size + STATIC_SIGMA_MPS**2
        largest = self.settings.outlier_sigma**2 * (static_variance + step.ego.sigma_mps**2)
        own_mps = self.states.v + V
        is_moving = own_mps * own_mps > largest  # False for NaN
        possible = step.prior.copy()
        possible[:, 0] *= ~is_moving[:, 0]
        weight = models.interact(before, possible, step.dt)
        joins = np.isnan(self.ego_mps)
        if self.settings.learns_noise and joins.any():
            weight = np.where(joins & (before[:, :1] == 0), step.prior, weight)
            self._join_static(joins & models.is_static, V, static_variance)
        self.weight[...] = weight

    def _join_static(self, joins: BoolArray, V: FloatArray, variance: FloatArray) -> None:
        """The state where static models start, since the ego speed is known from now on: v = -V."""
        P = self.states.P
        np.copyto(self.states.v, -V, where=joins)
        for i, j in ((0, 1), (1, 0), (1, 3), (3, 1)):
            np.copyto(P[i, j], 0.0, where=joins)
        np.copyto(P[1, 1], variance, where=joins)

    def step_of_condition(self, step: FilterStep) -> None:
        """The state where the condition of a measurement changes, or a nearer box begins or ceases
        to hide a side.

        The distance may step by the old and the new systematic error together, which is no motion:
        P_dd' = P_dd + d^2 (s_old^2 + s_new^2).
        """
        last, measured, d = self.history, step.measured, self.states.d
        is_given = measured.valid & np.isfinite(step.condition)
        is_changed = is_given & (step.condition != last.condition) & np.isfinite(d[:, :1])
        may_step = is_changed | (measured.valid & (step.is_hidden != last.is_hidden))
        np.copyto(last.condition, step.condition, where=is_given)
        np.copyto(last.is_hidden, step.is_hidden, where=measured.valid)
        if not may_step.any():
            return
        np.copyto(last.steady_since_s, step.time_s, where=is_changed)
        variance = d * d * (last.systematic + measured.systematic)
        self.states.step(np.where(may_step & np.isfinite(d), variance, 0.0))

    def gate(self, step: FilterStep) -> Gate:
        """Innovations of the distances, nu = d (log z - log d), and which filters they correct."""
        measured, d = step.measured, self.states.d
        nu = d * np.log(measured.distance_m / d)
        R = d * d * (measured.independent + self.edge_variance)
        limit = self.settings.outlier_sigma * np.sqrt(self.states.P_dd + R)
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

    def correct_by_distance(self, gate: Gate) -> None:
        """The state after the distances: K = P H' / S, x' = x + K nu, P' = P - K S K'.

        R of distances beyond the gate is larger, so that they count as little as at its limit
        (Huber). S is infinite without a distance, so that K = 0.
        """
        known, excess = gate.known, np.maximum(1.0, gate.excess)
        S = np.where(known, self.states.P_dd + gate.R * (excess * excess), np.inf)
        nu = np.where(known, gate.nu, 0.0)
        self.weight[...] = self.models.update_probabilities(self.weight, nu, S, valid=known)
        if self.side.P_kk.any():  # boxes are cut
            corrected = self.side.correct(self.states.motion, nu, S)
            for part, new in zip(self.side, corrected, strict=True):
                part[...] = new
        self.states.correct_by_distance(nu, 1.0 / S)

    def correct_by_growth(self, step: FilterStep, gate: Gate) -> None:
        """The state after the growth in the images since the key frames, by the same equations."""
        growth = step.observation.growth
        if growth is None:
            return
        shown = innovation(self.states, growth, valid=~gate.is_lost)
        if not shown.valid.any():
            return
        is_valid = np.asarray(shown.valid.all(axis=1, keepdims=True))
        self.weight[...] = self.models.update_probabilities(
            self.weight, shown.nu, shown.P_zz + shown.R, valid=is_valid
        )
        correct_by_growth(self.states, shown, outlier_sigma=self.settings.outlier_sigma)

    def restart(self, step: FilterStep, gate: Gate) -> None:
        """The state where measured filters start: d = z, v = -V, and the models at their prior."""
        starts, states = gate.starts, self.states
        np.maximum(states.d, _MIN_DISTANCE_M, out=states.d)
        if not starts.any():
            return
        z, zero = step.measured.distance_m, np.array(0.0)
        variance = z * z * (step.measured.independent + self.edge_variance)
        rate_mps, rate_sigma_mps = self._first_rate(step)
        first = ConstantVelocity(z, rate_mps, variance, zero, rate_sigma_mps**2)
        states.start(starts, first, self._acceleration_sigma(step) ** 2)
        np.copyto(self.weight, step.prior, where=starts)
        for part in (self.side.P_dk, self.side.P_vk):
            np.copyto(part, 0.0, where=starts)

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

    def start_key_frames(self, step: FilterStep) -> None:
        """The state with this frame as the key frame of the tracks whose growth begins with it."""
        growth = step.observation.growth
        if growth is not None and growth.is_key.any():
            self.states.start_key(growth.is_key)

    def remember(self, step: FilterStep, gate: Gate) -> None:
        """The state with what the next frame has to know of this one."""
        history, measured, cut = self.history, step.measured, step.observation.cut
        np.copyto(history.systematic, measured.systematic, where=measured.valid)
        np.copyto(history.measured_s, step.time_s, where=measured.valid)
        history.n_outliers[...] = gate.n_outliers * ~gate.starts
        np.copyto(history.steady_since_s, step.time_s, where=gate.starts)
        self.last.time_s[...] = step.time_s
        if cut is not None:
            self.last.edge_ratio[...] = cut.q
            self.last.was_cut[...] = cut.is_cut
        self.ego_mps[...] = step.ego.speed_mps


@cache
def _row_ends(M: int, G: int) -> tuple[int, int, int, int, int]:
    """Ends of the rows of `states`, `weight` and `ego_mps`, `side`, `history` and `last`."""
    n = M * G
    states = N_STATES * (N_STATES + 1) * n
    models = states + 2 * n
    side = models + len(SideState._fields) * n
    history = side + len(History._fields) * M
    return states, models, side, history, history + len(LastFrame._fields)
