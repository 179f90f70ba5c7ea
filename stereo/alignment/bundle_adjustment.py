"""Bundle adjustment of a segment of a drive: poses, points and the disparity error of the rig from
tracked points.

    point on frame 0's ray (a, b, 1), inverse depth r:    q = R (a, b, 1) + r t         R, t = frame f from frame 0
    left image   x = f q_x / q_z + cx,  y = f q_y / q_z + cy
    right image  x - f B r / q_z + offset + curvature u^2 + slope u     u: column, see `stereo.geometry.alignment`

Motion alone gives depths up to a scale, disparity alone up to the error; with near and far points
observed from several positions, the error is the intercept of the disparity as a function of the
inverse depth from motion. Points fixed at their triangulated positions would bias it by their
noise, so points are unknowns too. The solver is Levenberg-Marquardt, with the points eliminated by
the Schur complement (Triggs et al. 2000, "Bundle adjustment: a modern synthesis", section 6), and
Cauchy weights, which suppress moving objects and bad tracks.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import NamedTuple

import cv2
import numpy as np

from track_range.foundation.arrays import FloatArray, IntArray
from track_range.stereo.geometry.rig import StereoRig

OFFSET, CURVATURE, SLOPE = range(3)
N_ERRORS = 3  # disparity errors, by their numbers
_MAX_STEPS = 25  # largest number of Levenberg-Marquardt steps
# largest damping, relative to the diagonal; if no step lowers the cost up to it, the iteration ends
_MAX_DAMPING = 1e6
# decrease of the cost, relative to the cost, below which the iteration has converged
_MIN_RELATIVE_GAIN = 1e-5
# Decrease of the cost, relative to the cost, and change of the disparity errors in px, below which
# the iteration ends: the robust weights then still change the points, but the errors by less than
# 0.005 px (KITTI, three drives).
_SETTLED_GAIN, _SETTLED_PX = 2e-3, 1e-3
# scale of the Cauchy loss: length of a residual, in standard deviations, that has half the weight
_CAUCHY_SIGMAS = 2.0
# limits of the standard deviation of a tracked point, estimated from the residuals
_NOISE_PX = (0.05, 1.0)
_MEDIAN_NORM = 1.538  # median length of a vector of three standard normal numbers
# for frames without points; small compared to their information (1e5 per m^2, 1e8 per rad^2)
_POSE_RIDGE = 1e-6
# prior standard deviation of the disparity errors: wide, it only keeps the equations solvable
_ERROR_PRIOR_PX = 5.0


class Observations(NamedTuple):
    """Tracked points in both images, at most one row per point and frame."""

    frame: IntArray  # (N,) frame numbers from 0
    point: IntArray  # (N,) point numbers from 0
    xyx_px: FloatArray  # (N, 3) x and y in the left image, x in the right one


@dataclass(frozen=True, slots=True)
class Bundle:
    """Unknowns of a segment of F frames and P points."""

    rotation: FloatArray  # (F, 3, 3) R, frame from frame 0
    translation_m: FloatArray  # (F, 3) t
    points: FloatArray  # (P, 3) a, b and r (1/m): ray and inverse depth in frame 0
    error_px: FloatArray  # (3,) offset, curvature and slope

    @property
    def path_m(self) -> float:
        """Distance between the first and the farthest position of the left camera."""
        positions = np.einsum("fji,fj->fi", self.rotation, self.translation_m)
        return float(np.linalg.norm(positions - positions[0], axis=1).max())


class BundleFit(NamedTuple):
    """An optimised bundle, the standard deviation of its points, and the (N,) weights, 0..1, of the
    observations.
    """

    bundle: Bundle
    noise_px: float
    weight: FloatArray


class Linear(NamedTuple):
    """Residuals and Jacobians of N observations."""

    # (N, 3) observed minus predicted, px: x and y in the left image, x in the right one
    residual: FloatArray
    # (N, 3, 6) derivatives of the prediction by rotation vector and translation of the frame
    by_pose: FloatArray
    by_point: FloatArray  # (N, 3, 3) derivatives of the prediction by a, b and r of the point
    by_error: FloatArray  # (N, 3, E) derivatives of the prediction by the disparity errors


class Equations(NamedTuple):
    """Normal equations S x = b with the points eliminated: x = poses of all frames but the first,
    then the errors.

    Equations of disjoint sets of points add up.
    """

    s: FloatArray  # (C, C) Schur complement
    b: FloatArray  # (C,) right side
    n_pose_unknowns: int  # number of pose unknowns, which come first

    def of_errors(self) -> tuple[FloatArray, FloatArray]:
        """(E, E) information on the errors and (E,) right side, with the poses p eliminated too.

        I = S_ee - S_ep S_pp^-1 S_pe,  i = b_e - S_ep S_pp^-1 b_p
        """
        n = self.n_pose_unknowns
        s_ep = self.s[n:, :n]
        s_pp = self.s[:n, :n] + _POSE_RIDGE * np.eye(n)
        solved = np.linalg.solve(s_pp, np.column_stack([s_ep.T, self.b[:n]]))
        return self.s[n:, n:] - s_ep @ solved[:, :-1], self.b[n:] - s_ep @ solved[:, -1]

    def without(self, whitened: FloatArray, right_side: FloatArray) -> Equations:
        """The equations with points eliminated, from their L^-1 W (P, 3, C) and L^-1 b_y (P, 3),
        see `_PointBlocks`.
        """
        rows = whitened.reshape(-1, whitened.shape[2])
        return self._replace(s=self.s - rows.T @ rows, b=self.b - rows.T @ right_side.reshape(-1))


class _PointBlocks(NamedTuple):
    """Blocks of the points in the normal equations, V = L L^T; the points are y = V^-1 (b_y - W
    x).
    """

    l_inverse: FloatArray  # (P, 3, 3) L^-1
    whitened: FloatArray  # (P, 3, C) L^-1 W
    right_side: FloatArray  # (P, 3) L^-1 b_y


def fit_bundle(observed: Observations, start: Bundle, rig: StereoRig) -> BundleFit:
    """The bundle with the minimum robust cost, from a start within a few pixels of the minimum;
    `rig` is rectified.

    The points are eliminated; the first frame's pose is fixed. With damping of the diagonals of U
    and V,

    [ U  W^T ] [x]   [b_x]       x: poses and errors       U = Jx^T L Jx,  W = Jy^T L Jx,  V = Jy^T L Jy
    [ W  V   ] [y] = [b_y]       y: points                 b_x = Jx^T L r, b_y = Jy^T L r, L = diag(weight)

    S = U - W^T V^-1 W,  b = b_x - W^T V^-1 b_y,  V block diagonal (3 x 3)
    """
    bundle, damping, n_frames = start, 1e-4, len(start.rotation)
    linear = linearize(observed, bundle, rig)
    for _ in range(_MAX_STEPS):
        noise_px = _noise_px(linear.residual)
        cost = _cost(linear.residual, noise_px)
        weight = _cauchy(linear.residual, noise_px) / noise_px**2
        poses = _pose_equations(observed.frame, linear, weight, n_frames)
        while damping < _MAX_DAMPING:
            points = _point_blocks(observed, linear, weight, n_frames, damping)
            damped = poses._replace(s=poses.s + damping * np.diag(np.diag(poses.s)))
            trial = _updated(bundle, damped.without(points.whitened, points.right_side), points)
            trial_linear = linearize(observed, trial, rig)
            trial_cost = _cost(trial_linear.residual, noise_px)
            if trial_cost <= cost:  # False for NaN too
                break
            damping *= 6.0
        else:
            break
        gain, change_px = (cost - trial_cost) / cost, np.abs(trial.error_px - bundle.error_px).max()
        bundle, linear, damping = trial, trial_linear, max(damping / 5.0, 1e-9)
        if gain < _MIN_RELATIVE_GAIN or (gain < _SETTLED_GAIN and change_px < _SETTLED_PX):
            break
    noise_px = _noise_px(linear.residual)
    return BundleFit(bundle, noise_px, _cauchy(linear.residual, noise_px))


def equations_by_group(
    observed: Observations, linear: Linear, weight: FloatArray, *, n_frames: int, group: IntArray
) -> dict[int, Equations]:
    """Normal equations of groups of points, without a prior; `weight` (N,) are inverse variances,
    `group` (P,).
    """
    blocks = _point_blocks(observed, linear, weight, n_frames, 0.0)
    equations = {}
    for number in np.unique(group).tolist():
        is_member = group == number
        rows = is_member[observed.point]
        poses = _pose_equations(
            observed.frame[rows], Linear(*(part[rows] for part in linear)), weight[rows], n_frames
        )
        equations[number] = poses.without(blocks.whitened[is_member], blocks.right_side[is_member])
    return equations


def linearize(
    observed: Observations, bundle: Bundle, rig: StereoRig, *, extra: FloatArray | None = None
) -> Linear:
    """Residuals and derivatives at a bundle; `extra` (N, E) are columns of additional errors of the
    right x.
    """
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
    # derivative of the right x, without disparity, by left x
    magnification = 1 + (2 * bundle.error_px[1] * u + bundle.error_px[2]) * u_per_px
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
    """(N, 3) derivatives of the right x by offset, curvature and slope, at the columns `u` (N,)
    from the axis.
    """
    return np.stack([np.ones_like(u), u**2, u], axis=1)


def _point_blocks(
    observed: Observations, linear: Linear, weight: FloatArray, n_frames: int, damping: float
) -> _PointBlocks:
    """The blocks of all points; each point has at least one observation, and at most one per
    frame.
    """
    n_points, n_errors = int(observed.point.max()) + 1, linear.by_error.shape[2]
    l_jy = linear.by_point * weight[:, None, None]
    columns = [linear.by_pose, linear.by_error, linear.by_point, linear.residual[:, :, None]]
    products = l_jy.transpose(0, 2, 1) @ np.concatenate(columns, axis=2)
    order = np.argsort(observed.point, kind="stable")
    starts = np.searchsorted(observed.point[order], np.arange(n_points))
    sums = np.add.reduceat(products[order, :, 6:], starts, axis=0)
    by_frame = np.zeros((n_points, 3, n_frames, 6))
    by_frame[observed.point, :, observed.frame] = products[:, :, :6]
    w = np.concatenate([by_frame.reshape(n_points, 3, -1)[:, :, 6:], sums[:, :, :n_errors]], axis=2)
    v, b_y = sums[:, :, n_errors : n_errors + 3], sums[:, :, n_errors + 3]
    v += (damping * np.einsum("pii->pi", v) + 1e-9)[:, :, None] * np.eye(3)
    l_inverse = np.asarray(np.linalg.inv(np.linalg.cholesky(v)), np.float64)
    return _PointBlocks(l_inverse, l_inverse @ w, (l_inverse @ b_y[:, :, None])[:, :, 0])


def _pose_equations(
    frame: IntArray, linear: Linear, weight: FloatArray, n_frames: int
) -> Equations:
    """U and b_x of observations in the frames (N,)."""
    n_poses, n_errors = 6 * n_frames, linear.by_error.shape[2]
    u, b = np.zeros((n_poses + n_errors,) * 2), np.zeros(n_poses + n_errors)
    for number in np.unique(frame).tolist():
        rows = frame == number
        jacobian = np.concatenate([linear.by_pose[rows], linear.by_error[rows]], axis=2).reshape(
            -1, 6 + n_errors
        )
        l_jacobian = jacobian * np.repeat(weight[rows], 3)[:, None]
        columns = np.r_[6 * number : 6 * number + 6, n_poses : n_poses + n_errors]
        u[np.ix_(columns, columns)] += l_jacobian.T @ jacobian
        b[columns] += l_jacobian.T @ linear.residual[rows].reshape(-1)
    return Equations(u[6:, 6:], b[6:], n_poses - 6)


def _updated(bundle: Bundle, equations: Equations, points: _PointBlocks) -> Bundle:
    """The bundle after a Gauss-Newton step: (S + prior) x = b for poses and errors, then the points
    y.
    """
    n = equations.n_pose_unknowns
    # poses of frames without points stay
    prior = np.where(np.diag(equations.s) == 0.0, _POSE_RIDGE, 0.0)
    prior[n:] = _ERROR_PRIOR_PX**-2
    b = equations.b.copy()
    b[n:] -= bundle.error_px * prior[n:]
    x = np.linalg.solve(equations.s + np.diag(prior), b)
    y = points.l_inverse.transpose(0, 2, 1) @ (points.right_side - points.whitened @ x)[:, :, None]
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
    return float(
        _CAUCHY_SIGMAS**2
        * np.log1p((residual**2).sum(axis=1) / (_CAUCHY_SIGMAS * noise_px) ** 2).sum()
    )
