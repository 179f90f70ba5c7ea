"""The surface that a box shows: windows' costs made to agree with their neighbours, and a plane through the object.

1. Semi-global matching (Hirschmueller 2008) on the grid of windows instead of on pixels: the cost of a path that
   reaches a window at disparity d, from the left, right, above and below,

       L(w, d) = C(w, d) + min(L(v, d), L(v, d +- 1) + P1, min L(v, .) + P2) - min L(v, .)        v: the window before

   A window on glass or bare paint has no minimum of its own, and takes its neighbours'.
2. The minimum of each window's own cost beside the one that was chosen so, refined between pixels by a V-shaped
   (equiangular) fit, since a sum of absolute differences falls off linearly on both sides (Shimizu & Okutomi 2005).
   The paths' costs are not refined: their steps pull towards whole pixels.
3. Where the windows are fine, the grey values themselves say more of the fraction of a pixel (`refinement.py`).
4. The windows that agree with most others, those in the lower middle counting most, are the object; what stands behind
   or before it is left aside. A plane d = p0 + p1 u + p2 v is fitted to them with the least sum of absolute
   differences, beyond which far ones hardly count, the middle counting most; p0 is the disparity at the box's centre,
   also of a car seen obliquely.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import TypeVar

import numpy as np
import numpy.typing as npt

from track_range.foundation.arrays import FloatArray, FloatArray32, IntArray

_Value = TypeVar("_Value", bound=np.generic)

_SMALL_STEP_BITS = 1.5
"""P1: cost of a step of one disparity between windows, bits per pixel."""

_LARGE_STEP_BITS = 6.0
"""P2: cost of any larger step; about as deep as a good window's minimum."""

_UNSEEN_BITS = 8.0
"""Cost of a window that the right eye does not see: neither a match nor a contradiction."""

_SAME_SURFACE_SHARE = 0.2
"""Windows within this share of the disparity belong to one object: at 10 m a car's length is 30 %."""

_SAME_SURFACE_PX = 1.5

_CENTRE_SHARE = 0.4
"""Windows count less by a Gaussian of this width, as a share of the inner half: cars' corners are rounded."""

_LOWER_MIDDLE = 0.25
"""Where the object is surest, down from the middle, as a share of the inner half: it stands on the box's lower edge."""

_PRIOR_GAIN = 2.0
"""A surface at the track's disparity counts three times."""

_N_FITS = 4
_FIT_FLOOR_SHARE = 0.01
_FIT_FLOOR_PX = 0.05
_FAR = 2.0
"""Windows that are this many times the floor off the plane count half of what they would, and farther ones hardly."""

_RIDGE = 1e-3

_PAIRS = np.triu_indices(3)
_SYMMETRIC = np.array([[0, 1, 2], [1, 3, 4], [2, 4, 5]])
"""Products of a plane's three terms, each once, and where they stand in the normal equations."""


@dataclass(frozen=True, slots=True)
class WindowMatches:
    """The disparity that each window of each box was given.

    Attributes:
        index: (N, G) along the cost's first axis, never an end of it.
        offset: (N, G) the minimum between indices, -0.5 .. 0.5 of census costs, -1 .. 1 of grey values.
        weight: (N, G) how much it counts; 0 = no minimum, or not seen. Of census costs, the slope of the minimum's
            sides, bits per pixel and disparity; of grey values (`refinement.py`), 1 / variance, px^-2.
    """

    index: IntArray
    offset: FloatArray
    weight: FloatArray


@dataclass(frozen=True, slots=True)
class Surface:
    """The object's surface in each box.

    Attributes:
        centre: (N,) disparity at the middle of the inner half; NaN where no surface was found.
        tilt: (N, 2) change of disparity over the inner half, to the right and down.
        residual: (N, G) windows less the plane; NaN for windows aside.
        support: (N,) share of the windows that belong to it, of those that have a minimum.
    """

    centre: FloatArray
    tilt: FloatArray
    residual: FloatArray
    support: FloatArray


def matched_windows(cost: FloatArray32) -> WindowMatches:
    """What each window's disparity is, from costs (D, N, G) with D >= 3, NaN = not seen."""
    known = np.where(np.isfinite(cost), cost, np.float32(_UNSEEN_BITS))
    last = len(cost) - 2
    chosen = np.clip(_agreed_costs(known).argmin(axis=0), 1, last)
    beside = np.stack([_at(known, chosen - 1), _at(known, chosen), _at(known, chosen + 1)])
    index = np.clip(chosen - 1 + beside.argmin(axis=0), 1, last)
    below, at, above = _at(cost, index - 1), _at(cost, index), _at(cost, index + 1)
    slope = np.maximum(below, above) - at
    is_minimum = (at <= np.minimum(below, above)) & (slope > 0)  # False where one of the three was not seen
    offset = (below - above) / np.where(is_minimum, 2 * slope, 1.0)
    return WindowMatches(index, np.where(is_minimum, offset, 0.0), np.where(is_minimum, slope, 0.0).astype(np.float64))


