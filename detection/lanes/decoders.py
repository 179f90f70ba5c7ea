"""What lane networks mean by their outputs: pixels on lines, in the part of the image that they were shown.

    segmentation  [1, 2, h, w] or [1, 1, h, w]      a pixel is on a line where its score (last channel) wins
    curves        [1, K, 2] scores, [1, K, 8] rows  LSTR (Liu et al., WACV 2021): y0, y1, k, f, m, n, b, b' with
                                                    x = k / (y - f)^2 + m / (y - f) + n + b y - b', all in 0..1
    row anchors   [1, cells + 1, rows, 4]           Ultra Fast Lane Detection (Qin et al., ECCV 2020): in each of some
                                                    fixed rows, the cell of each of four lines; the last one means none

Decoders return pixels of the network's input, pixel centres at whole numbers, and the number of the line of each.
"""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np
import numpy.typing as npt
from scipy.special import softmax

from track_range.detection.lanes.markings import run_middles
from track_range.foundation.arrays import FloatArray, FloatArray32, IntArray

Points = tuple[FloatArray, IntArray]
"""(N, 2) pixels and the (N,) number of the line of each, -1 = not told."""

ROW_ANCHORS: Mapping[int, FloatArray] = {
    18: np.array(
        [121, 131, 141, 150, 160, 170, 180, 189, 199, 209, 219, 228, 238, 248, 258, 267, 277, 287], np.float64
    ),
    56: np.arange(64.0, 285.0, 4.0),
}
"""Rows of a 288-row input that CULane heads (18) and TuSimple heads (56) look at: the published `culane_row_anchor` and
`tusimple_row_anchor`."""

ROW_ANCHOR_LINES = 4

_ANCHOR_IMAGE_ROWS = 288.0
_CURVE_SAMPLES = 40
_CURVE_SCORE = 0.5
_EVERY_ROW = 2  # of a mask: neighbouring rows say the same
_WIDEST_RUN = 0.08  # of the mask's width: wider ones are stop lines, or lines that run together far ahead


def mask_points(scores: FloatArray32) -> Points:
    """Middles of the runs of line pixels in every other row of scores (channels, h, w)."""
    on_line = scores[1] > scores[0] if len(scores) == 2 else scores[0] > _even(scores[0])
    rows = np.arange(0, on_line.shape[0], _EVERY_ROW)
    row, x = run_middles(on_line[rows], widest_px=_WIDEST_RUN * on_line.shape[1])
    xy = np.stack([x, rows[row]], axis=1).astype(np.float64)
    return xy, np.full(len(xy), -1, np.int64)


def _even(scores: FloatArray32) -> float:
    """The score that is neither line nor road: half where scores are probabilities, zero where they are logits."""
    return 0.5 if scores.min() >= 0.0 and scores.max() <= 1.0 else 0.0


def curve_points(logits: FloatArray32, curves: FloatArray32, input_hw: tuple[int, int]) -> Points:
    """Samples of the curves that score more than a half, of logits (K, 2) and curves (K, 8)."""
    good = np.flatnonzero(softmax(logits.astype(np.float64), axis=1)[:, 1] > _CURVE_SCORE)
    first, last, k, f, m, n, b, b_end = curves[good].astype(np.float64).T[:, :, None]
    # The far end of a curve is where it turns most wildly, and past f its equation has a pole.
    share = np.linspace(0.0, 0.85, _CURVE_SAMPLES)
    y = np.maximum(first, last) - share * np.abs(last - first)
    with np.errstate(divide="ignore", invalid="ignore"):
        x = k / (y - f) ** 2 + m / (y - f) + n + b * y - b_end
    inside = np.isfinite(x) & (x >= 0.0) & (x <= 1.0) & (y > f) & (y <= 1.0)
    xy = np.stack([x, y], axis=2)[inside] * np.array([input_hw[1], input_hw[0]]) - 0.5
    return xy, np.broadcast_to(good[:, None], inside.shape)[inside].astype(np.int64)


def row_anchor_points(scores: FloatArray32, input_hw: tuple[int, int]) -> Points:
    """Expected places of the lines of scores (cells + 1, rows, lines) in the rows where they are.

    Cell c holds x from c to c + 1 cell widths (the published demonstration draws its right edge, c + 1: half a cell to
    the right of what the labels say); the place is the mean over the cells by their probability, as published.
    """
    n_cells = len(scores) - 1
    cell_px = (input_hw[1] - 1) / (n_cells - 1)
    probability = softmax(scores[:-1].astype(np.float64), axis=0)
    x = (np.einsum("c,crl->rl", np.arange(n_cells) + 0.5, probability)) * cell_px
    there = scores.argmax(axis=0) < n_cells
    y = ROW_ANCHORS[scores.shape[1]] / _ANCHOR_IMAGE_ROWS * input_hw[0]
    row, line = np.nonzero(there)
    return np.stack([x[row, line], y[row]], axis=1), line.astype(np.int64)


def is_row_anchor_shape(shape: npt.NDArray[np.int64] | tuple[int, ...]) -> bool:
    """Whether an output is a row-anchor head's."""
    return len(shape) == 4 and shape[1] > 2 and shape[2] in ROW_ANCHORS and shape[3] == ROW_ANCHOR_LINES
