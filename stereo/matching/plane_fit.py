"""The object's surface in a box: the windows that agree, and a plane through their disparities.

    d(u, v) = p0 + p1 u + p2 v          u, v: position in the inner half of the box, -0.5 .. 0.5, to the right and down

The object is the set of windows that agree with most others, the lower middle of the box counting most; background and
foreground are left out. The plane minimises the weighted absolute residuals r of these windows, bounded beyond a few
times a floor f, by iteratively reweighted least squares with the weights

    w_i = w / (max(|r_i|, f) (1 + (r_i / (2 f))^2))

p0 is the disparity at the box's centre, also of a car seen obliquely.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from track_range.foundation.arrays import FloatArray

_SAME_SURFACE_SHARE = 0.2
"""Largest relative difference of the disparities of one object: at 10 m a car's length is 30 %."""

_SAME_SURFACE_PX = 1.5
"""Largest difference of small disparities of one object, px of the box's level."""

_CENTRE_SIGMA = 0.4
"""Standard deviation of the Gaussian weight about the centre, in inner halves: the corners of cars are rounded."""

_LOWER_MIDDLE = 0.25
"""v of the most likely position of the object, in inner halves: objects touch the box's lower edge."""

_PRIOR_GAIN = 2.0
"""Additional support of a surface at the track's prior disparity, relative to that of other surfaces."""

_MIN_INLIERS = 4
"""Minimum number of windows that a plane is fitted to, one more than its parameters."""

_N_ITERATIONS = 4
"""Iterations of the reweighted least squares."""

_FLOOR_SHARE, _FLOOR_PX = 0.01, 0.05
"""f: residual below which windows have equal weights, as a fraction of the mean disparity, and its minimum in px."""

_BOUND_FLOORS = 2.0
"""Residual, in units of f, at which a window counts half of what it would without the bound."""

_RIDGE = 1e-3
"""Ridge on the tilt p1, p2, relative to the total weight: keeps the system solvable where windows nearly coincide."""

_UPPER = np.triu_indices(3)
_SYMMETRIC = np.array([[0, 1, 2], [1, 3, 4], [2, 4, 5]])
"""Indices of the six products of 1, u, v, and their places in the symmetric 3 x 3 normal matrix."""


@dataclass(frozen=True, slots=True)
class Surface:
    """The planes of N boxes with G windows each; disparities in px of the box's level.

    Attributes:
        centre: (N,) p0, the disparity at the middle of the inner half; NaN = no surface found.
        tilt: (N, 2) p1, p2: change of disparity over the inner half, to the right and down.
        residual: (N, G) disparity of a window minus the plane; NaN for windows that do not belong to the object.
        support: (N,) fraction of the windows with a minimum that belong to the object.
    """

    centre: FloatArray
    tilt: FloatArray
    residual: FloatArray
    support: FloatArray


def object_surface(
    disparity: FloatArray, weight: FloatArray, *, positions: tuple[FloatArray, FloatArray], prior: FloatArray
) -> Surface:
    """The plane through the object's windows.

    Args:
        disparity: (N, G) disparities > 0, px of the level.
        weight: (N, G) weights; 0 = no disparity.
        positions: u and v, (N, G) each.
        prior: (N,) the track's disparity, px of the level; NaN = unknown.
    """
    u, v = positions
    tolerance = np.maximum(_SAME_SURFACE_SHARE * disparity, _SAME_SURFACE_PX)
    # support(i) = sum over the windows j that agree with i, weighted by their distance from the lower middle
    near_object = weight * np.exp(-2.0 * u**2 - 2.0 * (v - _LOWER_MIDDLE) ** 2)
    agree = np.abs(disparity[:, None, :] - disparity[:, :, None]) <= tolerance[:, :, None] / 2
    support = np.where(weight > 0, (agree * near_object[:, None, :]).sum(axis=2), 0.0)
    from_prior = np.abs(disparity - prior[:, None]) / tolerance
    gain = _PRIOR_GAIN * np.exp(-np.square(np.minimum(from_prior, 9.0)))
    support *= np.where(np.isfinite(from_prior), 1.0 + gain, 1.0)
    best = np.take_along_axis(disparity, support.argmax(axis=1)[:, None], axis=1)
    is_inlier = (weight > 0) & (np.abs(disparity - best) <= np.maximum(_SAME_SURFACE_SHARE * best, _SAME_SURFACE_PX))
    central = np.exp(-(u**2 + v**2) / (2 * _CENTRE_SIGMA**2))
    plane, residual = _fit_planes(disparity, np.where(is_inlier, weight * central, 0.0), u, v)
    n_inliers, n_minima = is_inlier.sum(axis=1), np.maximum((weight > 0).sum(axis=1), 1)
    return Surface(
        centre=np.where(n_inliers >= _MIN_INLIERS, plane[:, 0], np.nan),
        tilt=plane[:, 1:],
        residual=np.where(is_inlier, residual, np.nan),
        support=n_inliers / n_minima,
    )


def _fit_planes(
    disparity: FloatArray, weight: FloatArray, u: FloatArray, v: FloatArray
) -> tuple[FloatArray, FloatArray]:
    """Planes p (N, 3) with the minimum weighted sum of bounded absolute residuals, and the residuals r (N, G).

    Each iteration solves (A^T W A + ridge) p = A^T W d with the rows (1, u, v) of A; the products of A and d do not
    change and are formed once.
    """
    a = np.stack([np.ones_like(u), u, v], axis=2)
    products = np.concatenate([a[..., _UPPER[0]] * a[..., _UPPER[1]], a * disparity[..., None]], axis=2)
    total = weight.sum(axis=1)
    ridge = np.eye(3) * (_RIDGE * total + 1e-12)[:, None, None]
    ridge[:, 0, 0] = 1e-12
    mean = (weight * disparity).sum(axis=1) / np.maximum(total, 1e-12)
    f = np.maximum(_FLOOR_SHARE * mean, _FLOOR_PX)[:, None]
    w = weight
    for _ in range(_N_ITERATIONS):
        sums = (w[:, None] @ products)[:, 0]
        p = np.linalg.solve(sums[:, _SYMMETRIC] + ridge, sums[:, len(_UPPER[0]) :, None])
        r = disparity - (a @ p)[..., 0]
        w = weight / (np.maximum(np.abs(r), f) * (1.0 + np.square(r / (_BOUND_FLOORS * f))))
    return p[..., 0], r
