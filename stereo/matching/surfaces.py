"""The surfaces that a box shows, of the object and in front of and behind it: groups of windows on
a plane.

Windows vote for a disparity: the support of a window is the number of windows that agree with it;
windows in the lower middle of the box count most. The window with the largest support is the first
surface; a plane through the windows that agree with it decides which windows belong to it. The
remaining windows vote again, for the next surface.

    d(u, v) = p0 + p1 u + p2 v + p3 u^2 + p4 v^2      u, v: position relative to the box's centre, in box sizes

The fit of a surface, a plane with a small curvature, minimises the weighted absolute residuals r,
bounded beyond a few times a floor f, by iteratively reweighted least squares with the weights

    w_i = w / (max(|r_i| / f, 1) (1 + (r_i / (2 f))^2))

The curvature has the prior N(0, (c d)^2): cars are rounded, but few windows do not show how much.
p0 is the disparity at the box's centre, also of a car seen obliquely.
"""

from dataclasses import dataclass
from typing import Protocol

import numpy as np

from track_range.foundation.arrays import BoolArray, FloatArray
from track_range.stereo.matching.tiles import BoxTiles
from track_range.stereo.matching.window_matches import WindowMatches

# f: residual below which windows have equal weights, as a fraction of the mean disparity, and its
# minimum in px.
_FLOOR_FRACTION, _FLOOR_PX = 0.015, 0.05
# residual, in units of f, at which a window counts half of what it would without the bound
_BOUND_FLOORS = 2.0
_RIDGE = 4e-3  # on the tilt p1, p2, relative to the total weight: for windows that nearly coincide
_SMALLEST_RIDGE = 1e-9  # on all parameters of a plane, for boxes without windows
# c: prior standard deviation of p3 and p4 as a fraction of the disparity; 1.5 % at the edge of the
# box's inner half. Fitted on simulated drives (seeds 0-2) and on the accuracy at the centre of
# KITTI 2015's given pairs.
_CURVATURE = 0.25
# number of windows that contain a pixel: their errors are correlated, so the prior counts as much
# more
_OVERLAP = 4.0
N_SURFACES = 3  # largest number of surfaces per box, S
_SAME_SURFACE_FRACTION = 0.15  # largest relative difference of the disparities of one surface
_SAME_SURFACE_PX = 0.75  # its minimum, px of the tile
_ON_PLANE = 0.75  # largest distance from the plane, as a fraction of that difference
# minimum fraction of the windows of a surface on its plane; otherwise it is not a plane
_MIN_ON_PLANE = 0.8
# iterations of the fit of a plane to windows that agree; of a fit to the first surface's windows on
# this plane, from which it grows along the plane
_N_FIT_ITERATIONS, _N_GROWTH_ITERATIONS = 3, 1
# of the Gaussian weight about the box's centre, in box sizes: the corners of cars are rounded
_CENTRE_SIGMA = 0.2
# v of the most likely position of the object, in box sizes: objects touch the box's lower edge
_LOWER_MIDDLE = 0.125
# minimum number of windows that a plane is fitted to, one more than its parameters
_MIN_WINDOWS = 4
_FULL_COST_BITS = 6.0  # cost up to which a window counts fully, bits per pixel
_NO_MATCH_BITS = 10.0  # cost from which it counts as a chance match, which has 12


class BoxWindows(Protocol):
    """G windows of each of N boxes: `BoxTiles`, or those of a dense map."""

    @property
    def u(self) -> FloatArray:
        """(N, G) position to the right of the box's centre, in box widths."""
        ...

    @property
    def v(self) -> FloatArray:
        """(N, G) position below the box's centre, in box heights."""
        ...

    @property
    def is_used(self) -> BoolArray:
        """(N, G) windows inside the box and the image."""
        ...

    @property
    def first(self) -> FloatArray:
        """(N,) disparity of index 0, px of the tile."""
        ...

    @property
    def first_px(self) -> FloatArray:
        """(N,) the same in px of the image."""
        ...

    @property
    def scale(self) -> FloatArray:
        """(2, N) px of the image per px of the tile, in x and in y."""
        ...


