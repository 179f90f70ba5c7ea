"""A bundle over a stretch of a drive: poses, points and the disparity error of the rig, all free, from tracked points.

    point on frame 0's ray (a, b, 1), inverse depth r:    q = R (a, b, 1) + r t         R, t = frame f from frame 0
    left eye   x = f q_x / q_z + cx,  y = f q_y / q_z + cy
    right eye  x - f B r / q_z + offset + bow u^2         u = the left column from the axis, see `stereo.alignment`

Motion alone gives depths up to scale, disparity alone up to the error; where near and far points are seen from several
places, the error is the intercept of one against the other. Points held fixed at their triangulated places would carry
their noise into it as a bias, so points are unknowns too. Gauss-Newton with the points eliminated (Triggs et al. 2000,
"Bundle adjustment: a modern synthesis", section 6) with Cauchy weights, under which moving objects and bad tracks lose.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import NamedTuple

import cv2
import numpy as np
from scipy import sparse

from track_range.foundation.arrays import FloatArray, IntArray
from track_range.stereo.geometry.rig import StereoRig

N_ERRORS = 2
"""Offset and bow."""

_MAX_STEPS = 25
_MAX_DAMPING = 1e6
_ENOUGH = 1e-5
"""Relative gain of cost below which further steps change nothing that matters."""

_CAUCHY_SIGMAS = 2.0
_NOISE_PX = (0.05, 1.0)
"""Plausible noise of a tracked point: within it, it is taken from the residuals."""

_MEDIAN_NORM = 1.538
"""Median length of a vector of three standard normal numbers."""

_POSE_RIDGE = 1e-6
"""Nothing beside what the points say of a pose (1e5 per m^2, 1e8 per rad^2); keeps a frame without points solvable."""

_ERROR_PRIOR_PX = 5.0
"""Standard deviation of an error before anything is seen: wide, it only keeps the equations solvable."""


class Sightings(NamedTuple):
    """Points as both eyes saw them, one row per point and frame, no pair twice.

    Attributes:
        frame: (N,) from 0.
        point: (N,) from 0.
        xyx_px: (N, 3) x and y in the left image, x in the right one.
    """

    frame: IntArray
    point: IntArray
    xyx_px: FloatArray


@dataclass(frozen=True, slots=True)
class Bundle:
    """Unknowns of a stretch of F frames and P points.

    Attributes:
        rotation: (F, 3, 3), frame from frame 0.
        translation_m: (F, 3).
        points: (P, 3) a, b and r (1/m): ray and inverse depth in frame 0.
        error_px: (2,) offset and bow.
    """

    rotation: FloatArray
    translation_m: FloatArray
    points: FloatArray
    error_px: FloatArray

    @property
    def path_m(self) -> float:
        """Distance between the first place of the left eye and the one farthest from it."""
        places = np.einsum("fji,fj->fi", self.rotation, self.translation_m)
        return float(np.linalg.norm(places - places[0], axis=1).max())


class Fit(NamedTuple):
    """A bundle at its best, the noise of its points, and the (N,) weight, 0..1, of each sighting."""

    bundle: Bundle
    noise_px: float
    weight: FloatArray


class Linear(NamedTuple):
    """Residuals (N, 3) in px, and expected's derivatives by pose (N, 3, 6), point (N, 3, 3) and errors (N, 3, E)."""

    residual: FloatArray
    by_pose: FloatArray
    by_point: FloatArray
    by_error: FloatArray


class Equations(NamedTuple):
    """Normal equations with the points eliminated: poses of all frames but the first, then the errors.

    Those of disjoint sets of points add up.
    """

    matrix: FloatArray
    rhs: FloatArray
    n_pose_unknowns: int

    def of_errors(self) -> tuple[FloatArray, FloatArray]:
        """(E, E) information on the errors and (E,) right side, with the poses eliminated too."""
        n = self.n_pose_unknowns
        across = self.matrix[n:, :n]
        poses = self.matrix[:n, :n] + _POSE_RIDGE * np.eye(n)
        solved = np.linalg.solve(poses, np.column_stack([across.T, self.rhs[:n]]))
        return self.matrix[n:, n:] - across @ solved[:, :-1], self.rhs[n:] - across @ solved[:, -1]


