"""Bundle adjustment of a part of a drive of one camera: poses and points of the static scene, and
the lens that all parts share.

    point: unit direction X from frame 0, inverse distance r:   q = R X + r t   R, t: from frame 0
    image: see `radial_lens`

Unknowns of a point are two tangents of X, so that points in all directions are alike, and r, which
is 0 for the sky. The scale is free: the longest t has length 1. (Triggs et al. 2000, sections 2.2
and 9; equations: `stereo.geometry.bundle_equations`.)
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import NamedTuple, Self

import cv2
import numpy as np

from track_range.foundation.arrays import BoolArray, FloatArray, IntArray
from track_range.stereo.geometry.bundle_equations import (
    Linear,
    PointBlocks,
    SharedEquations,
    cauchy_cost,
    cauchy_weights,
    cross_matrices,
    moved_poses,
    noise_px_of,
    point_blocks,
    pose_equations,
)
from track_range.stereo.self_calibration.radial_lens import LOG_FOCAL, READOUT, RadialLens

# residual of a point that the lens does not image, px: it weighs nothing
_NOT_IMAGED_PX = 50.0
_START_DAMPING, _MIN_DAMPING = 1e-5, 1e-8
_MAX_DAMPING = 1e6  # largest damping, relative to the diagonal
# prior information on the numbers of a point: only points at the focus of expansion need it
_POINT_RIDGE = np.array([1e-6, 1e-6, 1e-2])
# steps uphill in a row, and their largest cost, relative to the smallest one so far
_MAX_UPHILL, _MAX_RISE = 4, 2.0
_START_INVERSE_DISTANCE = 0.3  # of all points, in units of the path
_MIN_COMMON = 10  # points of two frames for a start of their rotation
_MAX_LOG_FOCAL_STEP = 0.3
_ACROSS = np.array([1.0, 1.0, 0.0])  # axes that a focal length stretches


class Observed(NamedTuple):
    """Tracked points in the images of one camera, at most one row per point and frame."""

    frame: IntArray  # (N,) frame numbers from 0
    point: IntArray  # (N,) point numbers from 0
    xy_px: FloatArray  # (N, 2)
    # (N, 2) pixels that a point moves until its row is read out, from the middle of the image on, per
    # second of the whole readout
    row_flow: FloatArray

    def only_points(self, is_used: BoolArray) -> "Observed":
        """The observations of the points in the mask (P,), with points renumbered."""
        rows, number = is_used[self.point], np.cumsum(is_used) - 1
        return Observed(
            self.frame[rows], number[self.point[rows]], self.xy_px[rows], self.row_flow[rows]
        )

    def median_flow_px(self, frame: int) -> FloatArray:
        """(2,) median flow to a frame from the one before; 0 with too few common points."""
        before, now = self.frame == frame - 1, self.frame == frame
        _, i, j = np.intersect1d(self.point[before], self.point[now], return_indices=True)
        if len(i) < _MIN_COMMON:
            return np.zeros(2)
        return np.asarray(np.median(self.xy_px[now][j] - self.xy_px[before][i], axis=0))


@dataclass(frozen=True, slots=True)
class SceneBundle:
    """A part of a drive of F frames and P points."""

    observed: Observed
    rotation: FloatArray  # (F, 3, 3) R, frame from frame 0
    translation: FloatArray  # (F, 3) t, the longest has length 1
    ray: FloatArray  # (P, 3) X
    inverse_distance: FloatArray  # (P,) r
    noise_px: float  # standard deviation of the tracked points
    span_s: tuple[float, float]  # times of the first and the last frame

    @classmethod
    def at_start(
        cls,
        observed: Observed,
        lens: RadialLens,
        noise_px: float,
        span_s: tuple[float, float] = (0.0, 0.0),
    ) -> Self:
        """A drive with a constant speed along the axis past equally distant points, turned as the
        median flow turns.
        """
        n_frames, n_points = int(observed.frame.max()) + 1, int(observed.point.max()) + 1
        rotation = np.tile(np.eye(3), (n_frames, 1, 1))
        position, translation = np.zeros(3), np.zeros((n_frames, 3))
        for frame in range(1, n_frames):
            dx, dy = observed.median_flow_px(frame) / lens.focal_px
            rotation[frame] = cv2.Rodrigues(np.array([-dy, dx, 0.0]))[0] @ rotation[frame - 1]
            position = position + rotation[frame][2] / (n_frames - 1)
            translation[frame] = -rotation[frame] @ position
        order = np.lexsort((observed.frame, observed.point))
        first = order[np.searchsorted(observed.point[order], np.arange(n_points))]
        seen = lens.directions(observed.xy_px[first])
        ray = np.einsum("nji,nj->ni", rotation[observed.frame[first]], seen)
        inverse_distance = np.full(n_points, _START_INVERSE_DISTANCE)
        return cls(observed, rotation, translation, ray, inverse_distance, noise_px, span_s)

    @property
    def turn_deg(self) -> float:
        """Angle between the first and the last image about the vertical, positive to the right."""
        forward = self.rotation[-1][2]  # axis of the last camera in the first one's frame
        return float(np.degrees(np.arctan2(forward[0], forward[2])))

    def only_points(self, is_used: BoolArray) -> Self:
        """The scene with the points in the mask (P,)."""
        return replace(
            self,
            observed=self.observed.only_points(is_used),
            ray=self.ray[is_used],
            inverse_distance=self.inverse_distance[is_used],
        )

    def linearize(self, lens: RadialLens) -> Linear:
        """Residuals and derivatives by the poses, the points' tangents and inverse distances, and
        the lens.

        The scene moves with the focal length, see `stretched`.
        """
        frame, point, xy_px, row_flow = self.observed
        r, translation = self.inverse_distance[point, None], self.translation[frame]
        turned = self._turned()
        q = turned[:, :, 0] + r * translation
        expected_px, by_q, by_lens = lens.project(q)
        # one product with all directions in which q moves
        directions = np.empty((len(frame), 3, 7))
        directions[:, :, :3] = cross_matrices(-turned[:, :, 0])
        directions[:, :, 3:5] = turned[:, :, 1:3]
        directions[:, :, 5] = translation
        directions[:, :, 6] = -turned[:, :, 3] - r * translation * _ACROSS
        slopes = by_q @ directions
        by_pose = np.concatenate([slopes[:, :, :3], by_q * r[:, :, None]], axis=2)
        by_point = slopes[:, :, 3:6]
        flat_turn = _turn_vectors(self.rotation) * _ACROSS
        by_lens[:, :, LOG_FOCAL] += slopes[:, :, 6]
        by_lens[:, :, LOG_FOCAL] -= np.einsum("nmi,ni->nm", slopes[:, :, :3], flat_turn[frame])
        residual = xy_px - expected_px - lens.parameters[READOUT] * row_flow
        by_lens[:, :, READOUT] = row_flow
        is_lost = ~np.isfinite(residual).all(axis=1)
        residual[is_lost] = _NOT_IMAGED_PX
        for slope in (by_pose, by_point, by_lens):
            slope[is_lost] = 0.0
        return Linear(residual, by_pose, by_point, by_lens)

    def _turned(self) -> FloatArray:
        """(N, 3, 4) rays, their two tangents, and the rays without their part along the first axis,
        in the frames that see them.
        """
        columns = np.concatenate(
            [self.ray[:, :, None], self.tangents(), (self.ray * _ACROSS)[:, :, None]], axis=2
        )
        # products of all frames and points are one matrix product, cheaper than those observed
        turned = np.tensordot(columns, self.rotation, axes=(1, 2))  # (P, 4, F, 3)
        frame, point, *_ = self.observed
        return np.asarray(turned[point, :, frame].transpose(0, 2, 1))

    def stretched(self, log_ratio: float) -> Self:
        """The scene that looks about the same with a focal length exp(`log_ratio`) times as large.

        Everything is narrower across the first axis, and the camera turns less: exact for a drive
        without turns, so that these bundles lie on the valley of the cost.
        """
        narrow = 1.0 - _ACROSS * (1.0 - np.exp(-log_ratio))
        turns = _turn_vectors(self.rotation)
        rotation = np.stack([cv2.Rodrigues(narrow * turn)[0] for turn in turns])
        ray = self.ray * narrow
        length = np.linalg.norm(ray, axis=1)
        return replace(
            self,
            rotation=rotation,
            translation=self.translation * narrow,
            ray=ray / length[:, None],
            inverse_distance=self.inverse_distance / length,
        )

    def tangents(self) -> FloatArray:
        """(P, 3, 2) two unit vectors across each ray (Duff et al. 2017, "Building an orthonormal
        basis, revisited").
        """
        x, y, z = self.ray.T
        sign = np.where(z < 0.0, -1.0, 1.0)
        a = -1.0 / (sign + z)
        first = np.stack([1.0 + sign * x**2 * a, sign * x * y * a, -sign * x], axis=1)
        return np.stack([first, np.stack([x * y * a, sign + y**2 * a, -y], axis=1)], axis=2)

    def moved(self, step: FloatArray, points: FloatArray) -> Self:
        """The scene after steps of the poses (6 F - 6,) and of the points (P, 3)."""
        rotation, translation = moved_poses(self.rotation, self.translation, step)
        ray = self.ray + (self.tangents() @ points[:, :2, None])[:, :, 0]
        ray /= np.linalg.norm(ray, axis=1, keepdims=True)
        inverse_distance = self.inverse_distance + points[:, 2]
        path = max(float(np.linalg.norm(translation, axis=1).max()), 1e-9)
        return replace(
            self,
            rotation=rotation,
            translation=translation / path,
            ray=ray,
            inverse_distance=inverse_distance * path,
        )

    def largest_error_px(self, lens: RadialLens) -> FloatArray:
        """(P,) largest residual of each point."""
        error_px = np.linalg.norm(self.linearize(lens).residual, axis=1)
        largest_px = np.zeros(len(self.ray))
        np.maximum.at(largest_px, self.observed.point, error_px)
        return largest_px

    def with_noise(self, lens: RadialLens) -> Self:
        """The scene with the noise of its residuals."""
        return replace(self, noise_px=noise_px_of(self.linearize(lens).residual))


def _turn_vectors(rotation: FloatArray) -> FloatArray:
    """(F, 3) rotation vectors of rotations (F, 3, 3)."""
    return np.stack([cv2.Rodrigues(one)[0][:, 0] for one in rotation])


class LensPrior(NamedTuple):
    """Independent normal distributions of the parameters of a lens; sigma 0 keeps a parameter."""

    mean: FloatArray  # (6,)
    sigma: FloatArray  # (6,)
    # limits of the logarithm of the focal length
    log_focal_range: tuple[float, float] = (-np.inf, np.inf)

    @property
    def is_free(self) -> BoolArray:
        """(6,) parameters that are estimated."""
        return np.asarray(self.sigma > 0.0)

    @property
    def information(self) -> FloatArray:
        """(6,) 1 / sigma^2; 0 for parameters that are kept."""
        return np.asarray(
            np.where(self.is_free, 1 / np.where(self.is_free, self.sigma, 1.0) ** 2, 0)
        )

    def cost(self, lens: RadialLens) -> float:
        """Sum of the squared deviations in sigmas."""
        return float((self.information * (lens.parameters - self.mean) ** 2).sum())


class SceneFit(NamedTuple):
    """The scenes and the lens with the smallest cost, which is -2 log likelihood + constant."""

    scenes: tuple[SceneBundle, ...]
    lens: RadialLens
    cost: float


def fit_scenes(
    scenes: Sequence[SceneBundle],
    lens: RadialLens,
    prior: LensPrior,
    *,
    cauchy_sigmas: float,
    max_steps: int = 60,
    min_gain: float = 0.02,
) -> SceneFit:
    """The minimum robust cost over all poses, points and the free parameters of the lens.

    Levenberg-Marquardt, in which one step may go uphill if the next one ends below its start: the
    valley of the focal length is curved (Chamberlain et al. 1982, "The watchdog technique").
    `cauchy_sigmas` is the length of a residual, in standard deviations, that has half the weight,
    and `min_gain` the decrease of the cost at which the iteration ends.
    """

    def stated(scenes: tuple[SceneBundle, ...], lens: RadialLens) -> _State:
        linear = [scene.linearize(lens) for scene in scenes]
        return _State(scenes, lens, linear, _cost(scenes, linear, cauchy_sigmas) + prior.cost(lens))

    now = best = stated(tuple(scenes), lens)
    damping, n_uphill = _START_DAMPING, 0
    for _ in range(max_steps):
        trial = stated(*_step(now, prior, cauchy_sigmas, damping))
        if trial.cost <= best.cost:  # False for NaN too
            gain = best.cost - trial.cost
            now = best = trial
            if gain < min_gain:
                break
            damping = damping if n_uphill else max(damping / 6.0, _MIN_DAMPING)
            n_uphill = 0
        elif n_uphill < _MAX_UPHILL and trial.cost < _MAX_RISE * best.cost:
            now, n_uphill = trial, n_uphill + 1
        else:
            now, n_uphill = best, 0
            damping *= 6.0
            if damping > _MAX_DAMPING:
                break
    return SceneFit(best.scenes, best.lens, best.cost)


class _State(NamedTuple):
    """Scenes and lens, their residuals and derivatives, and their cost."""

    scenes: tuple[SceneBundle, ...]
    lens: RadialLens
    linear: list[Linear]
    cost: float


def _cost(scenes: Sequence[SceneBundle], linear: Sequence[Linear], cauchy_sigmas: float) -> float:
    return sum(
        cauchy_cost(part.residual, cauchy_sigmas * scene.noise_px, scene.noise_px)
        for scene, part in zip(scenes, linear, strict=True)
    )


def _step(
    state: _State, prior: LensPrior, cauchy_sigmas: float, damping: float
) -> tuple[tuple[SceneBundle, ...], RadialLens]:
    """Scenes and lens after a damped Gauss-Newton step."""
    scenes, lens, linear, _ = state
    parts = [
        shared_equations(scene, part, cauchy_sigmas, damping)
        for scene, part in zip(scenes, linear, strict=True)
    ]
    information = np.sum([shared.information for shared, *_ in parts], axis=0)
    right_side = np.sum([shared.right_side for shared, *_ in parts], axis=0)
    right_side = right_side - prior.information * (lens.parameters - prior.mean)
    damped = information + np.diag(prior.information + damping * np.diag(information))
    step = _limited_step(damped, right_side, lens, prior)
    moved = []
    for scene, (shared, blocks, _) in zip(scenes, parts, strict=True):
        x = shared.unknowns(step)
        stretched = scene.stretched(float(step[LOG_FOCAL]))
        moved.append(stretched.moved(x[: len(shared.poses)], blocks.points(x)))
    return tuple(moved), lens.moved(step)


def _limited_step(
    information: FloatArray, right_side: FloatArray, lens: RadialLens, prior: LensPrior
) -> FloatArray:
    """(6,) step of the free parameters; of the focal length a limited one, then of the others with
    it.
    """
    step, free = np.zeros(len(right_side)), np.flatnonzero(prior.is_free)
    step[free] = np.linalg.solve(information[np.ix_(free, free)], right_side[free])
    log_focal = float(lens.parameters[LOG_FOCAL])
    low, high = np.array(prior.log_focal_range) - log_focal
    wanted = float(step[LOG_FOCAL])
    step[LOG_FOCAL] = np.clip(
        wanted, max(low, -_MAX_LOG_FOCAL_STEP), min(high, _MAX_LOG_FOCAL_STEP)
    )
    if step[LOG_FOCAL] != wanted:
        others = free[free != LOG_FOCAL]
        rest = right_side[others] - information[others, LOG_FOCAL] * step[LOG_FOCAL]
        step[others] = np.linalg.solve(information[np.ix_(others, others)], rest)
    return step


def shared_equations(
    scene: SceneBundle, linear: Linear, cauchy_sigmas: float, damping: float
) -> tuple[SharedEquations, PointBlocks, FloatArray]:
    """The equations of the lens from a scene, its points, and the (N,) inverse variances of the
    observations.
    """
    weight = cauchy_weights(linear.residual, cauchy_sigmas * scene.noise_px) / scene.noise_px**2
    frame, point, *_ = scene.observed
    n_frames = len(scene.rotation)
    blocks = point_blocks(
        frame,
        point,
        linear,
        weight,
        n_frames=n_frames,
        damping=damping,
        ridge=_POINT_RIDGE,
    )
    poses = pose_equations(frame, linear, weight, n_frames=n_frames)
    return poses.damped(damping).without(blocks).of_shared(), blocks, weight
