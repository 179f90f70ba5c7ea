"""Census transform and matching cost of the windows of tiles at each disparity.

    xi(p)   = 24 bits; bit i = 1 if neighbour i in the 5 x 5 window of pixel p is brighter than p
    h(p, d) = Hamming distance of xi_left(p) and xi_right(p - (d, 0)): 0 .. 24, about 12 by chance
    C(w, d) = mean of h(p, d) over the pixels p of window w, bits per pixel

Only the order of grey values counts, so the exposure and gain of the cameras may differ (Zabih & Woodfill 1994).
"""

from __future__ import annotations

import numpy as np
import numpy.typing as npt
from numpy.lib.stride_tricks import sliding_window_view

from track_range.foundation.arrays import FloatArray32
from track_range.stereo.matching.tiles import MARGIN_PX, N_SIDE, N_WINDOWS, BoxTiles, Grey, window_sums

Census = npt.NDArray[np.uint32]
_REACH_PX = 2  # half the side of the census window, px
_SIDE = 2 * _REACH_PX + 1

_NEIGHBOURS = [(row, column) for row in range(_SIDE) for column in range(_SIDE) if (row, column) != (2, 2)]

_BITS_PER_BYTE = 8
_WORDS_AT_ONCE = 2**15  # words that are compared in one operation: 256 KiB, which fit into the processor's cache


def census(grey: Grey) -> Census:
    """(H - 4, W - 4, N) census words xi of N images (H, W, N), without their margin."""
    (height, width, n), rows = grey.shape, grey.reshape(len(grey), -1)  # columns of all images in one axis
    hw = height - _SIDE + 1, width - _SIDE + 1
    centre = rows[_REACH_PX:, _REACH_PX * n :][: hw[0], : hw[1] * n]
    words = np.zeros(centre.shape, np.uint32)
    brighter = np.empty(centre.shape, np.bool_)
    for first in range(0, len(_NEIGHBOURS), _BITS_PER_BYTE):  # bytes are four times as fast to shift as words
        byte = np.zeros(centre.shape, np.uint8)
        for row, column in _NEIGHBOURS[first : first + _BITS_PER_BYTE]:
            np.greater(rows[row:, column * n :][: hw[0], : hw[1] * n], centre, out=brighter)
            np.add(byte, byte, out=byte)
            np.add(byte, brighter.view(np.uint8), out=byte)
        words |= byte.astype(np.uint32) << np.uint32(first)
    return words.reshape(*hw, n)


def window_costs(tiles: BoxTiles) -> FloatArray32:
    """(D, G, N) costs C(w, d) of the windows, bits per pixel; NaN where the window is outside the right image."""
    n_disparities, (cell_height, cell_width) = tiles.n_disparities, tiles.shape.cell_hw
    (height, width), n = tiles.shape.hw, tiles.both.shape[2]
    margin = slice(MARGIN_PX - _REACH_PX, -(MARGIN_PX - _REACH_PX))
    xi = census(tiles.both[margin, margin])
    words = xi[0::2].astype(np.uint64)  # of two rows in one, because counting 64 bits is as fast as 32
    words |= xi[1::2].astype(np.uint64) << np.uint64(32)
    words = words.reshape(height // 2, -1)
    left = words[:, : width * n]
    # Views of the strip at each disparity, the smallest first, which is farthest to the right.
    right = sliding_window_view(words[:, (width + 2 * MARGIN_PX) * n :], width * n, axis=1)[:, ::-n].swapaxes(0, 1)
    row_pairs = np.empty((n_disparities, *left.shape), np.uint8)  # at most 2 rows of 24 bits
    differing = np.empty((max(_WORDS_AT_ONCE // left.size, 1), *left.shape), np.uint64)
    for first in range(0, n_disparities, len(differing)):
        part = right[first : first + len(differing)]
        np.bitwise_xor(left, part, out=differing[: len(part)])
        np.bitwise_count(differing[: len(part)], out=row_pairs[first : first + len(part)])
    bits = row_pairs.reshape(n_disparities, height // 2, width, n).astype(np.float32)
    cost = window_sums(bits, (cell_height // 2, cell_width))
    cost *= np.float32(1 / tiles.shape.window_px)
    _mark_unseen(cost, tiles)
    return np.asarray(cost.reshape(n_disparities, N_WINDOWS, n))


def _mark_unseen(cost: FloatArray32, tiles: BoxTiles) -> None:
    """Set costs (D, rows, columns, N) to NaN where the window is not entirely in the right image."""
    strip = tiles.is_seen[MARGIN_PX:-MARGIN_PX]
    if strip.all():
        return
    cell_width = tiles.shape.cell_hw[1]
    n_seen = np.cumsum(np.concatenate([np.zeros_like(strip[:1], np.int64), strip]), axis=0)
    start = np.arange(N_SIDE) * cell_width + np.arange(len(cost) - 1, -1, -1)[:, None]
    is_seen = n_seen[start + 2 * cell_width] - n_seen[start] == 2 * cell_width  # (D, columns, N)
    cost[np.broadcast_to(~is_seen[:, None], cost.shape)] = np.nan