class _Step(NamedTuple):
    """Normal equations, and what brings the eliminated points back: V^-1 (P, 3, 3), W (3 P, C) and their right side."""

    equations: Equations
    point_inverse: FloatArray
    point_across: FloatArray
    point_rhs: FloatArray


def fit_bundle(seen: Sightings, start: Bundle, rig: StereoRig) -> Fit:
    """The most likely bundle, from a start within some pixels of it; `rig` is the rectified one."""
    bundle, damping = start, 1e-4
    linear = linearised(seen, bundle, rig)
    for _ in range(_MAX_STEPS):
        noise_px = _noise_px(linear.residual)
        cost = _cost(linear.residual, noise_px)
        weight = _cauchy(linear.residual, noise_px) / noise_px**2
        while damping < _MAX_DAMPING:
            trial = _stepped(bundle, _eliminated(seen, linear, weight, len(bundle.rotation), damping))
            trial_linear = linearised(seen, trial, rig)
            trial_cost = _cost(trial_linear.residual, noise_px)
            if trial_cost <= cost:  # False for NaN too
                break
            damping *= 6.0
        else:
            break
        bundle, linear, damping = trial, trial_linear, max(damping / 5.0, 1e-9)
        if cost - trial_cost < _ENOUGH * cost:
            break
    noise_px = _noise_px(linear.residual)
    return Fit(bundle, noise_px, _cauchy(linear.residual, noise_px))


def equations_of(seen: Sightings, linear: Linear, weight: FloatArray, *, n_frames: int) -> Equations:
    """Normal equations of sightings with inverse variances `weight` (N,); no prior in them."""
    return _eliminated(seen, linear, weight, n_frames, 0.0).equations


def linearised(seen: Sightings, bundle: Bundle, rig: StereoRig, *, extra: FloatArray | None = None) -> Linear:
    """Residuals and derivatives at a bundle; `extra` (N, E) are columns of further errors of the right x."""
    camera, bf = rig.left, rig.left.fx_px * rig.baseline_m
    turn, shift, point = bundle.rotation[seen.frame], bundle.translation_m[seen.frame], bundle.points[seen.point]
    turned = turn[:, :, 0] * point[:, :1] + turn[:, :, 1] * point[:, 1:2] + turn[:, :, 2]
    place = turned + point[:, 2:] * shift
    inverse_z = 1.0 / place[:, 2]
    x, y = place[:, 0] * inverse_z, place[:, 1] * inverse_z
    disparity_px = bf * point[:, 2] * inverse_z
    left_x = camera.fx_px * x + camera.cx_px
    u_per_px = 2 / camera.width_px
    u = x * camera.fx_px * u_per_px
    columns = error_columns(u)
    stretch = 1 + 2 * bundle.error_px[1] * u * u_per_px  # the bow moves right points apart
    right_x = left_x - disparity_px + columns @ bundle.error_px
    expected = np.stack([left_x, camera.fy_px * y + camera.cy_px, right_x], axis=1)
    by_place = np.zeros((len(x), 3, 3))
    by_place[:, 0, 0] = camera.fx_px * inverse_z
    by_place[:, 0, 2] = -camera.fx_px * x * inverse_z
    by_place[:, 1, 1], by_place[:, 1, 2] = camera.fy_px * inverse_z, -camera.fy_px * y * inverse_z
    by_place[:, 2] = by_place[:, 0] * stretch[:, None]
    by_place[:, 2, 2] += disparity_px * inverse_z
    by_pose = np.concatenate([-by_place @ _cross(turned), by_place * point[:, 2, None, None]], axis=2)
    by_point = by_place @ np.concatenate([turn[:, :, :2], shift[:, :, None]], axis=2)
    by_point[:, 2, 2] -= bf * inverse_z
    all_columns = columns if extra is None else np.concatenate([columns, extra], axis=1)
    by_error = np.zeros((len(x), 3, all_columns.shape[1]))
    by_error[:, 2] = all_columns
    return Linear(seen.xyx_px - expected, by_pose, by_point, by_error)


def error_columns(u: FloatArray) -> FloatArray:
    """(N, 2) what a unit of offset and of bow add to the right x at the columns `u` (N,) from the axis."""
    return np.stack([np.ones_like(u), u**2], axis=1)


