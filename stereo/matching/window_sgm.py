"""Semi-global matching (Hirschmueller 2008) on the grid of a tile's windows instead of on pixels.

The cost of a path that reaches window w at disparity d, from the left, right, above or below; v is the window before:

    L(w, d) = C(w, d) + min(L(v, d), L(v, d - 1) + P1, L(v, d + 1) + P1, min_i L(v, i) + P2) - min_i L(v, i)
    S(w, d) = sum of L(w, d) over the four paths

A window without a clear minimum, on glass or paint, takes that of its neighbours through S. The disparity is the
minimum of the window's cost C next to the minimum of S, with a V-shaped (equiangular) fit between pixels, because a sum
of absolute differences is linear on both sides of the minimum (Shimizu & Okutomi 2005). S is not interpolated: the
steps P1 bias it to whole pixels.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from track_range.foundation.arrays import FloatArray, FloatArray32, IntArray

_P1_BITS = np.float32(1.5)  # P1: cost of a step of one disparity between neighbouring windows, bits per pixel
_P2_BITS = np.float32(6.0)  # P2: cost of any larger step; about the margin between a good minimum and a chance match
_UNSEEN_BITS = np.float32(8.0)  # cost of a window outside the right image: neither a match nor a contradiction


@dataclass(frozen=True, slots=True)
class WindowMatches:
    """Disparities of G windows of each of N boxes."""

    index: FloatArray  # (N, G) disparity in steps of the costs, between the first and the last one
    # (N, G) slope of the sides of the minimum, bits per pixel and step; 0 = no minimum, or outside the right image
    slope: FloatArray
    cost: FloatArray  # (N, G) cost at the minimum, bits per pixel


def match_windows(cost: FloatArray32) -> WindowMatches:
    """The disparity of each window from costs (D, G, N), bits per pixel, with D >= 3; NaN = outside the right image."""
    c = np.where(np.isfinite(cost), cost, _UNSEEN_BITS)
    last = len(cost) - 2
    d = np.minimum(np.maximum(_path_costs(c).argmin(axis=0), 1), last)  # it has a neighbour on both sides
    before, at, after = _at(c, d - 1), _at(c, d), _at(c, d + 1)
    is_before = (before <= at) & (before <= after)
    d = np.minimum(np.maximum(d - is_before + ((after < at) & ~is_before), 1), last)
    c_minus, c_0, c_plus = _at(cost, d - 1), _at(cost, d), _at(cost, d + 1)
    slope = np.maximum(c_minus, c_plus) - c_0
    is_minimum = (c_0 <= np.minimum(c_minus, c_plus)) & (slope > 0)  # False where one of the three is NaN
    offset = np.where(is_minimum, (c_minus - c_plus) / np.where(is_minimum, 2 * slope, 1.0), 0.0)
    return WindowMatches(
        index=(d + offset).T.astype(np.float64),
        slope=np.where(is_minimum, slope, 0.0).T.astype(np.float64),
        cost=_at(c, d).T.astype(np.float64),
    )


def _at(values: FloatArray32, index: IntArray) -> FloatArray32:
    """(G, N) values of (D, G, N) at an index (G, N); a third of the time of `take_along_axis`."""
    flat = index * index.size + np.arange(index.size).reshape(index.shape)
    return np.asarray(values.reshape(-1).take(flat), np.float32)


def _path_costs(c: FloatArray32) -> FloatArray32:
    """S (D, G, N): the sum of the four paths' costs L, from costs C (D, G, N)."""
    n_disparities, n_windows, n = c.shape
    side = math.isqrt(n_windows)
    rows = c.reshape(n_disparities, side, side, n)
    columns = rows.swapaxes(1, 2)
    # L of all paths at once: (step along the path, D + a border of infinity, path direction, parallel paths, N)
    path = np.empty((side, n_disparities + 2, 4, side, n), np.float32)
    path[:, 0], path[:, -1] = np.inf, np.inf
    for direction, costs in enumerate((rows, rows[:, :, ::-1], columns, columns[:, :, ::-1])):
        path[:, 1:-1, direction] = costs.transpose(2, 0, 1, 3)
    for l_w, l_v in zip(path[1:], path[:-1], strict=True):
        least = l_v[1:-1].min(axis=0)
        step = np.minimum(l_v[:-2], l_v[2:])
        step += _P1_BITS
        np.minimum(step, l_v[1:-1], out=step)
        np.minimum(step, least + _P2_BITS, out=step)
        step -= least
        l_w[1:-1] += step
    right, left, down, up = path[:, 1:-1].transpose(2, 1, 3, 0, 4)
    total = np.empty(rows.shape, np.float32)
    np.add(right, left[:, :, ::-1], out=total)
    by_column = total.swapaxes(1, 2)
    by_column += down
    by_column += up[:, :, ::-1]
    return total.reshape(c.shape)
