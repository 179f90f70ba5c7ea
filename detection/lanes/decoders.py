"""Decoders of lane networks' outputs into pixels on lines.

    segmentation  [1, 2, h, w] or [1, 1, h, w]      a pixel is on a line if the score of the last channel is the larger
    curves        [1, K, 2] scores, [1, K, 8] rows  LSTR (Liu et al., WACV 2021): y0, y1, k, f, m, n, b, b' with
                                                    x = k / (y - f)^2 + m / (y - f) + n + b y - b', all in 0..1
    row anchors   [1, cells + 1, rows, 4]           Ultra Fast Lane Detection (Qin et al., ECCV 2020): in each of a few
                                                    fixed rows, scores of the cells of four lines; the last = no line

Decoders return pixels of the network's input, with pixel centres at integers, and the line number of each pixel.
"""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np
import numpy.typing as npt
from scipy.special import softmax

from track_range.detection.lanes.markings import run_middles
from track_range.foundation.arrays import FloatArray, FloatArray32, IntArray

Points = tuple[FloatArray, IntArray]
"""(N, 2) pixels on lines and (N,) their line numbers, -1 = unknown."""

ROW_ANCHORS: Mapping[int, FloatArray] = {
    18: np.array(
        [121, 131, 141, 150, 160, 170, 180, 189, 199, 209, 219, 228, 238, 248, 258, 267, 277, 287], np.float64
    ),
    56: np.arange(64.0, 285.0, 4.0),
}
"""Rows of CULane heads (18) and TuSimple heads (56) in an input of 288 rows: `culane_row_anchor` and
`tusimple_row_anchor` of the official implementation."""

ROW_ANCHOR_LINES = 4

_ANCHOR_IMAGE_ROWS = 288.0  # height of the input that `ROW_ANCHORS` refers to
_N_CURVE_SAMPLES = 40  # pixels per curve
_MIN_CURVE_SCORE = 0.5  # probability of a curve
_ROW_STEP = 2  # neighbouring rows of a mask are redundant

_MAX_RUN = 0.08
"""Largest width of a run of line pixels, as a fraction of the mask's width; wider runs are stop lines or distant lines
that merge."""


def mask_points(scores: FloatArray32) -> Points:
    """Centres of the runs of line pixels in every second row of scores (channels, h, w)."""
    is_probability = scores[0].min() >= 0.0 and scores[0].max() <= 1.0  # else logits
    on_line = scores[1] > scores[0] if len(scores) == 2 else scores[0] > (0.5 if is_probability else 0.0)
    rows = np.arange(0, on_line.shape[0], _ROW_STEP)
    row, x = run_middles(on_line[rows], widest_px=_MAX_RUN * on_line.shape[1])
    xy = np.stack([x, rows[row]], axis=1).astype(np.float64)
    return xy, np.full(len(xy), -1, np.int64)


def curve_points(logits: FloatArray32, curves: FloatArray32, input_hw: tuple[int, int]) -> Points:
    """Pixels of the curves (K, 8) whose probability, from logits (K, 2), exceeds `_MIN_CURVE_SCORE`.

    x = k / (y - f)^2 + m / (y - f) + n + b y - b'        x, y as fractions of the input size `input_hw`
    """
    good = np.flatnonzero(softmax(logits.astype(np.float64), axis=1)[:, 1] > _MIN_CURVE_SCORE)
    first, last, k, f, m, n, b, b_end = curves[good].astype(np.float64).T[:, :, None]
    # The far 15 % are left out: the curve is least accurate there, and its equation has a pole at y = f.
    fraction = np.linspace(0.0, 0.85, _N_CURVE_SAMPLES)
    y = np.maximum(first, last) - fraction * np.abs(last - first)
    with np.errstate(divide="ignore", invalid="ignore"):
        x = k / (y - f) ** 2 + m / (y - f) + n + b * y - b_end
    inside = np.isfinite(x) & (x >= 0.0) & (x <= 1.0) & (y > f) & (y <= 1.0)
    xy = np.stack([x, y], axis=2)[inside] * np.array([input_hw[1], input_hw[0]]) - 0.5
    return xy, np.broadcast_to(good[:, None], inside.shape)[inside].astype(np.int64)


def row_anchor_points(scores: FloatArray32, input_hw: tuple[int, int]) -> Points:
    """Pixels of lines from scores (cells + 1, rows, lines).

        x = sum over cells c of p(c) (c + 0.5) * cell width,        p = softmax of the scores without the last cell

    Cell c covers x from c to c + 1 cell widths. The official demonstration draws c + 1, which is half a cell to the
    right of the labels.
    """
    n_cells = len(scores) - 1
    cell_px = (input_hw[1] - 1) / (n_cells - 1)
    probability = softmax(scores[:-1].astype(np.float64), axis=0)
    x = (np.einsum("c,crl->rl", np.arange(n_cells) + 0.5, probability)) * cell_px
    is_visible = scores.argmax(axis=0) < n_cells
    y = ROW_ANCHORS[scores.shape[1]] / _ANCHOR_IMAGE_ROWS * input_hw[0]
    row, line = np.nonzero(is_visible)
    return np.stack([x[row, line], y[row]], axis=1), line.astype(np.int64)


def is_row_anchor_shape(shape: npt.NDArray[np.int64] | tuple[int, ...]) -> bool:
    """Whether an output of this shape is that of a row-anchor head."""
    return len(shape) == 4 and shape[1] > 2 and shape[2] in ROW_ANCHORS and shape[3] == ROW_ANCHOR_LINES