def _eliminated(seen: Sightings, linear: Linear, weight: FloatArray, n_frames: int, damping: float) -> _Step:
    """The equations of poses and errors, and what brings the points back; the first frame's pose is held."""
    n_points, n_poses, n_errors = int(seen.point.max()) + 1, 6 * n_frames, linear.by_error.shape[2]
    errors = np.broadcast_to(n_poses + np.arange(n_errors), (len(seen.frame), n_errors))
    columns = np.concatenate([6 * seen.frame[:, None] + np.arange(6), errors], axis=1)
    by_rest = _sparse(np.concatenate([linear.by_pose, linear.by_error], axis=2), columns, n_poses + n_errors)
    by_point = _sparse(linear.by_point, 3 * seen.point[:, None] + np.arange(3), 3 * n_points)
    row_weight = np.repeat(weight, 3)
    weighted_rest, weighted_point = (sparse.diags_array(row_weight) @ part for part in (by_rest, by_point))
    residual = linear.residual.reshape(-1)

    matrix = (by_rest.T @ weighted_rest).toarray()[6:, 6:]
    across = (by_point.T @ weighted_rest).toarray()[:, 6:]
    points = np.zeros((n_points, 3, 3))
    np.add.at(points, seen.point, np.einsum("nki,nkj->nij", linear.by_point * weight[:, None, None], linear.by_point))
    points += (damping * np.einsum("pii->pi", points) + 1e-9)[:, :, None] * np.eye(3)
    inverse = np.asarray(np.linalg.inv(points), np.float64)
    solved = (inverse @ across.reshape(n_points, 3, -1)).reshape(across.shape)
    point_rhs = weighted_point.T @ residual
    reduced = matrix + damping * np.diag(np.diag(matrix)) - across.T @ solved
    rhs = (weighted_rest.T @ residual)[6:] - solved.T @ point_rhs
    return _Step(Equations(reduced, rhs, n_poses - 6), inverse, across, point_rhs)


def _sparse(blocks: FloatArray, columns: IntArray, n_columns: int) -> sparse.csr_array:
    """Blocks (N, 3, K) that stand in the columns (N, K) -> (3 N, n_columns)."""
    n, n_rows, width = blocks.shape
    starts = np.arange(n * n_rows + 1) * width
    return sparse.csr_array(
        (blocks.reshape(-1), np.repeat(columns, n_rows, axis=0).reshape(-1), starts), (n * n_rows, n_columns)
    )


def _stepped(bundle: Bundle, step: _Step) -> Bundle:
    """The bundle after a step of Gauss and Newton."""
    equations, n = step.equations, step.equations.n_pose_unknowns
    prior = np.zeros(len(equations.rhs))
    prior[n:] = _ERROR_PRIOR_PX**-2
    towards = equations.rhs.copy()
    towards[n:] -= bundle.error_px * prior[n:]
    rest = np.linalg.solve(equations.matrix + np.diag(prior), towards)
    points = (step.point_rhs - step.point_across @ rest).reshape(-1, 3, 1)
    poses = np.concatenate([np.zeros((1, 6)), rest[:n].reshape(-1, 6)])
    turns = np.stack([cv2.Rodrigues(turn)[0] for turn in poses[:, :3]])
    return Bundle(
        turns @ bundle.rotation,
        bundle.translation_m + poses[:, 3:],
        bundle.points + (step.point_inverse @ points)[:, :, 0],
        bundle.error_px + rest[n:],
    )


def _cross(vectors: FloatArray) -> FloatArray:
    """(N, 3, 3) matrices whose product with w is vectors x w."""
    x, y, z = vectors.T
    zero = np.zeros_like(x)
    return np.stack([zero, -z, y, z, zero, -x, -y, x, zero], axis=1).reshape(-1, 3, 3)


def _noise_px(residual: FloatArray) -> float:
    median = float(np.median(np.linalg.norm(residual, axis=1))) / _MEDIAN_NORM
    return float(np.clip(median, *_NOISE_PX))


def _cauchy(residual: FloatArray, noise_px: float) -> FloatArray:
    return np.asarray(1 / (1 + (residual**2).sum(axis=1) / (_CAUCHY_SIGMAS * noise_px) ** 2))


def _cost(residual: FloatArray, noise_px: float) -> float:
    return float(_CAUCHY_SIGMAS**2 * np.log1p((residual**2).sum(axis=1) / (_CAUCHY_SIGMAS * noise_px) ** 2).sum())
