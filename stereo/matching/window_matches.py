"""Disparities of the windows of tiles: census costs, and semi-global matching on the grid of a tile's windows.

    xi(p)   = 24 bits; bit i = 1 if neighbour i in the 5 x 5 window of pixel p is brighter than p
    h(p, d) = Hamming distance of xi_left(p) and xi_right(p - (d, 0)): 0 .. 24, about 12 by chance
    C(w, d) = mean of h(p, d) over the pixels p of window w, bits per pixel

Only the order of grey values counts, so the exposure and gain of the cameras may differ (Zabih & Woodfill 1994). The
cost of a path that reaches window w at disparity d, from the left, right, above or below (Hirschmueller 2008); v is the
window before:

    L(w, d) = C(w, d) + min(L(v, d), L(v, d - 1) + P1, L(v, d + 1) + P1, min_i L(v, i) + P2) - min_i L(v, i)
    S(w, d) = sum of L(w, d) over the four paths

A window without a clear minimum, on glass or paint, takes the minimum of its neighbours through S. The disparity is the
minimum of the window's cost C next to the minimum of S, with a V-shaped (equiangular) fit between pixels, because a sum
of absolute differences is linear on both sides of the minimum (Shimizu & Okutomi 2005). S is not interpolated: the
steps P1 bias it to whole pixels.
"""

import math
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt
from numpy.lib.stride_tricks import sliding_window_view

from track_range.foundation.arrays import FloatArray, FloatArray32, IntArray
from track_range.stereo.matching.tiles import MARGIN_PX, N_CELLS, N_SIDE, N_WINDOWS, BoxTiles, Grey

Census = npt.NDArray[np.uint32]
_REACH_PX = 2  # half the side of the census window, px
_SIDE = 2 * _REACH_PX + 1
_NEIGHBOURS = [
    (row, column) for row in range(_SIDE) for column in range(_SIDE) if (row, column) != (2, 2)
]

_BITS_PER_BYTE = 8
# words that are compared in one operation: 256 KiB, which fit into the processor's cache
_WORDS_AT_ONCE = 2**15
# P1: cost of a step of one disparity between neighbouring windows, bits per pixel
_P1_BITS = np.float32(1.5)
# P2: cost of any larger step; about the margin between a good minimum and a chance match
_P2_BITS = np.float32(6.0)
# cost of a window outside the right image: neither a match nor a contradiction
_UNSEEN_BITS = np.float32(8.0)


def census(grey: Grey) -> Census:
    """(H - 4, W - 4, N) census words xi of N images (H, W, N), without their margin."""
    # columns of all images in one axis
    (height, width, n), rows = grey.shape, grey.reshape(len(grey), -1)
    hw = height - _SIDE + 1, width - _SIDE + 1
    centre = rows[_REACH_PX:, _REACH_PX * n :][: hw[0], : hw[1] * n]
    words = np.zeros(centre.shape, np.uint32)
    brighter = np.empty(centre.shape, np.bool_)
    # bytes are four times as fast to shift as words
    for first in range(0, len(_NEIGHBOURS), _BITS_PER_BYTE):
        byte = np.zeros(centre.shape, np.uint8)
        for row, column in _NEIGHBOURS[first : first + _BITS_PER_BYTE]:
            np.greater(rows[row:, column * n :][: hw[0], : hw[1] * n], centre, out=brighter)
            np.add(byte, byte, out=byte)
            np.add(byte, brighter.view(np.uint8), out=byte)
        words |= byte.astype(np.uint32) << np.uint32(first)
    return words.reshape(*hw, n)