@dataclass(frozen=True, slots=True)
class SurfaceFit:
    """Surfaces of N boxes; disparities in px of the tile."""

    p: FloatArray  # (..., N, 5) coefficients p0 .. p4, with p0 relative to index 0 of the costs

    def at(self, u: FloatArray, v: FloatArray) -> FloatArray:
        """(..., N, G) disparities at positions (N, G), or arrays that can be broadcast to this
        shape.
        """
        p = self.p[..., None, :]
        return np.asarray(
            p[..., 0] + u * (p[..., 1] + p[..., 3] * u) + v * (p[..., 2] + p[..., 4] * v)
        )

    def at_terms(self, terms: FloatArray) -> FloatArray:
        """(..., N, G) disparities at the positions of terms (N, 5, G) of `surface_terms`."""
        return np.asarray((self.p[..., None, :] @ terms)[..., 0, :])


def surface_terms(u: FloatArray, v: FloatArray) -> FloatArray:
    """(N, 5, G) columns of A, the terms 1, u, v, u^2 and v^2, at positions u and v, (N, G) each."""
    terms = np.ones((len(u), 5, u.shape[1]))
    terms[:, 1], terms[:, 2] = u, v
    np.square(terms[:, 1:3], out=terms[:, 3:])
    return terms


def fit_surfaces(
    index: FloatArray,
    weight: FloatArray,
    terms: FloatArray,
    *,
    disparity: FloatArray,
    is_curved: bool = False,
    n_iterations: int = 4,
    start: SurfaceFit | None = None,
) -> SurfaceFit:
    """The surfaces through disparities `index` with weights (..., N, G), px of the tile; 0 = not
    part of a surface.

    Each iteration solves (A^T W A + ridge) p = A^T W d with the rows (1, u, v, u^2, v^2) of A.

    `index` (N, G) is relative to any disparity of the box, such as index 0 of the costs; `weight`
    is 1 / variance of the windows, `terms` (N, 5, G) A^T, and `disparity` (..., N) the box's
    disparity, px of the tile, for the scale of residuals and curvature. Without `is_curved`, a
    plane is fitted. `start` are surfaces near the result, from whose residuals W follows first.
    """
    n_parameters = 5 if is_curved else 3
    transposed = terms[:, :n_parameters]
    a_and_d = np.concatenate([transposed, index[:, None]], axis=1).swapaxes(1, 2)
    a = a_and_d[..., :-1]
    ridge = np.zeros((*weight.shape[:-1], n_parameters, n_parameters))
    ridge[..., 0, 0] = _SMALLEST_RIDGE
    ridge[..., 1, 1] = ridge[..., 2, 2] = _RIDGE * weight.sum(axis=-1) + _SMALLEST_RIDGE
    if is_curved:
        ridge[..., 3, 3] = ridge[..., 4, 4] = _OVERLAP / np.square(_CURVATURE * disparity)
    inverse_f = 1.0 / np.maximum(_FLOOR_FRACTION * disparity, _FLOOR_PX)[..., None]
    w, p = weight, np.zeros(0) if start is None else start.p[..., :n_parameters, None]
    for iteration in range(n_iterations):
        if start is not None or iteration:
            r = np.abs(index - (a @ p)[..., 0]) * inverse_f
            w = weight / (np.maximum(r, 1.0) * (1.0 + np.square(r * (1.0 / _BOUND_FLOORS))))
        equations = (transposed * w[..., None, :]) @ a_and_d  # A^T W A, and A^T W d beside it
        p = np.linalg.solve(equations[..., :-1] + ridge, equations[..., -1:])
    coefficients = np.zeros((*weight.shape[:-1], 5))
    coefficients[..., :n_parameters] = p[..., 0]
    return SurfaceFit(coefficients)


@dataclass(frozen=True, slots=True)
class Surfaces:
    """S surfaces of each of N boxes, in order of decreasing support."""

    is_member: BoolArray  # (S, N, G) windows of each surface; none = the box shows fewer surfaces
    # (S, N) disparity at the box's centre relative to index 0 of the costs, px of the tile; NaN =
    # none
    centre: FloatArray
    disparity: FloatArray  # (S, N) the same, from 0
    planes: SurfaceFit  # their planes


def window_weights(matches: WindowMatches, tiles: BoxTiles) -> FloatArray:
    """(N, G) weights of windows: the slope of the minimum, reduced for costs that a chance match
    could have.
    """
    resemblance = np.clip(
        (_NO_MATCH_BITS - matches.cost) / (_NO_MATCH_BITS - _FULL_COST_BITS), 0.0, 1.0
    )
    return np.asarray(np.where(tiles.is_used, matches.slope * resemblance, 0.0))


