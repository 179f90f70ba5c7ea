"""Normal equations of a bundle adjustment, with the points eliminated by the Schur complement.

Unknowns are the poses of F frames relative to frame 0, parameters that all observations share (the
errors of a rig, a lens), and three numbers of each point. With damping of the diagonals of U and V,

    [ U  W^T ] [x]   [b_x]    x: poses, parameters   U = Jx^T L Jx, W = Jy^T L Jx, V = Jy^T L Jy
    [ W  V   ] [y] = [b_y]    y: points              b_x = Jx^T L r, b_y = Jy^T L r, L: weights

    S = U - W^T V^-1 W,  b = b_x - W^T V^-1 b_y,  V block diagonal (3 x 3)

(Triggs et al. 2000, "Bundle adjustment: a modern synthesis", section 6.) Cauchy's weights suppress
moving objects and bad tracks.
"""

from __future__ import annotations

from itertools import pairwise
from typing import NamedTuple

import cv2
import numpy as np

from track_range.foundation.arrays import BoolArray, FloatArray, IntArray

# limits of the standard deviation of a tracked point, estimated from the residuals
_NOISE_PX = (0.05, 1.0)
# median length of a vector of as many standard normal numbers
_MEDIAN_NORM = {2: 1.177, 3: 1.538}
# for frames without points; small compared to their information (1e5 per m^2, 1e8 per rad^2)
POSE_RIDGE = 1e-6


class Linear(NamedTuple):
    """Residuals and Jacobians of N observations of M pixel coordinates each."""

    residual: FloatArray  # (N, M) observed minus predicted, px
    # (N, M, 6) derivatives of the prediction by rotation vector and translation of the frame
    by_pose: FloatArray
    by_point: FloatArray  # (N, M, 3) derivatives of the prediction by the numbers of the point
    by_shared: FloatArray  # (N, M, E) derivatives of the prediction by the shared parameters


class Equations(NamedTuple):
    """Normal equations S x = b with the points eliminated: x = poses of all frames but the first,
    then the shared parameters.

    Equations of disjoint sets of points add up.
    """

    s: FloatArray  # (C, C) Schur complement
    b: FloatArray  # (C,) right side
    n_pose_unknowns: int  # number of pose unknowns, which come first

    def of_shared(self) -> SharedEquations:
        """The equations of the shared parameters, with the poses p eliminated too.

        I = S_ee - S_ep S_pp^-1 S_pe,  i = b_e - S_ep S_pp^-1 b_p
        """
        n = self.n_pose_unknowns
        s_ep, s_pp = self.s[n:, :n], self.s[:n, :n] + POSE_RIDGE * np.eye(n)
        solved = np.asarray(
            np.linalg.solve(s_pp, np.column_stack([s_ep.T, self.b[:n]])), np.float64
        )
        by_shared, poses = solved[:, :-1], solved[:, -1]
        return SharedEquations(
            self.s[n:, n:] - s_ep @ by_shared, self.b[n:] - s_ep @ poses, by_shared, poses
        )

    def damped(self, damping: float) -> Equations:
        """The equations with each number of the diagonal larger by the fraction `damping`."""
        return self._replace(s=self.s + damping * np.diag(np.diag(self.s)))

    def without(self, points: PointBlocks, is_member: BoolArray | None = None) -> Equations:
        """The equations with points eliminated, all or those of a mask (P,)."""
        whitened, right_side = points.whitened, points.right_side
        if is_member is not None:
            whitened, right_side = whitened[is_member], right_side[is_member]
        rows = whitened.reshape(-1, whitened.shape[2])
        return self._replace(s=self.s - rows.T @ rows, b=self.b - rows.T @ right_side.reshape(-1))


class SharedEquations(NamedTuple):
    """Normal equations I e = i of the E shared parameters, and the poses p that follow."""

    information: FloatArray  # (E, E) I
    right_side: FloatArray  # (E,) i
    by_shared: FloatArray  # (6 F - 6, E) S_pp^-1 S_pe
    poses: FloatArray  # (6 F - 6,) S_pp^-1 b_p

    def unknowns(self, shared: FloatArray) -> FloatArray:
        """(C,) x = (p, e) at the shared parameters (E,)."""
        return np.concatenate([self.poses - self.by_shared @ shared, shared])


class PointBlocks(NamedTuple):
    """Blocks of the points in the normal equations, V = L L^T; the points are y = V^-1 (b_y - W
    x).
    """

    l_inverse: FloatArray  # (P, 3, 3) L^-1
    whitened: FloatArray  # (P, 3, C) L^-1 W
    right_side: FloatArray  # (P, 3) L^-1 b_y

    def points(self, x: FloatArray) -> FloatArray:
        """(P, 3) y of the points, from the other unknowns x (C,)."""
        rest = self.right_side - self.whitened @ x
        return np.asarray((self.l_inverse.transpose(0, 2, 1) @ rest[:, :, None])[:, :, 0])


