"""Decoders of YOLO networks' outputs into candidate boxes, one function for each known output layout.

Boxes are in the network's corner coordinates (pixel i of the input covers [i, i + 1)); scores are probabilities. Each
decoder first drops the boxes whose score cannot reach the smallest threshold, with one comparison per box, and decodes
the remaining few per cent. NaN deliberately passes this comparison, so that boxes with NaN or overflowing numbers are
counted when they are dropped. Callers silence numpy's overflow warnings.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np

from track_range.detection.boxes import xyxy_from_cxcywh
from track_range.foundation.arrays import BoolArray, FloatArray, FloatArray32, IntArray

_ROUNDING = 1e-3  # excess over 1 of scores by rounding in half precision


@dataclass(frozen=True, slots=True)
class Candidates:
    """The N boxes of one image that reach their class's threshold, before non-maximum suppression."""

    xyxy_net: FloatArray  # (N, 4) in the network's corner coordinates, finite
    score: FloatArray  # (N,) confidence in [0, 1]
    class_index: IntArray  # (N,) index into the network's class names
    n_invalid: int  # number of boxes dropped because of NaN, infinite numbers or labels without a class name

    @classmethod
    def of(cls, xyxy_net: FloatArray, class_score: FloatArray32, min_score: FloatArray) -> Candidates:
        """The boxes (N, 4) whose best class in `class_score` (N, C) reaches the `min_score` (C,) of that class."""
        class_index = class_score.argmax(axis=1) if len(class_score) else np.zeros(0, np.int64)
        score = class_score[np.arange(len(class_score)), class_index].astype(np.float64)
        is_finite = np.isfinite(score) & np.isfinite(xyxy_net).all(axis=1)
        return cls._of_valid(xyxy_net, score, class_index, is_finite, min_score)

    @classmethod
    def of_labels(cls, xyxy_net: FloatArray, score: FloatArray, label: FloatArray, min_score: FloatArray) -> Candidates:
        """The boxes (N, 4) whose `score` (N,) reaches the `min_score` (C,) of the class `label` (N,).

        Scores above 1 and labels that are not whole numbers from 0 to C - 1 are invalid, like numbers that are not
        finite: the outputs are of another network, or the class names are too few.
        """
        is_label = (label >= 0) & (label < len(min_score)) & (label == np.floor(label))
        is_valid = is_label & (score <= 1 + _ROUNDING) & np.isfinite(xyxy_net).all(axis=1)
        return cls._of_valid(xyxy_net, score, np.where(is_label, label, 0).astype(np.int64), is_valid, min_score)

    @classmethod
    def _of_valid(
        cls, xyxy_net: FloatArray, score: FloatArray, class_index: IntArray, is_valid: BoolArray, min_score: FloatArray
    ) -> Candidates:
        is_candidate = is_valid & (score >= min_score[class_index])
        return cls(
            xyxy_net[is_candidate],
            np.minimum(score[is_candidate], 1.0),
            class_index[is_candidate],
            int(np.count_nonzero(~is_valid)),
        )


Decoder = Callable[[Sequence[FloatArray32], FloatArray], Candidates]  # outputs, (C,) thresholds (above 1 = left out)


def decode_rows(output: int, outputs: Sequence[FloatArray32], min_score: FloatArray) -> Candidates:
    """Candidates of one output [1, N, 5 + C]: centre x, y, width, height in input pixels, objectness, class scores.

    Layout of YOLOv5's official export, and of YOLOv3 and YOLOv4 exports made with the same tools.
    score = objectness * class score.
    """
    rows = outputs[output][0]
    rows = rows[~(rows[:, 4] < min_score.min())]  # the score cannot exceed the objectness
    return Candidates.of(xyxy_from_cxcywh(rows[:, :4].astype(np.float64)), rows[:, 4:5] * rows[:, 5:], min_score)


def decode_grid_rows(
    output: int, cell_xy: FloatArray, stride_px: FloatArray, outputs: Sequence[FloatArray32], min_score: FloatArray
) -> Candidates:
    """Candidates of YOLOX's output [1, N, 5 + C]: offset from the cell in cells, log size in strides, scores.

        centre = (xy + cell) * stride        size = exp(wh) * stride        score = objectness * class score

    `cell_xy` (N, 2) and `stride_px` (N,) are those of each box, see `grid_cells`. (Ge et al., "YOLOX", 2021.)
    """
    rows = outputs[output][0]
    kept = np.flatnonzero(~(rows[:, 4] < min_score.min()))
    rows, cell, stride = rows[kept], cell_xy[kept], stride_px[kept, None]
    xy, wh = rows[:, :2].astype(np.float64), rows[:, 2:4].astype(np.float64)
    cxcywh = np.concatenate([xy + cell, np.exp(wh)], axis=1) * stride
    return Candidates.of(xyxy_from_cxcywh(cxcywh), rows[:, 4:5] * rows[:, 5:], min_score)


