"""Census transform and matching cost of windows of the left image at each disparity.

    xi(p)   = 24 bits; bit i = 1 if neighbour i in the 5 x 5 window of pixel p is brighter than p
    h(p, d) = Hamming distance of xi_left(p) and xi_right(p - (d, 0)): 0 .. 24, about 12 by chance
    C(w, d) = mean of h(p, d) over the pixels p of window w, bits per pixel

Only the order of grey values counts, so the exposure and gain of the cameras may differ (Zabih & Woodfill 1994). Arrays
are (rows, columns, windows): with a long last axis, each comparison is one numpy pass over all windows of all boxes.
"""

from __future__ import annotations

import numpy as np
import numpy.typing as npt

from track_range.foundation.arrays import FloatArray32
from track_range.stereo.matching.sample_windows import MARGIN_PX, WINDOW_HW, BoxWindows, GreyLevels

Grey = npt.NDArray[np.uint8]
Census = npt.NDArray[np.uint32]

_SIDE = 2 * MARGIN_PX + 1
"""Side of the census window, px."""

_NEIGHBOURS = [(row, column) for row in range(_SIDE) for column in range(_SIDE) if row != 2 or column != 2]
"""Positions of the neighbours in the census window."""

_BITS_PER_BYTE = 8


def census(grey: Grey) -> Census:
    """(H - 4, W - 4, P) census words xi of P windows (H, W, P), without their margin."""
    height, width = grey.shape[0] - _SIDE + 1, grey.shape[1] - _SIDE + 1
    centre = grey[MARGIN_PX:, MARGIN_PX:][:height, :width]
    words = np.zeros(centre.shape, np.uint32)
    brighter = np.empty(centre.shape, np.bool_)
    for first in range(0, len(_NEIGHBOURS), _BITS_PER_BYTE):  # bytes are four times as fast to shift as words
        byte = np.zeros(centre.shape, np.uint8)
        for row, column in _NEIGHBOURS[first : first + _BITS_PER_BYTE]:
            np.greater(grey[row : row + height, column : column + width], centre, out=brighter)
            np.add(byte, byte, out=byte)
            np.bitwise_or(byte, brighter.view(np.uint8), out=byte)
        words |= byte.astype(np.uint32) << np.uint32(first)
    return words


def cost_curves(
    left: GreyLevels, right: GreyLevels, windows: BoxWindows, *, first: npt.NDArray[np.int64], n_disparities: int
) -> FloatArray32:
    """(D, N, G) costs C(w, d) of each box's windows, bits per pixel; NaN where the window is outside the right image.

    Index k along the first axis is the disparity first[n] + k of box n, in pixels of the box's level.
    """
    height, width = WINDOW_HW
    left_words = _row_pairs(census(left.windows(windows, windows.column, width=width)))
    # The strip in the right image starts at the position of the window for the largest disparity.
    strip_column = windows.column - (first + n_disparities - 1)[:, None]
    right_words = _row_pairs(census(right.windows(windows, strip_column, width=width + n_disparities - 1)))
    cost = np.empty((n_disparities, *windows.column.shape), np.float32)
    for k in range(n_disparities):
        start = n_disparities - 1 - k
        hamming = np.bitwise_count(left_words ^ right_words[:, start : start + width])
        column_sum = hamming.sum(axis=0, dtype=np.uint8)  # 7 pixels of at most 24 bits
        cost[k] = column_sum.sum(axis=0, dtype=np.uint16).reshape(windows.column.shape)
    cost /= height * width
    right_column = windows.column - (first + np.arange(n_disparities)[:, None])[..., None]
    last_column = (right.width[windows.level] - MARGIN_PX - width)[:, None]
    cost[(right_column < MARGIN_PX) | (right_column > last_column)] = np.nan
    return cost


def _row_pairs(words: Census) -> npt.NDArray[np.uint64]:
    """(ceil(H / 2), W, P) words of two rows in one, because counting 64 bits is as fast as 32."""
    paired = words[0::2].astype(np.uint64)
    paired[: len(words) // 2] |= words[1::2].astype(np.uint64) << np.uint64(32)
    return paired