def centre_weights(u: FloatArray, v: FloatArray) -> FloatArray:
    """(N, G) Gaussian weights of windows at u and v about the box's centre."""
    return np.asarray(np.exp((u * u + v * v) * (-0.5 / _CENTRE_SIGMA**2)))


def find_surfaces(index: FloatArray, weight: FloatArray, tiles: BoxWindows) -> Surfaces:
    """The S surfaces with most support, from disparities (N, G) relative to index 0, px of the
    tile, and weights.

    The first surface grows along its plane before further surfaces are found in the rest; these
    grow together.
    """
    u, v = tiles.u, tiles.v
    tolerance = np.maximum(
        _SAME_SURFACE_FRACTION * (tiles.first[:, None] + index), _SAME_SURFACE_PX
    )
    near_object = np.exp(-8.0 * u**2 - 8.0 * (v - _LOWER_MIDDLE) ** 2)
    # (N, G, G); half of the bytes in 32 bits
    index_32 = index.astype(np.float32)
    distance = np.abs(index_32[:, None] - index_32[:, :, None])
    agree = (distance <= tolerance.astype(np.float32)[:, :, None]).astype(np.float32)
    central, terms = centre_weights(u, v), surface_terms(u, v)

    def most_supported(free: FloatArray) -> tuple[BoolArray, tuple[FloatArray, FloatArray]]:
        """Windows (N, G) that agree with the window of most support among the free windows, its
        disparity and its tolerance (N, 1).
        """
        vote = (free * near_object).astype(np.float32)
        support = np.where(free > 0, (agree @ vote[:, :, None])[..., 0], np.float32(0.0))
        best = support.argmax(axis=1) + first_window
        best_index, limit = index.take(best)[:, None], tolerance.take(best)[:, None]
        return (free > 0) & (np.abs(index - best_index) <= limit), (best_index, limit)

    def grown(
        is_member: BoolArray,
        free: FloatArray,
        at: tuple[FloatArray, FloatArray],
        start: SurfaceFit | None = None,
    ) -> tuple[BoolArray, SurfaceFit]:
        """Windows (..., N, G) on the planes through windows of surfaces, and the planes.

        `at` are the disparities and tolerances (..., N, 1) of the surfaces, `start` earlier planes.
        """
        best_index, limit = at
        plane = fit_surfaces(
            index,
            np.where(is_member, free * central, 0.0),
            terms,
            disparity=np.maximum(tiles.first + best_index[..., 0], 0.1),
            n_iterations=_N_FIT_ITERATIONS if start is None else _N_GROWTH_ITERATIONS,
            start=start,
        )
        n_windows = is_member.sum(axis=-1)
        is_few = n_windows < _MIN_WINDOWS
        if is_few.any():  # these have no tilt
            plane.p[is_few] = 0.0
            plane.p[is_few, 0] = best_index[is_few, 0]
        on_plane = (free > 0) & (np.abs(index - plane.at_terms(terms)) <= _ON_PLANE * limit)
        is_plane = on_plane.sum(axis=-1) >= _MIN_ON_PLANE * n_windows
        return np.where(is_plane[..., None], on_plane, is_member), plane

    first_window = np.arange(0, index.size, index.shape[1])
    is_first, first_at = most_supported(weight)
    is_first, plane = grown(is_first, weight, first_at)
    is_first, plane = grown(is_first, weight, first_at, plane)
    rest = free = np.where(is_first, 0.0, weight)
    others = []
    for _ in range(N_SURFACES - 1):
        others.append(most_supported(free))
        free = np.where(others[-1][0], 0.0, free)
    members, at = zip(*others, strict=True)
    best_index, limit = (np.stack(values) for values in zip(*at, strict=True))
    is_others, other_planes = grown(np.stack(members), rest, (best_index, limit))
    for later in range(1, len(is_others)):
        is_others[later] &= ~is_others[:later].any(axis=0)
    is_member = np.concatenate([is_first[None], is_others])
    p = np.concatenate([plane.p[None], other_planes.p])
    centre = np.where(is_member.any(axis=2), p[..., 0], np.nan)
    return Surfaces(is_member, centre, tiles.first + centre, SurfaceFit(p))
