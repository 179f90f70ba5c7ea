"""Census transform and its cost: how badly small windows of the left image fit the right one at each disparity.

    census(x)  = 24 bits, bit i: is neighbour i of the 5 x 5 window brighter than x?     (Zabih & Woodfill 1994)
    bits(d, x) = number of bits in which left census(x) and right census(x - d) differ: 0 .. 24, about 12 by chance

Only the order of grey values counts, so exposure and gain of the two eyes may differ. Pixels come as (rows, columns,
windows): the last axis is long, which makes each comparison one pass of numpy over all windows of all boxes.
"""

from __future__ import annotations

import numpy as np
import numpy.typing as npt

from track_range.foundation.arrays import FloatArray32
from track_range.stereo.matching.sample_windows import MARGIN_PX, WINDOW_HW, BoxWindows, GreyLevels

Grey = npt.NDArray[np.uint8]
Census = npt.NDArray[np.uint32]

_SIDE = 2 * MARGIN_PX + 1
_NEIGHBOURS = [(row, column) for row in range(_SIDE) for column in range(_SIDE) if row != 2 or column != 2]
_BITS_PER_BYTE = 8


def census(grey: Grey) -> Census:
    """(H - 4, W - 4, P) census words of P windows (H, W, P), which lose their margin."""
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
    """(D, N, G) mean differing bits per pixel of each box's windows; NaN where the right eye does not see the window.

    Index k along the first axis is the disparity first[n] + k of box n, in pixels of the box's level.
    """
    height, width = WINDOW_HW
    ours = _row_pairs(census(left.windows(windows, windows.column, width=width)))
    # The strip in the right image starts at the window's place for the largest disparity.
    strip_from = windows.column - (first + n_disparities - 1)[:, None]
    theirs = _row_pairs(census(right.windows(windows, strip_from, width=width + n_disparities - 1)))
    cost = np.empty((n_disparities, *windows.column.shape), np.float32)
    for k in range(n_disparities):
        start = n_disparities - 1 - k
        differing = np.bitwise_count(ours ^ theirs[:, start : start + width])
        column = differing.sum(axis=0, dtype=np.uint8)  # 7 pixels of at most 24 bits
        cost[k] = column.sum(axis=0, dtype=np.uint16).reshape(windows.column.shape)
    cost /= height * width
    place = windows.column - (first + np.arange(n_disparities)[:, None])[..., None]
    beyond = (right.width[windows.level] - MARGIN_PX - width)[:, None]
    cost[(place < MARGIN_PX) | (place > beyond)] = np.nan
    return cost


def _row_pairs(words: Census) -> npt.NDArray[np.uint64]:
    """(ceil(H / 2), W, P): the words of two rows in one, since counting bits costs the same for either length."""
    paired = words[0::2].astype(np.uint64)
    paired[: len(words) // 2] |= words[1::2].astype(np.uint64) << np.uint64(32)
    return paired
