"""Bundle adjustment of a segment of a drive: poses, points and the disparity error of the rig from
tracked points.

    point on frame 0's ray (a, b, 1), inverse depth r:    q = R (a, b, 1) + r t         R, t = frame f from frame 0
    left image   x = f q_x / q_z + cx,  y = f q_y / q_z + cy
    right image  x - f B r / q_z + offset + curvature u^2 + slope u     u: column, see `stereo.geometry.alignment`

Motion alone gives depths up to a scale, disparity alone up to the error; with near and far points
observed from several positions, the error is the intercept of the disparity as a function of the
inverse depth from motion. Points fixed at their triangulated positions would bias it by their
noise, so points are unknowns too. The solver is Levenberg-Marquardt with Cauchy weights
(`stereo.geometry.bundle_equations`).
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from track_range.foundation.arrays import FloatArray, IntArray
from track_range.stereo.geometry.bundle_equations import (
    POSE_RIDGE,
    Equations,
    Linear,
    PointBlocks,
    cauchy_cost,
    cauchy_weights,
    cross_matrices,
    moved_poses,
    noise_px_of,
    point_blocks,
    pose_equations,
)
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


def fit_bundle(observed: Observations, start: Bundle, rig: StereoRig) -> BundleFit:
    """The bundle with the minimum robust cost, from a start within a few pixels of the minimum;
    `rig` is rectified.

    The first frame's pose is fixed.
    """
    bundle, damping, n_frames = start, 1e-4, len(start.rotation)
    linear = linearize(observed, bundle, rig)
    for _ in range(_MAX_STEPS):
        noise_px = noise_px_of(linear.residual)
        half_px = _CAUCHY_SIGMAS * noise_px
        cost = cauchy_cost(linear.residual, half_px, noise_px)
        weight = cauchy_weights(linear.residual, half_px) / noise_px**2
        poses = pose_equations(observed.frame, linear, weight, n_frames=n_frames)
        while damping < _MAX_DAMPING:
            points = point_blocks(
                observed.frame, observed.point, linear, weight, n_frames=n_frames, damping=damping
            )
            trial = _updated(bundle, poses.damped(damping).without(points), points)
            trial_linear = linearize(observed, trial, rig)
            trial_cost = cauchy_cost(trial_linear.residual, half_px, noise_px)
            if trial_cost <= cost:  # False for NaN too
                break
            damping *= 6.0
        else:
            break
        gain, change_px = (cost - trial_cost) / cost, np.abs(trial.error_px - bundle.error_px).max()
        bundle, linear, damping = trial, trial_linear, max(damping / 5.0, 1e-9)
        if gain < _MIN_RELATIVE_GAIN or (gain < _SETTLED_GAIN and change_px < _SETTLED_PX):
            break
    noise_px = noise_px_of(linear.residual)
    weight = cauchy_weights(linear.residual, _CAUCHY_SIGMAS * noise_px)
    return BundleFit(bundle, noise_px, weight)


def equations_by_group(
    observed: Observations, linear: Linear, weight: FloatArray, *, n_frames: int, group: IntArray
) -> dict[int, Equations]:
    """Normal equations of groups of points, without a prior; `weight` (N,) are inverse variances,
    `group` (P,).
    """
    blocks = point_blocks(observed.frame, observed.point, linear, weight, n_frames=n_frames)
    equations = {}
    for number in np.unique(group).tolist():
        is_member = group == number
        rows = is_member[observed.point]
        of_rows = Linear(*(part[rows] for part in linear))
        poses = pose_equations(observed.frame[rows], of_rows, weight[rows], n_frames=n_frames)
        equations[number] = poses.without(blocks, is_member)
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
    by_pose = np.concatenate(
        [-by_q @ cross_matrices(rotated), by_q * point[:, 2, None, None]], axis=2
    )
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


def _updated(bundle: Bundle, equations: Equations, blocks: PointBlocks) -> Bundle:
    """The bundle after a Gauss-Newton step: (S + prior) x = b for poses and errors, then the points
    y.
    """
    n = equations.n_pose_unknowns
    # poses of frames without points stay
    prior = np.where(np.diag(equations.s) == 0.0, POSE_RIDGE, 0.0)
    prior[n:] = _ERROR_PRIOR_PX**-2
    b = equations.b.copy()
    b[n:] -= bundle.error_px * prior[n:]
    x = np.linalg.solve(equations.s + np.diag(prior), b)
    poses = moved_poses(bundle.rotation, bundle.translation_m, x[:n])
    return Bundle(*poses, bundle.points + blocks.points(x), bundle.error_px + x[n:])
