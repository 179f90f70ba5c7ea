"""The surfaces that a box shows: groups of windows on a common plane, the object's and those in front of and behind it.

Windows vote for a disparity: the support of a window is the number of windows that agree with it, those in the lower
middle of the box counting most. The window with the largest support is the first surface; a plane through the windows
that agree with it decides which windows belong to it. The others vote again, for the next surface.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from track_range.foundation.arrays import BoolArray, FloatArray, IntArray
from track_range.stereo.matching.surface_fit import SurfaceFit, fit_surfaces
from track_range.stereo.matching.tiles import BoxTiles
from track_range.stereo.matching.window_sgm import WindowMatches

N_SURFACES = 3
"""Largest number of surfaces per box, S."""

_SAME_SURFACE_SHARE, _SAME_SURFACE_PX = 0.15, 0.75
"""Largest difference of the disparities of one surface, as a fraction of the disparity, and its minimum in px of the
tile."""

_ON_PLANE = 0.75
"""Largest distance from the plane, as a fraction of that difference."""

_MIN_ON_PLANE = 0.8
"""Minimum number of windows on the plane, as a fraction of those that agree; otherwise the surface is not a plane."""

_N_GROWTHS = 2
"""Number of times that a plane is fitted to the first surface, and its windows selected: it grows along its plane."""

_CENTRE_SIGMA = 0.2
"""Standard deviation of the Gaussian weight about the box's centre, in box sizes: the corners of cars are rounded."""

_LOWER_MIDDLE = 0.125
"""v of the most likely position of the object, in box sizes: objects touch the box's lower edge."""

_MIN_WINDOWS = 4
"""Minimum number of windows that a plane is fitted to, one more than its parameters."""

_FULL_COST_BITS, _NO_MATCH_BITS = 6.0, 10.0
"""Cost up to which a window counts fully, and from which it counts as a chance match, bits per pixel of 12 by
chance."""


@dataclass(frozen=True, slots=True)
class Surfaces:
    """S surfaces of each of N boxes, those with most support first.

    Attributes:
        is_member: (S, N, G) windows of each surface; none = the box shows fewer surfaces.
        centre: (S, N) disparity at the box's centre relative to index 0 of the costs, px of the tile; NaN = none.
        disparity: (S, N) the same, from 0.
        planes: planes of the S surfaces.
    """

    is_member: BoolArray
    centre: FloatArray
    disparity: FloatArray
    planes: tuple[SurfaceFit, ...]

    @property
    def n_windows(self) -> FloatArray:
        """(S, N) number of windows of each surface."""
        return np.asarray(self.is_member.sum(axis=2, dtype=np.float64))


def window_weights(matches: WindowMatches, tiles: BoxTiles) -> FloatArray:
    """(N, G) weights of windows: the slope of the minimum, reduced for costs like those of chance matches."""
    resemblance = np.clip((_NO_MATCH_BITS - matches.cost) / (_NO_MATCH_BITS - _FULL_COST_BITS), 0.0, 1.0)
    return np.asarray(np.where(tiles.is_used, matches.slope * resemblance, 0.0))


def centre_weights(u: FloatArray, v: FloatArray) -> FloatArray:
    """(N, G) Gaussian weights of windows at u and v about the box's centre."""
    return np.asarray(np.exp(-(u**2 + v**2) / (2 * _CENTRE_SIGMA**2)))


def find_surfaces(index: FloatArray, weight: FloatArray, tiles: BoxTiles) -> Surfaces:
    """The S surfaces with most support.

    Args:
        index: (N, G) disparities of the windows relative to index 0, px of the tile.
        weight: (N, G) weights of the windows; 0 = no match.
        tiles: the boxes' tiles.
    """
    u, v = tiles.u, tiles.v
    tolerance = np.maximum(_SAME_SURFACE_SHARE * (tiles.first[:, None] + index), _SAME_SURFACE_PX)
    near_object = np.exp(-8.0 * u**2 - 8.0 * (v - _LOWER_MIDDLE) ** 2)
    agree = (np.abs(index[:, None, :] - index[:, :, None]) <= tolerance[:, :, None]).astype(np.float64)
    rest, members, planes = weight, [], []
    for number in range(N_SURFACES):
        rows = np.flatnonzero(rest.any(axis=1))
        is_member, plane = np.zeros(weight.shape, np.bool_), SurfaceFit(np.zeros((len(weight), 5)))
        if len(rows):
            is_member[rows], plane.p[rows] = _next_surface(
                index[rows],
                rest[rows],
                (rest * near_object)[rows],
                agree[rows],
                tolerance[rows],
                tiles,
                rows,
                n_growths=_N_GROWTHS if number == 0 else 1,
            )
        members.append(is_member)
        planes.append(plane)
        rest = np.where(is_member, 0.0, rest)
    is_surface = np.array(members)
    centre = np.array([np.where(m.any(axis=1), p.p[:, 0], np.nan) for m, p in zip(members, planes, strict=True)])
    return Surfaces(is_surface, centre, tiles.first + centre, tuple(planes))


def _next_surface(
    index: FloatArray,
    weight: FloatArray,
    vote: FloatArray,
    agree: FloatArray,
    tolerance: FloatArray,
    tiles: BoxTiles,
    rows: IntArray,
    *,
    n_growths: int,
) -> tuple[BoolArray, FloatArray]:
    """Windows (N, G) and coefficients (N, 5) of the surface with most support, of the boxes in `rows` (N,) of `tiles`.

    Args:
        index: (N, G) disparities.
        weight: (N, G) weights; 0 = no match, or part of an earlier surface.
        vote: (N, G) weights of the windows' votes.
        agree: (N, G, G) 1 = two windows agree.
        tolerance: (N, G) largest difference of two windows that agree.
        tiles: the tiles of all boxes.
        rows: boxes.
        n_growths: number of fits of a plane.
    """
    u, v, first = tiles.u[rows], tiles.v[rows], tiles.first[rows]
    support = np.where(weight > 0, (agree @ vote[:, :, None])[..., 0], 0.0)
    best = support.argmax(axis=1)[:, None]
    best_index, limit = np.take_along_axis(index, best, 1), np.take_along_axis(tolerance, best, 1)
    is_member = (weight > 0) & (np.abs(index - best_index) <= limit)
    disparity, fit_weight = np.maximum(first + best_index[:, 0], 0.1), weight * centre_weights(u, v)
    for _ in range(n_growths):
        plane = fit_surfaces(
            index, np.where(is_member, fit_weight, 0.0), positions=(u, v), disparity=disparity, n_iterations=3
        )
        has_few = is_member.sum(axis=1) < _MIN_WINDOWS
        plane.p[has_few] = 0.0
        plane.p[has_few, 0] = best_index[has_few, 0]
        on_plane = (weight > 0) & (np.abs(index - plane.at(u, v)) <= _ON_PLANE * limit)
        is_plane = on_plane.sum(axis=1) >= _MIN_ON_PLANE * is_member.sum(axis=1)
        is_member = np.where(is_plane[:, None], on_plane, is_member)
    return is_member, plane.p