def _at(values: npt.NDArray[_Value], index: IntArray) -> npt.NDArray[_Value]:
    """(N, G) of (D, N, G); `take_along_axis` does the same three times as slowly."""
    flat = index * index.size + np.arange(index.size).reshape(index.shape)
    return np.asarray(values.reshape(-1).take(flat), values.dtype)


def _agreed_costs(cost: FloatArray32) -> FloatArray32:
    """(D, N, G) sum of the four paths' costs."""
    n_disparities, n_boxes, n_windows = cost.shape
    side = math.isqrt(n_windows)
    grid = cost.reshape(n_disparities, n_boxes, side, side)
    across = grid.swapaxes(2, 3)
    # (side, 4, D + 2, N, side): windows in order of the path, the four paths, disparities with a border, boxes, paths
    paths = np.full((side, 4, n_disparities + 2, n_boxes, side), np.float32(np.inf), np.float32)
    for k, ways in enumerate((grid, grid[..., ::-1], across, across[..., ::-1])):
        paths[:, k, 1:-1] = np.moveaxis(ways, -1, 0)
    for here, before in zip(paths[1:], paths[:-1], strict=True):
        least = before[:, 1:-1].min(axis=1, keepdims=True)
        step = np.minimum(before[:, :-2], before[:, 2:])
        step += np.float32(_SMALL_STEP_BITS)
        np.minimum(step, before[:, 1:-1], out=step)
        np.minimum(step, least + np.float32(_LARGE_STEP_BITS), out=step)
        step -= least
        here[:, 1:-1] += step
    forth, back, down, up = (np.moveaxis(paths[:, k, 1:-1], 0, -1) for k in range(4))
    total = forth + back[..., ::-1] + (down + up[..., ::-1]).swapaxes(2, 3)
    return np.asarray(total.reshape(cost.shape))


def object_surface(
    disparity: FloatArray, weight: FloatArray, *, places: tuple[FloatArray, FloatArray], prior: FloatArray
) -> Surface:
    """The plane through the object's windows, from (N, G) disparities > 0 with weights, 0 = none, and their places.

    prior: (N,) what the track had last; NaN = unknown.
    """
    tolerance = np.maximum(_SAME_SURFACE_SHARE * disparity, _SAME_SURFACE_PX)
    right, down = places
    middle = weight * np.exp(-2.0 * right**2 - 2.0 * (down - _LOWER_MIDDLE) ** 2)
    agree = np.abs(disparity[:, None, :] - disparity[:, :, None]) <= tolerance[:, :, None] / 2
    support = np.where(weight > 0, (agree * middle[:, None, :]).sum(axis=2), 0.0)
    away = np.abs(disparity - prior[:, None]) / tolerance
    support *= np.where(np.isfinite(away), 1.0 + _PRIOR_GAIN * np.exp(-np.square(np.minimum(away, 9.0))), 1.0)
    first = np.take_along_axis(disparity, support.argmax(axis=1)[:, None], axis=1)
    inlier = (weight > 0) & (np.abs(disparity - first) <= np.maximum(_SAME_SURFACE_SHARE * first, _SAME_SURFACE_PX))
    central = np.exp(-(right**2 + down**2) / (2 * _CENTRE_SHARE**2))
    plane, residual = _planes(disparity, np.where(inlier, weight * central, 0.0), right, down)
    found = inlier.sum(axis=1) >= 4
    n_minima = np.maximum((weight > 0).sum(axis=1), 1)
    return Surface(
        np.where(found, plane[:, 0], np.nan),
        plane[:, 1:],
        np.where(inlier, residual, np.nan),
        inlier.sum(axis=1) / n_minima,
    )


def _planes(
    disparity: FloatArray, weight: FloatArray, right: FloatArray, down: FloatArray
) -> tuple[FloatArray, FloatArray]:
    """(N, 3) planes with the least weighted sum of bounded absolute residuals, and (N, G) residuals; by reweighting."""
    design = np.stack([np.ones_like(right), right, down], axis=2)
    products = np.concatenate([design[..., _PAIRS[0]] * design[..., _PAIRS[1]], design * disparity[..., None]], axis=2)
    total = weight.sum(axis=1)
    ridge = np.eye(3) * (_RIDGE * total + 1e-12)[:, None, None]
    ridge[:, 0, 0] = 1e-12
    mean = (weight * disparity).sum(axis=1) / np.maximum(total, 1e-12)
    floor = np.maximum(_FIT_FLOOR_SHARE * mean, _FIT_FLOOR_PX)[:, None]
    share = weight
    for _ in range(_N_FITS):
        sums = (share[:, None] @ products)[:, 0]
        normal = sums[:, _SYMMETRIC] + ridge
        plane = np.linalg.solve(normal, sums[:, len(_PAIRS[0]) :, None])
        residual = disparity - (design @ plane)[..., 0]
        share = weight / (np.maximum(np.abs(residual), floor) * (1.0 + np.square(residual / (_FAR * floor))))
    return plane[..., 0], residual