def point_blocks(
    frame: IntArray,
    point: IntArray,
    linear: Linear,
    weight: FloatArray,
    *,
    n_frames: int,
    damping: float = 0.0,
    ridge: FloatArray | float = 1e-9,
) -> PointBlocks:
    """The blocks of all points; each point has at least one observation, and at most one per frame.

    `frame`, `point` and `weight` (inverse variances) are (N,); `ridge`, a number or (3,), is added
    to the diagonal of V.
    """
    n_points, n_shared = int(point.max()) + 1, linear.by_shared.shape[2]
    l_jy = linear.by_point * weight[:, None, None]
    columns = [linear.by_pose, linear.by_shared, linear.by_point, linear.residual[:, :, None]]
    products = l_jy.transpose(0, 2, 1) @ np.concatenate(columns, axis=2)
    order = np.argsort(point, kind="stable")
    starts = np.searchsorted(point[order], np.arange(n_points))
    sums = np.add.reduceat(products[order, :, 6:], starts, axis=0)
    w = np.zeros((n_points, 3, 6 * n_frames + n_shared))
    by_frame = w[:, :, : 6 * n_frames].reshape(n_points, 3, n_frames, 6)  # a view
    by_frame[point, :, frame] = products[:, :, :6]
    w[:, :, 6 * n_frames :] = sums[:, :, :n_shared]
    v, b_y = sums[:, :, n_shared : n_shared + 3], sums[:, :, n_shared + 3]
    diagonal = damping * np.einsum("pii->pi", v).sum(axis=1, keepdims=True) + ridge
    v = v + diagonal[:, :, None] * np.eye(3)
    l_inverse = np.asarray(np.linalg.inv(np.linalg.cholesky(v)), np.float64)
    return PointBlocks(l_inverse, l_inverse @ w[:, :, 6:], (l_inverse @ b_y[:, :, None])[:, :, 0])


def pose_equations(
    frame: IntArray, linear: Linear, weight: FloatArray, *, n_frames: int
) -> Equations:
    """U and b_x of observations in the frames (N,), with inverse variances `weight` (N,)."""
    n_coordinates, n_shared = linear.by_shared.shape[1:]
    n_poses = 6 * n_frames
    u, b = np.zeros((n_poses + n_shared,) * 2), np.zeros(n_poses + n_shared)
    order = np.argsort(frame, kind="stable")
    columns = [linear.by_pose, linear.by_shared, linear.residual[:, :, None]]
    jacobian = np.concatenate(columns, axis=2)[order].reshape(-1, 6 + n_shared + 1)
    l_jacobian = jacobian[:, :-1] * np.repeat(weight[order], n_coordinates)[:, None]
    ends = n_coordinates * np.searchsorted(frame[order], np.arange(n_frames + 1))
    for number, (start, end) in enumerate(pairwise(ends.tolist())):
        product = l_jacobian[start:end].T @ jacobian[start:end]
        pose = slice(6 * number, 6 * number + 6)
        u[pose, pose], u[pose, n_poses:] = product[:6, :6], product[:6, 6:-1]
        u[n_poses:, pose] = product[6:, :6]
        u[n_poses:, n_poses:] += product[6:, 6:-1]
        b[pose] = product[:6, -1]
        b[n_poses:] += product[6:, -1]
    return Equations(u[6:, 6:], b[6:], n_poses - 6)


def moved_poses(
    rotation: FloatArray, translation: FloatArray, step: FloatArray
) -> tuple[FloatArray, FloatArray]:
    """Rotations (F, 3, 3) and translations (F, 3) after a step (6 F - 6,) of all poses but the
    first.
    """
    poses = np.concatenate([np.zeros((1, 6)), step.reshape(-1, 6)])
    turned = np.stack([cv2.Rodrigues(vector)[0] for vector in poses[:, :3]]) @ rotation
    return turned, translation + poses[:, 3:]


def cross_matrices(vectors: FloatArray) -> FloatArray:
    """(N, 3, 3) cross-product matrices of vectors (N, 3)."""
    x, y, z = vectors.T
    zero = np.zeros_like(x)
    return np.stack([zero, -z, y, z, zero, -x, -y, x, zero], axis=1).reshape(-1, 3, 3)


def noise_px_of(residual: FloatArray) -> float:
    """Standard deviation of a coordinate, from the median length of the residuals (N, M)."""
    median = float(np.median(np.linalg.norm(residual, axis=1))) / _MEDIAN_NORM[residual.shape[1]]
    return float(np.clip(median, *_NOISE_PX))


def cauchy_weights(residual: FloatArray, half_px: float) -> FloatArray:
    """(N,) weights, 0..1, of residuals (N, M); those of length `half_px` have half the weight."""
    return np.asarray(1 / (1 + (residual**2).sum(axis=1) / half_px**2))


def cauchy_cost(residual: FloatArray, half_px: float, noise_px: float) -> float:
    """Sum over N residuals (N, M) of Cauchy's loss, which for small ones is (r / noise_px)^2."""
    scaled = (residual**2).sum(axis=1) / half_px**2
    return float((half_px / noise_px) ** 2 * np.log1p(scaled).sum())