def window_costs(tiles: BoxTiles) -> FloatArray32:
    """(D, G, N) costs C(w, d) of the windows, bits per pixel; NaN where the window is outside the
    right image.
    """
    n_disparities, (cell_height, cell_width) = tiles.n_disparities, tiles.shape.cell_hw
    (height, width), n = tiles.shape.hw, tiles.both.shape[2]
    margin = slice(MARGIN_PX - _REACH_PX, -(MARGIN_PX - _REACH_PX))
    xi = census(tiles.both[margin, margin])
    # of two rows in one, because counting 64 bits is as fast as 32
    words = xi[0::2].astype(np.uint64)
    words |= xi[1::2].astype(np.uint64) << np.uint64(32)
    words = words.reshape(height // 2, -1)
    left = words[:, : width * n]
    # Views of the strip at each disparity, the smallest first, which is farthest to the right.
    right = sliding_window_view(words[:, (width + 2 * MARGIN_PX) * n :], width * n, axis=1)[
        :, ::-n
    ].swapaxes(0, 1)
    row_pairs = np.empty((n_disparities, *left.shape), np.uint8)  # at most 2 rows of 24 bits
    differing = np.empty((max(_WORDS_AT_ONCE // left.size, 1), *left.shape), np.uint64)
    for first in range(0, n_disparities, len(differing)):
        part = right[first : first + len(differing)]
        np.bitwise_xor(left, part, out=differing[: len(part)])
        np.bitwise_count(differing[: len(part)], out=row_pairs[first : first + len(part)])
    bits = row_pairs.reshape(n_disparities, height // 2, -1)
    cells = bits if cell_height == 2 else bits[:, 0::2] + bits[:, 1::2]
    # of windows, in bytes until here: at most 4 x 48 bits
    columns = (cells[:, :-1] + cells[:, 1:]).astype(np.uint16)
    columns = columns.reshape(n_disparities * N_SIDE, N_CELLS, -1)
    if cell_width == 6:
        columns = columns[..., : 3 * n] + columns[..., 3 * n :]
    sums = columns[..., :n] + columns[..., n : 2 * n]
    sums += columns[..., 2 * n :]
    cost = (sums[:, :-1] + sums[:, 1:]) * np.float32(1 / tiles.shape.window_px)
    cost = cost.reshape(n_disparities, N_SIDE, N_SIDE, n)
    strip = tiles.is_seen[MARGIN_PX:-MARGIN_PX]
    if not strip.all():  # NaN where the window is not entirely in the right image
        n_seen = np.cumsum(np.concatenate([np.zeros_like(strip[:1], np.int64), strip]), axis=0)
        start = np.arange(N_SIDE) * cell_width + np.arange(n_disparities - 1, -1, -1)[:, None]
        # (D, columns, N)
        is_seen = n_seen[start + 2 * cell_width] - n_seen[start] == 2 * cell_width
        cost[np.broadcast_to(~is_seen[:, None], cost.shape)] = np.nan
    return np.asarray(cost.reshape(n_disparities, N_WINDOWS, n))


@dataclass(frozen=True, slots=True)
class WindowMatches:
    """Disparities of G windows of each of N boxes."""

    index: FloatArray  # (N, G) disparity in steps of the costs, between the first and the last one
    # (N, G) slope of the sides of the minimum, bits per pixel and step; 0 = no minimum, or outside
    # the right image
    slope: FloatArray
    cost: FloatArray  # (N, G) cost at the minimum, bits per pixel


def match_windows(cost: FloatArray32) -> WindowMatches:
    """The disparity of each window from costs (D, G, N), bits per pixel, with D >= 3; NaN = outside
    the right image.
    """
    c = np.where(np.isfinite(cost), cost, _UNSEEN_BITS)
    last = len(cost) - 2
    # it has a neighbour on both sides
    d = np.minimum(np.maximum(_path_costs(c).argmin(axis=0), 1), last)
    before, at, after = _at(c, d - 1), _at(c, d), _at(c, d + 1)
    is_before = (before <= at) & (before <= after)
    d = np.minimum(np.maximum(d - is_before + ((after < at) & ~is_before), 1), last)
    c_minus, c_0, c_plus = _at(cost, d - 1), _at(cost, d), _at(cost, d + 1)
    slope = np.maximum(c_minus, c_plus) - c_0
    # False where one of the three is NaN
    is_minimum = (c_0 <= np.minimum(c_minus, c_plus)) & (slope > 0)
    offset = np.where(is_minimum, (c_minus - c_plus) / np.where(is_minimum, 2 * slope, 1.0), 0.0)
    return WindowMatches(
        index=(d + offset).T.astype(np.float64),
        slope=np.where(is_minimum, slope, 0.0).T.astype(np.float64),
        cost=_at(c, d).T.astype(np.float64),
    )


def _at(values: FloatArray32, index: IntArray) -> FloatArray32:
    """(G, N) values of (D, G, N) at an index (G, N); takes a third of `take_along_axis`'s time."""
    flat = index * index.size + np.arange(index.size).reshape(index.shape)
    return np.asarray(values.reshape(-1).take(flat), np.float32)


def _path_costs(c: FloatArray32) -> FloatArray32:
    """S (D, G, N): the sum of the four paths' costs L, from costs C (D, G, N)."""
    n_disparities, n_windows, n = c.shape
    side = math.isqrt(n_windows)
    rows = c.reshape(n_disparities, side, side, n)
    columns = rows.swapaxes(1, 2)
    # L of all paths at once: (step along the path, D + a border of infinity, path direction,
    # parallel paths, N)
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
