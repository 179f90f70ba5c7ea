"""Decoders of YOLO networks' outputs into candidate boxes, one class for each known output layout.

Boxes are in the network's corner coordinates (pixel i of the input covers [i, i + 1)); scores are probabilities. Each
decoder first drops the boxes whose score cannot reach the smallest threshold, with one comparison per box, and decodes
the remaining few per cent. NaN deliberately passes this comparison, so that boxes with NaN or overflowing numbers are
counted when they are dropped. Callers silence numpy's overflow warnings.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Protocol

import numpy as np

from track_range.detection.boxes import xyxy_from_cxcywh
from track_range.foundation.arrays import BoolArray, FloatArray, FloatArray32, IntArray

_ROUNDING = 1e-3
"""Excess over 1 of scores by rounding in half precision."""


@dataclass(frozen=True, slots=True)
class Candidates:
    """The N boxes of one image that reach their class's threshold, before non-maximum suppression.

    Attributes:
        xyxy_net: (N, 4) in the network's corner coordinates, finite.
        score: (N,) confidence in [0, 1].
        class_index: (N,) index into the network's class names.
        n_invalid: number of boxes dropped because of NaN, infinite numbers or labels without a class name.
    """

    xyxy_net: FloatArray
    score: FloatArray
    class_index: IntArray
    n_invalid: int

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


class Decoder(Protocol):
    """Decoder of one output layout."""

    def decode(self, outputs: Sequence[FloatArray32], min_score: FloatArray) -> Candidates:
        """The candidates of one image.

        Args:
            outputs: the network's outputs, in its order.
            min_score: (C,) threshold of each of the network's classes, above 1 for classes to leave out.
        """
        ...


@dataclass(frozen=True, slots=True)
class RowDecoder:
    """Decoder of one output [1, N, 5 + C]: centre x, y, width, height in input pixels, objectness, class scores.

    Layout of YOLOv5's official export, and of YOLOv3 and YOLOv4 exports made with the same tools.
    score = objectness * class score.

    Attributes:
        output: index of the output.
    """

    output: int

    def decode(self, outputs: Sequence[FloatArray32], min_score: FloatArray) -> Candidates:
        """See `Decoder`."""
        rows = outputs[self.output][0]
        rows = rows[~(rows[:, 4] < min_score.min())]  # the score cannot exceed the objectness
        return Candidates.of(xyxy_from_cxcywh(rows[:, :4].astype(np.float64)), rows[:, 4:5] * rows[:, 5:], min_score)


@dataclass(frozen=True, slots=True)
class GridRowDecoder:
    """Decoder of YOLOX's output [1, N, 5 + C]: offset from the cell in cells, log size in strides, scores.

        centre = (xy + cell) * stride        size = exp(wh) * stride        score = objectness * class score

    There is one box per cell, row by row, for strides 8, 16, 32 in this order. (Ge et al., "YOLOX", 2021.)

    Attributes:
        output: index of the output.
        cell_xy: (N, 2) column and row of each box's cell.
        stride_px: (N,) stride of each box's grid.
    """

    output: int
    cell_xy: FloatArray
    stride_px: FloatArray

    @classmethod
    def for_input(cls, output: int, input_hw: tuple[int, int], strides_px: Sequence[int]) -> GridRowDecoder:
        """The decoder for an input size (height, width) that is divisible by all strides."""
        grids = [(stride, *(side // stride for side in input_hw)) for stride in strides_px]
        cells = [np.stack(np.meshgrid(np.arange(w), np.arange(h)), axis=-1).reshape(-1, 2) for _, h, w in grids]
        strides = [np.full(h * w, stride) for stride, h, w in grids]
        return cls(output, np.concatenate(cells).astype(np.float64), np.concatenate(strides).astype(np.float64))

    def decode(self, outputs: Sequence[FloatArray32], min_score: FloatArray) -> Candidates:
        """See `Decoder`."""
        rows = outputs[self.output][0]
        kept = np.flatnonzero(~(rows[:, 4] < min_score.min()))
        rows, cell, stride = rows[kept], self.cell_xy[kept], self.stride_px[kept, None]
        xy, wh = rows[:, :2].astype(np.float64), rows[:, 2:4].astype(np.float64)
        cxcywh = np.concatenate([xy + cell, np.exp(wh)], axis=1) * stride
        return Candidates.of(xyxy_from_cxcywh(cxcywh), rows[:, 4:5] * rows[:, 5:], min_score)


@dataclass(frozen=True, slots=True)
class ColumnDecoder:
    """Decoder of one output [1, 4 + C, N]: centre x, y, width, height in input pixels, class scores.

    Layout of the exports of YOLOv8 and YOLO11, which have no objectness.

    Attributes:
        output: index of the output.
    """

    output: int

    def decode(self, outputs: Sequence[FloatArray32], min_score: FloatArray) -> Candidates:
        """See `Decoder`."""
        columns = outputs[self.output][0]
        kept = np.flatnonzero(~(columns[4:].max(axis=0) < min_score.min()))
        rows = columns[:, kept].T
        return Candidates.of(xyxy_from_cxcywh(rows[:, :4].astype(np.float64)), rows[:, 4:], min_score)


@dataclass(frozen=True, slots=True)
class CornerDecoder:
    """Decoder of two outputs: boxes [1, N, 1, 4] or [1, N, 4] and class scores [1, N, C].

    Boxes are left, top, right, bottom as fractions of the input size; scores include the objectness. Layout of decoded
    exports of YOLOv4 and YOLOv4-tiny.

    Attributes:
        boxes_output, scores_output: indices of the outputs.
        input_hw: (height, width) of the network's input in pixels.
    """

    boxes_output: int
    scores_output: int
    input_hw: tuple[int, int]

    def decode(self, outputs: Sequence[FloatArray32], min_score: FloatArray) -> Candidates:
        """See `Decoder`."""
        scores = outputs[self.scores_output][0]
        kept = np.flatnonzero(~(scores.max(axis=1) < min_score.min()))
        height, width = self.input_hw
        fractions = outputs[self.boxes_output].reshape(-1, 4)[kept].astype(np.float64)
        return Candidates.of(fractions * np.array([width, height, width, height], np.float64), scores[kept], min_score)


@dataclass(frozen=True, slots=True)
class Head:
    """One raw Darknet head [1, A (5 + C), rows, columns]: tx, ty, tw, th, objectness, C classes for each of A anchors.

    Attributes:
        output: index of the output.
        anchors_px: (A, 2) width and height in input pixels.
        stride_px: (2,) size of a cell in x and y.
        scale_x_y: Darknet's factor s on the range of the centre offsets; 1 = no scaling.
    """

    output: int
    anchors_px: FloatArray
    stride_px: FloatArray
    scale_x_y: float


@dataclass(frozen=True, slots=True)
class HeadDecoder:
    """Decoder of the raw outputs before Darknet's [yolo] layers.

        centre = (s * sigmoid(t_xy) - (s - 1) / 2 + cell) * stride        s = scale_x_y
        size   = anchor * exp(t_wh)          score = sigmoid(t_o) * sigmoid(t_c)

    (Redmon & Farhadi, "YOLOv3", 2018; Bochkovskiy et al., "YOLOv4", 2020, section 3.4 for s.)

    Attributes:
        heads: the heads, one for each output.
    """

    heads: tuple[Head, ...]

    def decode(self, outputs: Sequence[FloatArray32], min_score: FloatArray) -> Candidates:
        """See `Decoder`."""
        parts = [_boxes_of_head(head, outputs[head.output][0], float(min_score.min())) for head in self.heads]
        boxes, scores = zip(*parts, strict=True)
        return Candidates.of(np.concatenate(boxes), np.concatenate(scores), min_score)


def _boxes_of_head(head: Head, raw: FloatArray32, min_objectness: float) -> tuple[FloatArray, FloatArray32]:
    """Boxes (K, 4) and class scores (K, C) of the cells of `raw` (A (5 + C), rows, columns) above `min_objectness`."""
    n_rows, n_columns = raw.shape[1:]
    cells = raw.reshape(len(head.anchors_px), -1, n_rows, n_columns)
    min_logit = np.float32(logit(min_objectness))
    anchor, row, column = np.nonzero(~(cells[:, 4] < min_logit))
    t = cells[anchor, :, row, column].astype(np.float64)
    s, cell = head.scale_x_y, np.stack([column, row], axis=1)
    centre = (s * sigmoid(t[:, :2]) - (s - 1) / 2 + cell) * head.stride_px
    size = head.anchors_px[anchor] * np.exp(t[:, 2:4])
    scores = sigmoid(t[:, 4:5]) * sigmoid(t[:, 5:])
    return xyxy_from_cxcywh(np.concatenate([centre, size], axis=1)), scores.astype(np.float32)


def sigmoid(x: FloatArray) -> FloatArray:
    """1 / (1 + exp(-x))."""
    return np.asarray(1 / (1 + np.exp(-x)))


def logit(probability: float) -> float:
    """log(p / (1 - p)), the inverse of the sigmoid; -inf for p <= 0, +inf for p >= 1."""
    if probability >= 1:
        return np.inf
    return -np.inf if probability <= 0 else float(np.log(probability / (1 - probability)))
