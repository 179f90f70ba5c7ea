"""Disparities of the windows of tiles: census costs, and semi-global matching on the grid of a tile's windows.

    xi(p)   = 16 bits; bit i = 1 if neighbour i of pixel p is brighter than p
    h(p, d) = 1.5 times the Hamming distance of xi_left(p) and xi_right(p - (d, 0)): 0 .. 24, about 12 by chance
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

from track_range.foundation.arrays import FloatArray, FloatArray32
from track_range.stereo.matching.tiles import MARGIN_PX, N_CELLS, N_SIDE, N_WINDOWS, BoxTiles, Grey

Census = npt.NDArray[np.uint16]
_REACH_PX = 2  # half the side of the census window, px
# (column, row) of the neighbours: all 8, and every second one of the 16 around these
_NEIGHBOURS = [
    (column, row)
    for column in range(-_REACH_PX, _REACH_PX + 1)
    for row in range(-_REACH_PX, _REACH_PX + 1)
    if max(abs(column), abs(row)) == 1
    or (max(abs(column), abs(row)) == _REACH_PX and column % 2 == row % 2 == 0)
]
_BITS_PER_BYTE = 8
# factor on counted bits: costs are in bits of the 24 that all neighbours have
_BITS_SCALE = 24 / len(_NEIGHBOURS)
# words that are compared in one operation: 256 KiB, which fit into the processor's cache
_WORDS_AT_ONCE = 2**15
# P1: cost of a step of one disparity between neighbouring windows, bits per pixel
_P1_BITS = np.float32(1.5)
# P2: cost of any larger step; about the margin between a good minimum and a chance match
_P2_BITS = np.float32(6.0)
_AROUND = np.arange(-2, 3)[:, None, None]  # steps of a disparity about the smallest sum of paths
_SMALLEST_SLOPE = np.float32(1e-6)  # for windows without a minimum
# cost of a window outside the right image: neither a match nor a contradiction
_UNSEEN_BITS = np.float32(8.0)


def census(grey: Grey) -> Census:
    """(W - 4, N, H) census words xi of N images (W, N, H), without the outer columns; those of the
    two outer rows at both ends have no meaning.
    """
    n_columns, n, height = grey.shape
    pixels, column = grey.reshape(-1), n * height
    words = np.zeros((n_columns - 2 * _REACH_PX, n, height), np.uint16)
    # In flat arrays, neighbours have constant offsets; those of outer rows are in other columns.
    first, last = _REACH_PX * column + _REACH_PX, len(pixels) - _REACH_PX * column - _REACH_PX
    centre, xi = pixels[first:last], words.reshape(-1)[_REACH_PX:-_REACH_PX]
    brighter = np.empty(centre.shape, np.bool_)
    # bytes are faster to shift than words
    for start in range(0, len(_NEIGHBOURS), _BITS_PER_BYTE):
        byte = np.zeros(centre.shape, np.uint8)
        for right, down in _NEIGHBOURS[start : start + _BITS_PER_BYTE]:
            offset = right * column + down
            np.greater(pixels[first + offset : last + offset], centre, out=brighter)
            np.add(byte, byte, out=byte)
            np.add(byte, brighter.view(np.uint8), out=byte)
        xi <<= np.uint16(_BITS_PER_BYTE)
        xi |= byte
    return words


def window_costs(tiles: BoxTiles) -> FloatArray32:
    """(D, G, N) costs C(w, d) of the windows, bits per pixel; NaN where the window is outside the
    right image.
    """
    n_disparities, (cell_height, cell_width) = tiles.n_disparities, tiles.shape.cell_hw
    width, n = tiles.shape.hw[1], tiles.both.shape[1]
    # one word of 32 or 64 bits for the rows of a cell: (columns without margins, N, 8)
    margin = MARGIN_PX // cell_height
    words = census(tiles.both).view(np.dtype(f"u{2 * cell_height}"))
    words = np.ascontiguousarray(words[:, :, margin:-margin])[MARGIN_PX - _REACH_PX :]
    left, strip = words[:width], words[width + 2 * MARGIN_PX :]
    # overlapping views (D, W, N, 8) of the strip, the smallest disparity first, which is farthest
    # to the right
    right = np.ndarray(
        (n_disparities, *left.shape),
        words.dtype,
        strip,
        offset=(n_disparities - 1) * strip.strides[0],
        strides=(-strip.strides[0], *strip.strides),
    )
    bits = np.empty((n_disparities, *left.shape), np.uint8)  # at most 64 in the rows of a cell
    differing = np.empty((max(_WORDS_AT_ONCE // left.size, 1), *left.shape), words.dtype)
    for first in range(0, n_disparities, len(differing)):
        part = right[first : first + len(differing)]
        np.bitwise_xor(left, part, out=differing[: len(part)])
        np.bitwise_count(differing[: len(part)], out=bits[first : first + len(part)])
    # sums of three columns fit into bytes, those of a window need two
    columns = bits.reshape(-1, cell_width // 3, 3, n * N_CELLS)
    thirds = columns[:, :, 0] + columns[:, :, 1]
    thirds += columns[:, :, 2]
    cells = thirds.astype(np.uint16)
    cells = cells[:, 0] + cells[:, 1] if cell_width == 6 else cells[:, 0]
    cells = cells.reshape(n_disparities, N_CELLS, n, N_CELLS)
    halves = cells[:, :-1] + cells[:, 1:]
    # (D, columns, N, rows) -> (D, rows, columns, N)
    sums = (halves[..., :-1] + halves[..., 1:]).transpose(0, 3, 1, 2)
    cost = np.multiply(sums, np.float32(_BITS_SCALE / tiles.shape.window_px), order="C")
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
    n_windows = cost[0].size
    last = len(cost) - 2
    c = np.where(np.isnan(cost), _UNSEEN_BITS, cost)
    # it has a neighbour on both sides
    smallest = np.minimum(np.maximum(_path_costs(c).argmin(axis=0), 1), last)
    # (5, G, N) costs from two steps below to two steps above; the ends are not used beyond the range
    window = np.arange(n_windows).reshape(smallest.shape)
    place = smallest * n_windows + window + _AROUND * n_windows
    around = cost.reshape(-1).take(place, mode="clip")
    before, at, after = np.where(np.isnan(around), _UNSEEN_BITS, around)[1:4]
    is_before = (before <= at) & (before <= after)
    is_after = (after < at) & ~is_before
    d = np.minimum(np.maximum(smallest - is_before + is_after, 1), last)
    place = (d - smallest + 1) * n_windows + window + _AROUND[2:] * n_windows
    c_minus, c_0, c_plus = around.reshape(-1).take(place)
    slope = np.maximum(c_minus, c_plus) - c_0
    # False where one of the three is NaN
    is_minimum = (c_0 <= np.minimum(c_minus, c_plus)) & (slope > 0)
    slope = np.where(is_minimum, slope, np.float32(0.0))
    difference = np.where(is_minimum, c_minus - c_plus, np.float32(0.0))
    offset = difference / np.maximum(2 * slope, _SMALLEST_SLOPE)
    values = np.array([d + offset, slope, np.where(np.isnan(c_0), _UNSEEN_BITS, c_0)])
    return WindowMatches(*np.ascontiguousarray(values.swapaxes(1, 2)))


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
        # From here on L is relative to its minimum, which changes the sum of all d alike.
        l_v[1:-1] -= l_v[1:-1].min(axis=0)
        step = np.minimum(l_v[:-2], l_v[2:])
        step += _P1_BITS
        np.minimum(step, l_v[1:-1], out=step)
        np.minimum(step, _P2_BITS, out=step)
        l_w[1:-1] += step
    right, left, down, up = path[:, 1:-1].transpose(2, 1, 3, 0, 4)
    total = np.empty(rows.shape, np.float32)
    np.add(right, left[:, :, ::-1], out=total)
    by_column = total.swapaxes(1, 2)
    by_column += down
    by_column += up[:, :, ::-1]
    return total.reshape(c.shape)
