"""Motion of a pair between two frames, fitted to static points with inverse depths; steps 3 and 4
of `stereo_odometry`.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import cv2
import numpy as np

from track_range.foundation.arrays import BoolArray, FloatArray, IntArray
from track_range.foundation.robust_statistics import median_of

# residual, in standard deviations, above which the weight is 0 (95 % efficiency with normal noise)
_TUKEY = 4.685
_N_ROUNDS = 5  # of Gauss-Newton, at most; the last one changes the translation by less than 1 mm
_SMALL_STEP2 = 0.01  # squared length of a step that ends them, in standard deviations
# the same with a free offset of the inverse depths, while it changes by more than some sigmas
_N_OFFSET_ROUNDS, _LARGE_OFFSET_SIGMAS = 5, 2.0
# random triples of corners: of half static ones, one is all static with a probability of 99.5 %
_N_TRIPLES = 40
# of a motion near the start that needs no triples: fraction of the points that fit it, so that no
# other motion has as many, and largest ratio of the squared residuals to those expected
_SURE_FRACTION, _SURE_SPREAD2 = 0.6, 4.0
_CHI2_MEDIAN = 1.386  # median of the chi-squared distribution with 2 degrees of freedom
# largest squared Mahalanobis distance of a static corner, which 1.1 % of them exceed
_MAX_DISTANCE2 = 9.0
_N_CELLS = np.array([8, 4])  # columns and rows of cells whose points may have errors in common
MIN_RATIO = 0.05  # smallest ratio of the depths now and before; a nearer point leaves the image


class RigidMotion(NamedTuple):
    """Motion `now_from_before`: (3, 3) rotation R and (3,) translation t in metres."""

    rotation: FloatArray
    translation_m: FloatArray

    def moved(self, rays: FloatArray, inverse_depth: FloatArray) -> FloatArray:
        """(N, 3) R m + t rho of rays (N, 3) with inverse depths (N,) in 1/m: the points scaled by
        rho.
        """
        return np.asarray(rays @ self.rotation.T + inverse_depth[:, None] * self.translation_m)

    def moved_by(self, step: FloatArray) -> RigidMotion:
        """The motion after a small change (6,) of rotation and translation."""
        return RigidMotion(_rotation(step[:3]) @ self.rotation, self.translation_m + step[3:])


AT_REST = RigidMotion(np.eye(3), np.zeros(3))


class MotionFit(NamedTuple):
    """A motion fitted to N points."""

    motion: RigidMotion  # the motion
    covariance: FloatArray  # (6, 6) of rotation and translation
    # (6,) change of rotation and translation per common error of all inverse depths, in 1/m
    by_offset: FloatArray
    # common error of all inverse depths that fits best, in 1/m, and its standard deviation
    offset: tuple[float, float]
    is_static: BoolArray  # (N,) which points agree with it
    noise_factor: float  # ratio of the residuals to those expected, at least 1

    @property
    def rotation_rad(self) -> FloatArray:
        """(3,) rotation vector: pitch, yaw and roll."""
        return np.asarray(cv2.Rodrigues(self.motion.rotation)[0].ravel(), np.float64)


def fit_motion(
    rays: FloatArray,
    inverse_depth: FloatArray,
    now: FloatArray,
    *,
    noise: float,
    inverse_depth_noise: float,
    rng: np.random.Generator,
    expected_offset: float = 0.0,
    start: RigidMotion | None = None,
) -> MotionFit:
    """Motion of the camera from N points with inverse depths.

    `rays` (N, 3) m in the previous frame and `now` (N, 3) p' in this frame have z = 1;
    `inverse_depth` (N,) is rho in 1/m. The standard deviations are `noise` of p', rad, and
    `inverse_depth_noise` of rho, 1/m; `rng` draws triples. `expected_offset` is the
    common error of all rho, near which the one that fits best is sought. Triples are drawn if most
    points do not fit a motion near `start`.
    """
    points = _Points(rays, inverse_depth, now, noise, inverse_depth_noise)
    fit = None if start is None else _refined(points, start)
    if fit is None or fit.spread2 > _SURE_SPREAD2 or fit.is_static.mean() < _SURE_FRACTION:
        fit = _refined(points, _of_triples(points, rng))
    by_offset = -fit.inverse @ fit.equations.information[:6, 6]
    return MotionFit(
        fit.motion,
        np.asarray(fit.inverse * fit.spread2, np.float64),
        np.asarray(by_offset, np.float64),
        _offset(points, fit, expected_offset),
        fit.is_static,
        math.sqrt(fit.spread2),
    )


class _Refined(NamedTuple):
    """A motion that fits the points near it best."""

    motion: RigidMotion
    before: RigidMotion  # before the last, small step
    equations: _Equations  # at the motion before this step
    inverse: FloatArray  # (6, 6) inverse of its information
    is_static: BoolArray  # (N,) which points agree with it

    @property
    def spread2(self) -> float:
        """Ratio of the squared residuals to those expected, at least 1."""
        return self.equations.spread2


def _refined(points: _Points, motion: RigidMotion) -> _Refined:
    """The motion by Gauss-Newton from a first one."""
    for _ in range(_N_ROUNDS):
        equations = points.equations(motion)
        information, gradient = equations.information[:6, :6].copy(), equations.gradient[:6]
        step = np.asarray(-cv2.solve(information, gradient[:, None])[1][:, 0], np.float64)
        before, motion = motion, motion.moved_by(step)
        if -float(step @ gradient) < _SMALL_STEP2 * equations.spread2:
            break
    inverse = np.asarray(np.linalg.inv(information), np.float64)
    is_static = equations.distance2 <= _MAX_DISTANCE2 * equations.spread2
    # the camera has not passed the point
    is_static &= motion.moved(points.rays, points.inverse_depth)[:, 2] > MIN_RATIO
    return _Refined(motion, before, equations, inverse, np.asarray(is_static))


class _Equations(NamedTuple):
    """Normal equations of rotation, translation and a common error of all inverse depths."""

    information: FloatArray  # (7, 7)
    weighted: FloatArray  # (7, 2, N) weighted derivatives
    residual: FloatArray  # (2, N)
    distance2: FloatArray  # (N,) squared Mahalanobis distances
    spread2: float  # ratio of the squared residuals to those expected, at least 1

    def influence(self, direction: FloatArray) -> FloatArray:
        """(N,) contributions of the points to the gradient along a direction (7,)."""
        along = (direction @ self.weighted.reshape(7, -1)).reshape(2, -1) * self.residual
        return np.asarray(along[0] + along[1])

    @property
    def gradient(self) -> FloatArray:
        """(7,) gradient."""
        return np.asarray(self.weighted.reshape(7, -1) @ self.residual.ravel())


class _Points(NamedTuple):
    """N points of a motion, as in `fit_motion`."""

    rays: FloatArray
    inverse_depth: FloatArray
    now: FloatArray
    noise: float
    inverse_depth_noise: float

    def equations(self, motion: RigidMotion, offset: float = 0.0) -> _Equations:
        """The normal equations at a motion and an offset of the inverse depths."""
        residual, jacobian = _reprojection(motion, self.rays, self.inverse_depth + offset, self.now)
        by_x, by_y = jacobian[6]
        variance = self.noise**2 + self.inverse_depth_noise**2 * (by_x * by_x + by_y * by_y)
        squared = residual * residual
        distance2 = (squared[0] + squared[1]) / variance
        spread2 = max(1.0, float(median_of(distance2)) / _CHI2_MEDIAN)
        weight = np.maximum(1 - distance2 / (_TUKEY**2 * spread2), 0.0) ** 2 / variance
        weighted = jacobian * weight
        information = np.asarray(weighted.reshape(7, -1) @ jacobian.reshape(7, -1).T, np.float64)
        ridge = 1e-9 * information[:6, :6].trace()
        information.flat[: 6 * 8 : 8] += ridge  # the diagonal of rotation and translation
        return _Equations(information, weighted, residual, distance2, spread2)

    @property
    def cell(self) -> IntArray:
        """(N,) cells of the image, whose points may have errors in common."""
        xy = self.rays.T[:2]
        low = xy.min(axis=1, keepdims=True)
        size = np.maximum(xy.max(axis=1, keepdims=True) - low, 1e-9)
        n_cells = _N_CELLS[:, None]
        column, row = np.minimum((n_cells * (xy - low) / size).astype(np.int64), n_cells - 1)
        return np.asarray(_N_CELLS[1] * column + row)


def _offset(points: _Points, fit: _Refined, offset: float) -> tuple[float, float]:
    """The common error of all inverse depths that fits best, with the motion that fits it, and its
    standard deviation; NaN = unknown. The search starts from a motion and an error.
    """
    sigma, motion, equations = math.nan, fit.before, fit.equations
    for k in range(_N_OFFSET_ROUNDS):
        if k or offset:
            equations = points.equations(motion, offset)
        if not equations.information[6, 6] > 0:
            return math.nan, math.nan
        covariance = np.linalg.inv(equations.information)
        step = -covariance @ equations.gradient
        sigma = math.sqrt(max(covariance[6, 6], 0.0) * equations.spread2)
        motion, offset = motion.moved_by(step[:6]), offset + float(step[6])
        if abs(step[6]) < _LARGE_OFFSET_SIGMAS * sigma:
            break
    # the scatter of the cells (Liang and Zeger 1986): the errors of images that vibrate, or of a
    # wrong lens, are common to many points
    by_cell = np.bincount(points.cell, equations.influence(covariance[6]))
    n_cells = int(np.count_nonzero(by_cell))
    scatter = math.sqrt(float(by_cell @ by_cell) * n_cells / max(n_cells - 7, 1))
    return offset, max(sigma, scatter)


def _rotation(vector: FloatArray) -> FloatArray:
    return np.asarray(cv2.Rodrigues(vector)[0], np.float64)


def _reprojection(
    motion: RigidMotion, rays: FloatArray, inverse_depth: FloatArray, now: FloatArray
) -> tuple[FloatArray, FloatArray]:
    """(2, N) reprojection errors of x and y, and their derivatives (7, 2, N) by w, t and inverse
    depth.

    With q = R m + t rho, u = R m:  d q = w x u + rho dt + t drho, d (q_x / q_z) = (d q_x - x d q_z) / q_z
    """
    u = motion.rotation @ rays.T
    t = motion.translation_m[:, None]
    q = u + t * inverse_depth
    z = np.maximum(q[2], MIN_RATIO)
    xy = q[:2] / z
    u_x, u_y, u_z = u / z
    rho = inverse_depth / z
    jacobian = np.zeros((7, 2, len(z)))
    jacobian[0], jacobian[1], jacobian[5] = -xy * u_y, xy * u_x, -xy * rho
    jacobian[0, 1] -= u_z
    jacobian[1, 0] += u_z
    jacobian[2, 0], jacobian[2, 1] = -u_y, u_x
    jacobian[3, 0] = jacobian[4, 1] = rho
    jacobian[6] = (t[:2] - xy * t[2]) / z
    return xy - now[:, :2].T, jacobian


def _of_triples(points: _Points, rng: np.random.Generator) -> RigidMotion:
    """The motion of a random triple of points, or rest, that has the smallest robust cost over all
    points.
    """
    x, y, rho = points.now[:, 0], points.now[:, 1], points.inverse_depth
    m_x, m_y = points.rays[:, 0], points.rays[:, 1]
    zero = np.zeros(len(x))
    columns = np.array(
        [
            [-x * m_y, 1 + x * m_x, -m_y, rho, zero, -x * rho],
            [-1 - y * m_y, y * m_x, m_x, zero, rho, -y * rho],
        ]
    )
    moved = np.array([x - m_x, y - m_y])
    triples = rng.integers(0, len(x), (_N_TRIPLES, 3))
    systems = columns[:, :, triples].transpose(2, 0, 3, 1).reshape(_N_TRIPLES, 6, 6)
    right = moved[:, triples].transpose(1, 0, 2).reshape(_N_TRIPLES, 6, 1)
    transposed = systems.transpose(0, 2, 1)
    solutions = np.linalg.solve(transposed @ systems + 1e-12 * np.eye(6), transposed @ right)[
        :, :, 0
    ]
    solutions = np.concatenate([np.zeros((1, 6)), solutions])
    error2 = ((solutions @ columns - moved[:, None]) ** 2).sum(axis=0)
    depth_change = 1.0 + solutions[:, 5:] * rho  # the equations are multiplied by z' / z
    shift2 = (solutions[:, 3:] ** 2).sum(axis=1)[:, None]
    variance = (depth_change * points.noise) ** 2 + shift2 * points.inverse_depth_noise**2
    best = solutions[int(np.argmin(np.minimum(error2 / variance, _MAX_DISTANCE2).sum(axis=1)))]
    return RigidMotion(_rotation(best[:3]), best[3:])
