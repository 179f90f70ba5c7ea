"""Census transform and its cost: how badly a patch of the left image fits the right one at each disparity.

    census(x)  = 24 bits, bit i: is neighbour i of the 5 x 5 window brighter than x?     (Zabih & Woodfill 1994)
    bits(d, x) = number of bits in which left census(x) and right census(x - d) differ: 0 .. 24, about 12 by chance

Only the order of grey values counts, so exposure and gain of the two eyes may differ.
"""

from __future__ import annotations

from dataclasses import dataclass
from itertools import pairwise

import cv2
import numpy as np
import numpy.typing as npt
from numpy.lib.stride_tricks import as_strided

from stereo.frames import Image
from stereo.patches import Patch

FloatArray = npt.NDArray[np.float64]
Census = npt.NDArray[np.uint32]

MARGIN_PX = 2
"""Pixels around a patch that the 5 x 5 window reaches."""

_CELLS = 3
"""A patch is cut into 3 x 3 cells, whose disagreement tells how sure the whole is."""

_MIN_SEEN = 0.5
"""Share of a patch (or cell) that must lie inside the right image for its cost to count."""

_N_NEIGHBOURS = 25
_CENTRE = 12

# Distinct powers of two up to 2^23 add up exactly in float32, which turns packing bits into one matrix product.
_WEIGHT = np.insert(2.0 ** np.arange(_N_NEIGHBOURS - 1), _CENTRE, 0.0).astype(np.float32)


@dataclass(frozen=True, slots=True)
class CostCurves:
    """Mean differing bits per pixel over a range of disparities.

    Attributes:
        first_px: the disparity of index 0; index k means first_px + k.
        whole: (D,) cost of the whole patch; inf where the right eye sees less than half of it.
        cells: (D, 9) cost of each cell; NaN where the right eye sees less than half of it.
    """

    first_px: int
    whole: FloatArray
    cells: FloatArray


def census(grey: Image, *, row_step: int = 1) -> Census:
    """(ceil((H - 4) / row_step), W - 4) census words of `grey` (H, W) without its margin, of every row_step-th row."""
    n_rows, n_columns = -(-(grey.shape[0] - 4) // row_step), grey.shape[1] - 4
    of_row, of_column = grey.strides
    shape, strides = (5, 5, n_rows, n_columns), (of_row, of_column, of_row * row_step, of_column)
    window = as_strided(grey, shape, strides, writeable=False)
    brighter = (window > window[MARGIN_PX, MARGIN_PX]).reshape(_N_NEIGHBOURS, -1)
    words = _WEIGHT @ brighter.astype(np.float32)
    return np.asarray(words.astype(np.uint32).reshape(n_rows, n_columns))


def cost_curves(left: Image, right: Image, patch: Patch, *, first_px: int, last_px: int, row_step: int) -> CostCurves:
    """Costs of `patch` at the disparities first_px .. last_px; images (H, W) grey or (H, W, 3) BGR, rectified.

    The patch must keep `MARGIN_PX` from the image's border. Every row_step-th row of it is used.
    """
    columns = np.arange(patch.left, patch.right + 1)
    disparity = np.arange(first_px, last_px + 1)
    seen_from, seen_to = MARGIN_PX, right.shape[1] - 1 - MARGIN_PX
    right_column = columns - disparity[:, None]
    seen = (right_column >= seen_from) & (right_column <= seen_to)
    ours = census(_grey(left, patch, patch.left, patch.right), row_step=row_step)
    theirs = np.zeros((len(ours), len(columns) + last_px - first_px), np.uint32)
    strip_from = patch.left - last_px
    start, end = max(strip_from, seen_from), min(patch.right - first_px, seen_to)
    if end >= start:
        strip = census(_grey(right, patch, start, end), row_step=row_step)
        theirs[:, start - strip_from : end - strip_from + 1] = strip
    return _curves(_differing_bits(ours, theirs), seen, first_px)


def _grey(image: Image, patch: Patch, start: int, end: int) -> Image:
    """The patch's rows and the columns start..end, with the margin, in grey."""
    crop = image[patch.top - MARGIN_PX : patch.bottom + MARGIN_PX + 1, start - MARGIN_PX : end + MARGIN_PX + 1]
    return np.asarray(cv2.cvtColor(crop, cv2.COLOR_BGR2GRAY), np.uint8) if crop.ndim == 3 else crop


def _differing_bits(ours: Census, theirs: Census) -> npt.NDArray[np.uint8]:
    """(H, D, W) differing bits, by ascending disparity; `theirs` starts at the column of the largest one."""
    n_rows, width = ours.shape
    n_disparities = theirs.shape[1] - width + 1
    of_row, of_column = theirs.strides
    # Offset k in `theirs` is the disparity last - k, hence the walk from its end with a negative stride.
    shifted = as_strided(
        theirs[:, n_disparities - 1 :], (n_rows, n_disparities, width), (of_row, -of_column, of_column), writeable=False
    )
    return np.asarray(np.bitwise_count(ours[:, None, :] ^ shifted), np.uint8)


def _curves(bits: npt.NDArray[np.uint8], seen: npt.NDArray[np.bool_], first_px: int) -> CostCurves:
    """Means of `bits` (H, D, W) over what is seen (D, W), for the whole and for each cell."""
    n_rows, n_disparities, width = bits.shape
    row_edges = np.arange(_CELLS + 1) * n_rows // _CELLS
    column_edges = np.arange(_CELLS + 1) * width // _CELLS
    band = np.stack([bits[a:b].sum(axis=0, dtype=np.uint32) for a, b in pairwise(row_edges)])
    sums = np.add.reduceat(np.where(seen, band, 0), column_edges[:-1], axis=2)
    n_seen_columns = np.add.reduceat(seen.astype(np.int64), column_edges[:-1], axis=1)
    n_pixels = np.diff(row_edges)[:, None, None] * n_seen_columns
    n_full = np.diff(row_edges)[:, None, None] * np.diff(column_edges)
    cells = np.divide(
        sums, n_pixels, out=np.full(sums.shape, np.nan), where=n_pixels >= np.maximum(_MIN_SEEN * n_full, 1)
    )
    n_whole = n_pixels.sum(axis=(0, 2))
    whole = np.divide(
        sums.sum(axis=(0, 2)),
        n_whole,
        out=np.full(n_disparities, np.inf),
        where=n_whole >= _MIN_SEEN * n_full.sum(),
    )
    return CostCurves(first_px, whole, cells.transpose(1, 0, 2).reshape(n_disparities, -1))