def grid_cells(input_hw: tuple[int, int], strides_px: Sequence[int]) -> tuple[FloatArray, FloatArray]:
    """(N, 2) column and row, and (N,) stride, of the cells of an input, row by row, that all strides divide."""
    grids = [(stride, *(side // stride for side in input_hw)) for stride in strides_px]
    cells = [np.stack(np.meshgrid(np.arange(w), np.arange(h)), axis=-1).reshape(-1, 2) for _, h, w in grids]
    strides = [np.full(h * w, stride) for stride, h, w in grids]
    return np.concatenate(cells).astype(np.float64), np.concatenate(strides).astype(np.float64)


def decode_columns(output: int, outputs: Sequence[FloatArray32], min_score: FloatArray) -> Candidates:
    """Candidates of one output [1, 4 + C, N]: centre x, y, width, height in input pixels, class scores.

    Layout of the exports of YOLOv8 and YOLO11, which have no objectness.
    """
    columns = outputs[output][0]
    kept = np.flatnonzero(~(columns[4:].max(axis=0) < min_score.min()))
    rows = columns[:, kept].T
    return Candidates.of(xyxy_from_cxcywh(rows[:, :4].astype(np.float64)), rows[:, 4:], min_score)


def decode_corners(
    boxes: int, scores: int, input_hw: tuple[int, int], outputs: Sequence[FloatArray32], min_score: FloatArray
) -> Candidates:
    """Candidates of two outputs: boxes [1, N, 1, 4] or [1, N, 4] and class scores [1, N, C].

    Boxes are left, top, right, bottom as fractions of the input size; scores include the objectness. Layout of decoded
    exports of YOLOv4 and YOLOv4-tiny.
    """
    class_score = outputs[scores][0]
    kept = np.flatnonzero(~(class_score.max(axis=1) < min_score.min()))
    height, width = input_hw
    fractions = outputs[boxes].reshape(-1, 4)[kept].astype(np.float64)
    xyxy_net = fractions * np.array([width, height, width, height], np.float64)
    return Candidates.of(xyxy_net, class_score[kept], min_score)


@dataclass(frozen=True, slots=True)
class Head:
    """One raw Darknet head [1, A (5 + C), rows, columns]: tx, ty, tw, th, objectness, C classes of each anchor."""

    anchors_px: FloatArray  # (A, 2) width and height in input pixels
    stride_px: FloatArray  # (2,) size of a cell in x and y
    scale_x_y: float  # Darknet's factor s on the range of the centre offsets; 1 = no scaling


def decode_heads(heads: Sequence[Head], outputs: Sequence[FloatArray32], min_score: FloatArray) -> Candidates:
    """Candidates of the raw outputs before Darknet's [yolo] layers, one for each head.

        centre = (s * sigmoid(t_xy) - (s - 1) / 2 + cell) * stride        s = scale_x_y
        size   = anchor * exp(t_wh)          score = sigmoid(t_o) * sigmoid(t_c)

    (Redmon & Farhadi, "YOLOv3", 2018; Bochkovskiy et al., "YOLOv4", 2020, section 3.4 for s.)
    """
    boxes, scores = [], []
    for head, (raw,) in zip(heads, outputs, strict=True):
        n_rows, n_columns = raw.shape[1:]
        cells = raw.reshape(len(head.anchors_px), -1, n_rows, n_columns)
        min_logit = np.float32(logit(float(min_score.min())))
        anchor, row, column = np.nonzero(~(cells[:, 4] < min_logit))
        t = cells[anchor, :, row, column].astype(np.float64)
        s, cell = head.scale_x_y, np.stack([column, row], axis=1)
        centre = (s * sigmoid(t[:, :2]) - (s - 1) / 2 + cell) * head.stride_px
        size = head.anchors_px[anchor] * np.exp(t[:, 2:4])
        boxes.append(xyxy_from_cxcywh(np.concatenate([centre, size], axis=1)))
        scores.append((sigmoid(t[:, 4:5]) * sigmoid(t[:, 5:])).astype(np.float32))
    return Candidates.of(np.concatenate(boxes), np.concatenate(scores), min_score)


def sigmoid(x: FloatArray) -> FloatArray:
    """1 / (1 + exp(-x))."""
    return np.asarray(1 / (1 + np.exp(-x)))


def logit(probability: float) -> float:
    """log(p / (1 - p)), the inverse of the sigmoid; -inf for p <= 0, +inf for p >= 1."""
    if probability >= 1:
        return np.inf
    return -np.inf if probability <= 0 else float(np.log(probability / (1 - probability)))
