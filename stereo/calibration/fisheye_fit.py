"""Fit of one or two Kannala-Brandt cameras to views of a flat board, without an initial focal length.

1. For focal lengths f from a telephoto to a 300-degree lens, corners become directions of an ideal equidistant lens
   (theta = r / f about the image centre), and each view a pose of the board:

       d x (H (X, Y, 1)^T) = 0,   H = s (r1 r2 t)        d = direction of a corner (X, Y) of the board

   The f with the smallest residual, as the median of the views, is the start. Directions need no division by z, so
   corners beyond 90 degrees do no harm; cv2.fisheye.calibrate divides by z, and stops with an error.
2. Intrinsics, coefficients and poses are optimised together (`solve_blocks`), with both cameras of a pair and
   their relative pose in one problem.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import NamedTuple

import numpy as np
from scipy.spatial.transform import Rotation

from track_range.foundation.arrays import FloatArray, IntArray
from track_range.stereo.calibration.board_views import BoardView
from track_range.stereo.calibration.boards import CalibrationError
from track_range.stereo.geometry.camera import PinholeCamera
from track_range.stereo.geometry.rig import StereoRig, rigid_motion
from track_range.stereo.lenses.kannala_brandt import distorted_angle
from track_range.stereo.lenses.lens import KANNALA_BRANDT

# (R,) of parameters: common (C,), by view (V, P)
Residuals = Callable[[FloatArray, FloatArray], FloatArray]
_STEP = 1e-6  # relative step of the differences, at least as large as for a parameter of 1e-3
_FIRST_DAMPING = 1e-3
_LARGEST_DAMPING = 1e8  # above it, the minimum is reached
_MAX_ITERATIONS = 100
_TOLERANCE = 1e-9  # relative reduction of the sum of squares below which the minimum is reached
N_INTRINSICS = 8  # fx, fy, cx, cy, k1, k2, k3, k4
# focal lengths tried / image width: lenses of 318 to 19 degrees
_FOCAL_PER_WIDTH = np.geomspace(0.18, 3.0, 36)
_LARGEST_RAD = np.pi * 0.98  # largest angle from the axis of a corner at the start
_N_STARTS = 3  # number of the best focal lengths from which the optimisation starts


def fit_fisheye(
    views: Sequence[BoardView], start: PinholeCamera | None = None
) -> tuple[PinholeCamera, FloatArray, FloatArray]:
    """The camera of all views; `start` = a camera near it, which saves the search for the focal
    length.

    Also (V, 4, 4) board to camera, and (8,) standard deviations of the parameters for independent
    errors of the corners. Raises CalibrationError if the views do not determine the camera.
    """
    starts = _initial_cameras(views) if start is None else [start]
    solutions = [
        solution for camera in starts if (solution := _solved([views], [camera], None)) is not None
    ]
    if not solutions:
        raise CalibrationError(UNDETERMINED)
    best = min(solutions, key=lambda solution: float(solution.residuals @ solution.residuals))
    camera = _camera(best.common, views[0].size_px)
    return (
        camera,
        _matrices(best.view_parameters),
        np.sqrt(np.maximum(np.diag(best.covariance), 0.0)),
    )


def fit_fisheye_pair(
    pairs: Sequence[tuple[BoardView, BoardView]], starts: tuple[PinholeCamera, PinholeCamera]
) -> tuple[StereoRig, FloatArray]:
    """The rig, from cameras fitted alone, and (V, 4, 4) board to left camera; CalibrationError if
    undetermined.
    """
    views = [[pair[side] for pair in pairs] for side in (0, 1)]
    in_left, in_right = (
        np.stack([board_pose(camera, view) for view in side])
        for camera, side in zip(starts, views, strict=True)
    )
    relative = in_right @ np.linalg.inv(in_left)
    middle = int(np.argsort(relative[:, 0, 3])[len(relative) // 2])
    solution = _solved(views, starts, relative[middle])
    if solution is None:
        raise CalibrationError(UNDETERMINED)
    left, right = (
        _camera(solution.common[side * N_INTRINSICS :], views[side][0].size_px) for side in (0, 1)
    )
    rig = StereoRig(left, right, _matrices(solution.common[None, 2 * N_INTRINSICS :])[0])
    return rig, _matrices(solution.view_parameters)


UNDETERMINED = (
    "the views do not determine the camera; add views with the board tilted and in other parts of "
    "the image."
)


def board_pose(camera: PinholeCamera, view: BoardView) -> FloatArray:
    """(4, 4) board to camera (direct linear transform); CalibrationError if fewer than four corners
    have directions.
    """
    rays = camera.recorded_rays(view.xy_px)
    known = np.isfinite(rays).all(axis=1)
    if known.sum() < 4:
        raise CalibrationError(UNDETERMINED)
    rays, board_m = rays[known], view.xyz_m[known, :2]
    centre_m, scale_m = board_m.mean(axis=0), float(np.ptp(board_m))
    plane = np.concatenate([(board_m - centre_m) / scale_m, np.ones((len(board_m), 1))], axis=1)
    # rows e_i x d, so that skew @ v = d x v up to the sign
    skew = np.cross(np.eye(3)[None], rays[:, None, :])
    equations = np.einsum("nij,nk->nijk", skew, plane).reshape(-1, 9)
    homography = np.linalg.svd(equations, full_matrices=False)[2][-1].reshape(3, 3)
    homography *= np.sign(np.median((rays * (plane @ homography.T)).sum(axis=1)) or 1.0)
    axes = homography[:, :2] / scale_m
    scale = 2.0 / np.linalg.norm(axes, axis=0).sum()
    first, second = axes.T * scale
    u, _, vt = np.linalg.svd(np.stack([first, second, np.cross(first, second)], axis=1))
    rotation = u @ np.diag([1.0, 1.0, np.linalg.det(u @ vt)]) @ vt
    return rigid_motion(rotation, homography[:, 2] * scale - rotation[:, :2] @ centre_m)


def _initial_cameras(views: Sequence[BoardView]) -> list[PinholeCamera]:
    """Equidistant lenses with the focal lengths that fit best, the best one first."""
    width_px, height_px = views[0].size_px
    centre_px = ((width_px - 1) / 2, (height_px - 1) / 2)
    reach_px = max(float(np.linalg.norm(view.xy_px - centre_px, axis=1).max()) for view in views)
    focal_px = [
        focal_px for focal_px in width_px * _FOCAL_PER_WIDTH if reach_px / focal_px < _LARGEST_RAD
    ]
    cameras = [
        PinholeCamera(
            float(f), float(f), *centre_px, width_px, height_px, (0.0,) * 4, KANNALA_BRANDT
        )
        for f in focal_px
    ]

    def error_px(camera: PinholeCamera, view: BoardView) -> float:
        """Root mean square residual of the linear pose of a view."""
        pose = board_pose(camera, view)
        projected = camera.recorded_px(view.xyz_m @ pose[:3, :3].T + pose[:3, 3])
        squared = ((projected - view.xy_px) ** 2).sum(axis=1)
        return float(np.sqrt(np.where(np.isfinite(squared), squared, width_px**2).mean()))

    errors_px = [float(np.median([error_px(camera, view) for view in views])) for camera in cameras]
    return [cameras[i] for i in np.argsort(errors_px)[:_N_STARTS]]


def _solved(
    views: Sequence[Sequence[BoardView]],
    cameras: Sequence[PinholeCamera],
    right_from_left: FloatArray | None,
) -> BlockSolution | None:
    """The optimum for views of one camera, or of two cameras with their relative pose (4, 4); None
    = undetermined.
    """
    sides = [_Corners(side) for side in views]
    order = np.argsort(
        np.concatenate([np.repeat(corners.view, 2) for corners in sides]), kind="stable"
    )
    common = np.concatenate(
        [
            (camera.fx_px, camera.fy_px, camera.cx_px, camera.cy_px, *camera.distortion)
            for camera in cameras
        ]
    )
    if right_from_left is not None:
        common = np.concatenate([common, _vectors(right_from_left[None])[0]])

    def residuals_of(common: FloatArray, poses: FloatArray) -> FloatArray:
        matrices = _matrices(poses)
        residuals = []
        for side, corners in enumerate(sides):
            in_camera = matrices if side == 0 else _matrices(common[None, -6:]) @ matrices
            residuals.append(corners.residuals_px(common[side * N_INTRINSICS :], in_camera).ravel())
        return np.concatenate(residuals)[order]

    try:
        poses = _vectors(np.stack([board_pose(cameras[0], view) for view in views[0]]))
        n_residuals = np.sum([2 * np.bincount(corners.view) for corners in sides], axis=0)
        return solve_blocks(residuals_of, n_residuals, common, poses)
    except (np.linalg.LinAlgError, CalibrationError):
        return None


class _Corners:
    """Corners of all views of one camera: view (N,), positions on the board (N, 3), metres, and in
    the image (N, 2).
    """

    def __init__(self, views: Sequence[BoardView]) -> None:
        self.view: IntArray = np.repeat(np.arange(len(views)), [len(view.xy_px) for view in views])
        self.xyz_m: FloatArray = np.concatenate([view.xyz_m for view in views])
        self.xy_px: FloatArray = np.concatenate([view.xy_px for view in views])

    def residuals_px(self, intrinsics: FloatArray, board_to_camera: FloatArray) -> FloatArray:
        """(N, 2) projected minus measured corners for intrinsics (8 or more,) and poses (V, 4, 4).

        The polynomial is not limited to its increasing part, since it changes during the
        optimisation.
        """
        fx, fy, cx, cy, *k = intrinsics[:N_INTRINSICS].tolist()
        matrices = board_to_camera[self.view]
        x, y, z = (np.einsum("nij,nj->ni", matrices[:, :3, :3], self.xyz_m) + matrices[:, :3, 3]).T
        r = np.maximum(np.hypot(x, y), 1e-12)
        scale = distorted_angle(np.arctan2(r, z), k) / r
        return np.stack([fx * x * scale + cx, fy * y * scale + cy], axis=1) - self.xy_px


def _camera(parameters: FloatArray, size_px: tuple[int, int]) -> PinholeCamera:
    fx, fy, cx, cy, *k = parameters[:N_INTRINSICS].tolist()
    return PinholeCamera(fx, fy, cx, cy, *size_px, tuple(k), KANNALA_BRANDT)


def _matrices(vectors: FloatArray) -> FloatArray:
    """(V, 4, 4) transforms of rotation vectors and translations (V, 6)."""
    matrices = np.tile(np.eye(4), (len(vectors), 1, 1))
    matrices[:, :3, :3] = Rotation.from_rotvec(vectors[:, :3]).as_matrix()
    matrices[:, :3, 3] = vectors[:, 3:]
    return matrices


def _vectors(matrices: FloatArray) -> FloatArray:
    """(V, 6) rotation vectors and translations of transforms (V, 4, 4)."""
    return np.concatenate(
        [Rotation.from_matrix(matrices[:, :3, :3]).as_rotvec(), matrices[:, :3, 3]], axis=1
    )


class BlockSolution(NamedTuple):
    """Minimum of a block least-squares problem."""

    common: FloatArray  # (C,) common parameters
    view_parameters: FloatArray  # (V, P)
    residuals: FloatArray  # (R,)
    # (C, C) of the common parameters, for independent residuals of equal, estimated variance
    covariance: FloatArray


def solve_blocks(
    residuals_of: Residuals, n_residuals: IntArray, common: FloatArray, view_parameters: FloatArray
) -> BlockSolution:
    """The local minimum that is reached from the parameters (C,) and (V, P), with `n_residuals`
    (V,) per view.

    The Levenberg-Marquardt method for parameters of which one part is common and another belongs to
    one view:

        minimise  sum over views v of |r_v(c, p_v)|^2

        [ U + lambda diag U   W                 ] [ dc ]   [ g_c ]     U = sum J_c^T J_c,  W_v = J_c^T J_p
        [ W^T                 V + lambda diag V ] [ dp ] = [ g_p ]     V_v = J_p^T J_p,    g = -J^T r

    V is block diagonal, so the views are eliminated first (Schur complement). Derivatives are
    forward differences; the derivatives of all views are computed at once. (Triggs et al. 1999:
    Bundle Adjustment - A Modern Synthesis)

    Raises LinAlgError if the residuals do not determine the parameters, or are not finite at the
    start.
    """
    starts = np.concatenate([[0], np.cumsum(n_residuals)[:-1]])
    residuals = residuals_of(common, view_parameters)
    if not np.isfinite(residuals).all():
        raise np.linalg.LinAlgError("residuals: expected finite initial values")
    damping = _FIRST_DAMPING
    for _ in range(_MAX_ITERATIONS):
        normal = _normal_equations(residuals_of, residuals, starts, common, view_parameters)
        cost = float(residuals @ residuals)
        while damping <= _LARGEST_DAMPING:
            step, view_steps, _ = normal.steps(damping)
            moved = common + step, view_parameters + view_steps
            candidate = residuals_of(*moved)
            candidate_cost = (
                float(candidate @ candidate) if np.isfinite(candidate).all() else np.inf
            )
            if candidate_cost <= cost:
                break
            damping *= 10.0
        else:
            break
        common, view_parameters, residuals = *moved, candidate
        damping = max(damping / 10.0, 1e-12)
        if cost - candidate_cost <= _TOLERANCE * cost:
            break
    normal = _normal_equations(residuals_of, residuals, starts, common, view_parameters)
    n_free = max(len(residuals) - common.size - view_parameters.size, 1)
    covariance = np.asarray(np.linalg.inv(normal.steps(0.0)[2]))
    return BlockSolution(
        common, view_parameters, residuals, covariance * float(residuals @ residuals) / n_free
    )


class _NormalEquations(NamedTuple):
    """Blocks of J^T J and -J^T r."""

    u: FloatArray  # (C, C)
    v: FloatArray  # (V, P, P)
    w: FloatArray  # (V, C, P)
    g_common: FloatArray  # (C,)
    g_views: FloatArray  # (V, P)

    def steps(self, damping: float) -> tuple[FloatArray, FloatArray, FloatArray]:
        """Steps (C,) and (V, P) of the parameters, and the Schur complement (C, C) of the views."""
        u = self.u + damping * np.diag(np.diag(self.u))
        v = self.v + damping * np.einsum("vii->vi", self.v)[:, :, None] * np.eye(self.v.shape[1])
        w_over_v = np.linalg.solve(v, self.w.transpose(0, 2, 1)).transpose(0, 2, 1)
        schur = np.asarray(u - (w_over_v @ self.w.transpose(0, 2, 1)).sum(axis=0))
        common = np.linalg.solve(
            schur, self.g_common - (w_over_v @ self.g_views[:, :, None]).sum(axis=0)[:, 0]
        )
        right = self.g_views - np.einsum("vcp,c->vp", self.w, common)
        return common, np.linalg.solve(v, right[:, :, None])[:, :, 0], schur


def _normal_equations(
    residuals_of: Residuals,
    residuals: FloatArray,
    starts: IntArray,
    common: FloatArray,
    view_parameters: FloatArray,
) -> _NormalEquations:
    """The equations at a point with the given residuals; `starts` (V,) is the first residual of
    each view.
    """
    common_steps = np.diag(_STEP * np.maximum(np.abs(common), 1e-3))
    view_steps = np.diag(_STEP * np.maximum(np.abs(view_parameters).max(axis=0), 1e-3))
    by_common = [
        (residuals_of(common + step, view_parameters) - residuals) / step.sum()
        for step in common_steps
    ]
    by_views = [
        (residuals_of(common, view_parameters + step) - residuals) / step.sum()
        for step in view_steps
    ]
    j_c, j_p = np.stack(by_common, axis=1), np.stack(by_views, axis=1)
    return _NormalEquations(
        j_c.T @ j_c,
        np.add.reduceat(j_p[:, :, None] * j_p[:, None, :], starts),
        np.add.reduceat(j_c[:, :, None] * j_p[:, None, :], starts),
        -j_c.T @ residuals,
        -np.add.reduceat(j_p * residuals[:, None], starts),
    )
