"""A smooth surface through the disparities of windows: a plane with a small curvature.

    d(u, v) = p0 + p1 u + p2 v + p3 u^2 + p4 v^2      u, v: position relative to the box's centre, in box sizes

The fit minimises the weighted absolute residuals r, bounded beyond a few times a floor f, by iteratively reweighted
least squares with the weights

    w_i = w / (max(|r_i| / f, 1) (1 + (r_i / (2 f))^2))

The curvature has the prior N(0, (c d)^2): cars are rounded, but few windows do not show how much. p0 is the disparity
at the box's centre, also of a car seen obliquely.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from track_range.foundation.arrays import FloatArray

# f: residual below which windows have equal weights, as a fraction of the mean disparity, and its minimum in px.
_FLOOR_FRACTION, _FLOOR_PX = 0.015, 0.05
_BOUND_FLOORS = 2.0  # residual, in units of f, at which a window counts half of what it would without the bound
_RIDGE = 4e-3  # on the tilt p1, p2, relative to the total weight: for windows that nearly coincide
# c: prior standard deviation of p3 and p4 as a fraction of the disparity; 1.5 % at the edge of the box's inner half.
# Fitted on simulated drives (seeds 0-2) and on the accuracy at the centre of KITTI 2015's given pairs.
_CURVATURE = 0.25
_OVERLAP = 4.0  # number of windows that contain a pixel: their errors are correlated, so the prior counts as much more


@dataclass(frozen=True, slots=True)
class SurfaceFit:
    """Surfaces of N boxes; disparities in px of the tile."""

    p: FloatArray  # (..., N, 5) coefficients p0 .. p4, with p0 relative to index 0 of the costs

    def at(self, u: FloatArray, v: FloatArray) -> FloatArray:
        """(..., N, G) disparities at positions (N, G), or broadcastable to that."""
        p = self.p[..., None, :]
        return np.asarray(p[..., 0] + u * (p[..., 1] + p[..., 3] * u) + v * (p[..., 2] + p[..., 4] * v))


def surface_terms(u: FloatArray, v: FloatArray) -> FloatArray:
    """(N, G, 5) rows of A, the terms 1, u, v, u^2 and v^2, at positions u and v, (N, G) each."""
    return np.stack([np.ones_like(u), u, v, u * u, v * v], axis=2)


def fit_surfaces(
    index: FloatArray,
    weight: FloatArray,
    terms: FloatArray,
    *,
    disparity: FloatArray,
    is_curved: bool = False,
    n_iterations: int = 4,
) -> SurfaceFit:
    """The surfaces through disparities `index` with weights (..., N, G), px of the tile; 0 = not part of it.

    Each iteration solves (A^T W A + ridge) p = A^T W d with the rows (1, u, v, u^2, v^2) of A.

    Args:
        index: (N, G) or (..., N, G) disparities relative to any disparity of the box, for example index 0 of the costs.
        weight: 1 / variance of the windows.
        terms: (N, G, 5) A.
        disparity: (..., N) disparity of the box, px of the tile, for the scale of residuals and curvature.
        is_curved: whether the curvature is fitted; False = a plane.
        n_iterations: of the reweighted least squares.
    """
    n_parameters = 5 if is_curved else 3
    a = np.ascontiguousarray(terms[..., :n_parameters])
    transposed = np.ascontiguousarray(a.swapaxes(1, 2))
    total = weight.sum(axis=-1)
    reference = (weight * index).sum(axis=-1) / np.maximum(total, 1e-12)
    d = (index - reference[..., None])[..., None]
    diagonal = np.full((*total.shape, n_parameters), 1e-9)
    diagonal[..., 1:3] += (_RIDGE * total)[..., None]
    if is_curved:
        diagonal[..., 3:] += (_OVERLAP / np.square(_CURVATURE * disparity))[..., None]
    ridge = diagonal[..., None] * np.eye(n_parameters)
    inverse_f = 1.0 / np.maximum(_FLOOR_FRACTION * disparity, _FLOOR_PX)[..., None]
    w = weight
    for iteration in range(n_iterations):
        weighted = transposed * w[..., None, :]
        p = np.linalg.solve(weighted @ a + ridge, weighted @ d)
        if iteration < n_iterations - 1:
            r = np.abs(d - a @ p)[..., 0] * inverse_f
            w = weight / (np.maximum(r, 1.0) * (1.0 + np.square(r * (1.0 / _BOUND_FLOORS))))
    coefficients = np.zeros((*total.shape, 5))
    coefficients[..., :n_parameters] = p[..., 0]
    coefficients[..., 0] += reference
    return SurfaceFit(coefficients)
