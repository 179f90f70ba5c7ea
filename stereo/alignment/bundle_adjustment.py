"""Bundle adjustment of a segment of a drive: poses, points and the disparity error of the rig from tracked points.

    point on frame 0's ray (a, b, 1), inverse depth r:    q = R (a, b, 1) + r t         R, t = frame f from frame 0
    left image   x = f q_x / q_z + cx,  y = f q_y / q_z + cy
    right image  x - f B r / q_z + offset + curvature u^2     u = column from the axis, see `stereo.alignment.model`

Motion alone gives depths up to a scale, disparity alone up to the error; with near and far points observed from several
positions, the error is the intercept of one as a function of the other. Points fixed at their triangulated positions
would bias it by their noise, so points are unknowns too. Solved by Levenberg-Marquardt, with the points eliminated by
the Schur complement (Triggs et al. 2000, "Bundle adjustment: a modern synthesis", section 6), and Cauchy weights, which
suppress moving objects and bad tracks.
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
"""Number of disparity errors: offset and curvature."""

_MAX_STEPS = 25
"""Largest number of Levenberg-Marquardt steps."""

_MAX_DAMPING = 1e6
"""Largest damping, relative to the diagonal; if no step lowers the cost up to it, the iteration ends."""

_MIN_RELATIVE_GAIN = 1e-5
"""Decrease of the cost, relative to the cost, below which the iteration has converged."""

_CAUCHY_SIGMAS = 2.0
"""Scale of the Cauchy loss: length of a residual, in standard deviations, that has half the weight."""

_NOISE_PX = (0.05, 1.0)
"""Smallest and largest standard deviation of a tracked point; within them it is estimated from the residuals."""

_MEDIAN_NORM = 1.538
"""Median length of a vector of three standard normal numbers."""

_POSE_RIDGE = 1e-6
"""Ridge on poses, for frames without points; negligible compared to the information of points (1e5 per m^2, 1e8 per
rad^2)."""

_ERROR_PRIOR_PX = 5.0
"""Prior standard deviation of offset and curvature: wide, it only keeps the equations solvable."""


class Observations(NamedTuple):
    """Tracked points in both images, at most one row per point and frame.

    Attributes:
        frame: (N,) frame numbers from 0.
        point: (N,) point numbers from 0.
        xyx_px: (N, 3) x and y in the left image, x in the right one.
    """

    frame: IntArray
    point: IntArray
    xyx_px: FloatArray


@dataclass(frozen=True, slots=True)
class Bundle:
    """Unknowns of a segment of F frames and P points.

    Attributes:
        rotation: (F, 3, 3) R, frame from frame 0.
        translation_m: (F, 3) t.
        points: (P, 3) a, b and r (1/m): ray and inverse depth in frame 0.
        error_px: (2,) offset and curvature.
    """

    rotation: FloatArray
    translation_m: FloatArray
    points: FloatArray
    error_px: FloatArray

    @property
    def path_m(self) -> float:
        """Distance between the first position of the left camera and the one farthest from it."""
        positions = np.einsum("fji,fj->fi", self.rotation, self.translation_m)
        return float(np.linalg.norm(positions - positions[0], axis=1).max())


class Fit(NamedTuple):
    """An optimised bundle, the standard deviation of its points, and the (N,) weights, 0..1, of the observations."""

    bundle: Bundle
    noise_px: float
    weight: FloatArray


class Linear(NamedTuple):
    """Residuals and Jacobians of N observations.

    Attributes:
        residual: (N, 3) observed minus predicted, px: x and y in the left image, x in the right one.
        by_pose: (N, 3, 6) derivatives of the prediction by rotation vector and translation of the frame.
        by_point: (N, 3, 3) derivatives of the prediction by a, b and r of the point.
        by_error: (N, 3, E) derivatives of the prediction by the disparity errors.
    """

    residual: FloatArray
    by_pose: FloatArray
    by_point: FloatArray
    by_error: FloatArray


class Equations(NamedTuple):
    """Normal equations S x = b with the points eliminated: x = poses of all frames but the first, then the errors.

    Equations of disjoint sets of points add up.

    Attributes:
        s: (C, C) Schur complement.
        b: (C,) right side.
        n_pose_unknowns: number of pose unknowns, which come first.
    """

    s: FloatArray
    b: FloatArray
    n_pose_unknowns: int

    def of_errors(self) -> tuple[FloatArray, FloatArray]:
        """(E, E) information on the errors and (E,) right side, with the poses p eliminated too.

        I = S_ee - S_ep S_pp^-1 S_pe,  i = b_e - S_ep S_pp^-1 b_p
        """
        n = self.n_pose_unknowns
        s_ep = self.s[n:, :n]
        s_pp = self.s[:n, :n] + _POSE_RIDGE * np.eye(n)
        solved = np.linalg.solve(s_pp, np.column_stack([s_ep.T, self.b[:n]]))
        return self.s[n:, n:] - s_ep @ solved[:, :-1], self.b[n:] - s_ep @ solved[:, -1]


class _Elimination(NamedTuple):
    """Equations without the points, and the matrices that give the points y = V^-1 (b_y - W x) afterwards.

    Attributes:
        equations: S x = b.
        v_inverse: (P, 3, 3) V^-1.
        w: (3 P, C) W.
        b_y: (3 P,) right side of the points.
    """

    equations: Equations
    v_inverse: FloatArray
    w: FloatArray
    b_y: FloatArray


def fit_bundle(observed: Observations, start: Bundle, rig: StereoRig) -> Fit:
    """The bundle with the minimum robust cost, from a start within a few pixels of it; `rig` is rectified."""
    bundle, damping = start, 1e-4
    linear = linearize(observed, bundle, rig)
    for _ in range(_MAX_STEPS):
        noise_px = _noise_px(linear.residual)
        cost = _cost(linear.residual, noise_px)
        weight = _cauchy(linear.residual, noise_px) / noise_px**2
        while damping < _MAX_DAMPING:
            trial = _updated(bundle, _eliminate_points(observed, linear, weight, len(bundle.rotation), damping))
            trial_linear = linearize(observed, trial, rig)
            trial_cost = _cost(trial_linear.residual, noise_px)
            if trial_cost <= cost:  # False for NaN too
                break
            damping *= 6.0
        else:
            break
        bundle, linear, damping = trial, trial_linear, max(damping / 5.0, 1e-9)
        if cost - trial_cost < _MIN_RELATIVE_GAIN * cost:
            break
    noise_px = _noise_px(linear.residual)
    return Fit(bundle, noise_px, _cauchy(linear.residual, noise_px))


def equations_of(observed: Observations, linear: Linear, weight: FloatArray, *, n_frames: int) -> Equations:
    """Normal equations of observations with inverse variances `weight` (N,), without a prior."""
    return _eliminate_points(observed, linear, weight, n_frames, 0.0).equations


def linearize(observed: Observations, bundle: Bundle, rig: StereoRig, *, extra: FloatArray | None = None) -> Linear:
    """Residuals and derivatives at a bundle; `extra` (N, E) are columns of additional errors of the right x."""
    camera, bf = rig.left, rig.left.fx_px * rig.baseline_m
    r, t = bundle.rotation[observed.frame], bundle.translation_m[observed.frame]
    point = bundle.points[observed.point]
    rotated = r[:, :, 0] * point[:, :1] + r[:, :, 1] * point[:, 1:2] + r[:, :, 2]
    q = rotated + point[:, 2:] * t
    inverse_z = 1.0 / q[:, 2]
    x, y = q[:, 0] * inverse_z, q[:, 1] * inverse_z
    disparity_px = bf * point[:, 2] * inverse_z
    left_x = camera.fx_px * x + camera.cx_px
    u_per_px = 2 / camera.width_px
    u = x * camera.fx_px * u_per_px
    columns = error_columns(u)
    magnification = 1 + 2 * bundle.error_px[1] * u * u_per_px  # derivative of the right x, without disparity, by left x
    right_x = left_x - disparity_px + columns @ bundle.error_px
    expected = np.stack([left_x, camera.fy_px * y + camera.cy_px, right_x], axis=1)
    by_q = np.zeros((len(x), 3, 3))
    by_q[:, 0, 0] = camera.fx_px * inverse_z
    by_q[:, 0, 2] = -camera.fx_px * x * inverse_z
    by_q[:, 1, 1], by_q[:, 1, 2] = camera.fy_px * inverse_z, -camera.fy_px * y * inverse_z
    by_q[:, 2] = by_q[:, 0] * magnification[:, None]
    by_q[:, 2, 2] += disparity_px * inverse_z
    by_pose = np.concatenate([-by_q @ _cross(rotated), by_q * point[:, 2, None, None]], axis=2)
    by_point = by_q @ np.concatenate([r[:, :, :2], t[:, :, None]], axis=2)
    by_point[:, 2, 2] -= bf * inverse_z
    all_columns = columns if extra is None else np.concatenate([columns, extra], axis=1)
    by_error = np.zeros((len(x), 3, all_columns.shape[1]))
    by_error[:, 2] = all_columns
    return Linear(observed.xyx_px - expected, by_pose, by_point, by_error)


def error_columns(u: FloatArray) -> FloatArray:
    """(N, 2) derivatives of the right x by offset and curvature, at the columns `u` (N,) from the axis."""
    return np.stack([np.ones_like(u), u**2], axis=1)


def _eliminate_points(
    observed: Observations, linear: Linear, weight: FloatArray, n_frames: int, damping: float
) -> _Elimination:
    """The Schur complement of the points in the normal equations; the first frame's pose is fixed.

    [ U  W^T ] [x]   [b_x]       x: poses and errors       U = Jx^T L Jx,  W = Jy^T L Jx,  V = Jy^T L Jy
    [ W  V   ] [y] = [b_y]       y: points                 b_x = Jx^T L r, b_y = Jy^T L r, L = diag(weight)

    S = U - W^T V^-1 W,  b = b_x - W^T V^-1 b_y,  with V block diagonal (3 x 3); damping scales the diagonals
    """
    n_points, n_poses, n_errors = int(observed.point.max()) + 1, 6 * n_frames, linear.by_error.shape[2]
    error_columns_of_x = np.broadcast_to(n_poses + np.arange(n_errors), (len(observed.frame), n_errors))
    columns = np.concatenate([6 * observed.frame[:, None] + np.arange(6), error_columns_of_x], axis=1)
    jx = _sparse(np.concatenate([linear.by_pose, linear.by_error], axis=2), columns, n_poses + n_errors)
    jy = _sparse(linear.by_point, 3 * observed.point[:, None] + np.arange(3), 3 * n_points)
    row_weight = np.repeat(weight, 3)
    l_jx, l_jy = (sparse.diags_array(row_weight) @ jacobian for jacobian in (jx, jy))
    r = linear.residual.reshape(-1)

    u = (jx.T @ l_jx).toarray()[6:, 6:]
    w = (jy.T @ l_jx).toarray()[:, 6:]
    v = np.zeros((n_points, 3, 3))
    np.add.at(v, observed.point, np.einsum("nki,nkj->nij", linear.by_point * weight[:, None, None], linear.by_point))
    v += (damping * np.einsum("pii->pi", v) + 1e-9)[:, :, None] * np.eye(3)
    v_inverse = np.asarray(np.linalg.inv(v), np.float64)
    v_inverse_w = (v_inverse @ w.reshape(n_points, 3, -1)).reshape(w.shape)
    b_y = l_jy.T @ r
    s = u + damping * np.diag(np.diag(u)) - w.T @ v_inverse_w
    b = (l_jx.T @ r)[6:] - v_inverse_w.T @ b_y
    return _Elimination(Equations(s, b, n_poses - 6), v_inverse, w, b_y)


def _sparse(blocks: FloatArray, columns: IntArray, n_columns: int) -> sparse.csr_array:
    """(3 N, n_columns) sparse matrix of blocks (N, 3, K) at the columns (N, K)."""
    n, n_rows, width = blocks.shape
    starts = np.arange(n * n_rows + 1) * width
    return sparse.csr_array(
        (blocks.reshape(-1), np.repeat(columns, n_rows, axis=0).reshape(-1), starts), (n * n_rows, n_columns)
    )


def _updated(bundle: Bundle, elimination: _Elimination) -> Bundle:
    """The bundle after a Gauss-Newton step: (S + prior) x = b for poses and errors, y = V^-1 (b_y - W x) for points."""
    equations, n = elimination.equations, elimination.equations.n_pose_unknowns
    prior = np.zeros(len(equations.b))
    prior[n:] = _ERROR_PRIOR_PX**-2
    b = equations.b.copy()
    b[n:] -= bundle.error_px * prior[n:]
    x = np.linalg.solve(equations.s + np.diag(prior), b)
    y = elimination.v_inverse @ (elimination.b_y - elimination.w @ x).reshape(-1, 3, 1)
    poses = np.concatenate([np.zeros((1, 6)), x[:n].reshape(-1, 6)])
    rotations = np.stack([cv2.Rodrigues(vector)[0] for vector in poses[:, :3]])
    return Bundle(
        rotations @ bundle.rotation,
        bundle.translation_m + poses[:, 3:],
        bundle.points + y[:, :, 0],
        bundle.error_px + x[n:],
    )


def _cross(vectors: FloatArray) -> FloatArray:
    """(N, 3, 3) cross-product matrices of vectors (N, 3)."""
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
