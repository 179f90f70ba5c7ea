"""Decoders: a YOLO network's raw outputs -> candidate boxes, one class per known layout of outputs.

Boxes are in the network's corner coordinates (pixel i of the input covers [i, i + 1)); scores are probabilities. Each
decoder first drops what cannot reach its class's threshold, by one comparison per box, and decodes only what is left,
a few per cent. NaN passes that comparison on purpose: it is dropped after it, and counted, as are numbers that overflow
(their callers silence numpy's warnings).
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Protocol

import numpy as np

from track_range.detection.boxes import xyxy_from_cxcywh
from track_range.foundation.arrays import FloatArray, FloatArray32, IntArray


@dataclass(frozen=True, slots=True)
class Candidates:
    """Boxes of one image before suppression; N = 0 where nothing reached its threshold.

    Attributes:
        xyxy_net: (N, 4) in the network's corner coordinates, finite.
        score: (N,) in [0, 1].
        class_index: (N,) index into the network's own classes.
        n_invalid: boxes dropped because a number in them was NaN or infinite.
    """

    xyxy_net: FloatArray
    score: FloatArray
    class_index: IntArray
    n_invalid: int

    @classmethod
    def of(cls, xyxy_net: FloatArray, class_score: FloatArray32, min_score: FloatArray) -> Candidates:
        """The boxes (N, 4) whose best class of `class_score` (N, C) reaches that class's `min_score` (C,)."""
        class_index = class_score.argmax(axis=1) if len(class_score) else np.zeros(0, np.int64)
        score = class_score[np.arange(len(class_score)), class_index].astype(np.float64)
        sound = np.isfinite(score) & np.isfinite(xyxy_net).all(axis=1)
        keep = sound & (score >= min_score[class_index])
        return cls(xyxy_net[keep], np.minimum(score[keep], 1.0), class_index[keep], int(np.count_nonzero(~sound)))


class Decoder(Protocol):
    """Knows one layout of outputs."""

    def decode(self, outputs: Sequence[FloatArray32], min_score: FloatArray) -> Candidates:
        """Candidates of one image; `min_score` (C,) per class of the network, above 1 for one that is not wanted."""
        ...


@dataclass(frozen=True, slots=True)
class RowDecoder:
    """[1, N, 5 + C]: centre x, centre y, width, height in input pixels, objectness, class scores; all decoded.

    YOLOv5's official export, and exports of the YOLOv3/v4 kinds made with the same tools.
    """

    output: int

    def decode(self, outputs: Sequence[FloatArray32], min_score: FloatArray) -> Candidates:
        """See `Decoder`."""
        rows = outputs[self.output][0]
        rows = rows[~(rows[:, 4] < min_score.min())]  # a score cannot exceed its objectness
        return Candidates.of(xyxy_from_cxcywh(rows[:, :4].astype(np.float64)), rows[:, 4:5] * rows[:, 5:], min_score)


@dataclass(frozen=True, slots=True)
class GridRowDecoder:
    """[1, N, 5 + C] as YOLOX's export gives it: x, y as cells from the cell's corner, log sizes in strides.

        centre = (xy + cell) * stride        size = exp(wh) * stride        score = objectness * class score

    (Ge et al., "YOLOX", 2021; one box per cell, strides 8, 16, 32 in this order, row by row.)

    Attributes:
        output: which output.
        cell_xy: (N, 2) column and row of each box's cell.
        stride_px: (N,) of its grid.
    """

    output: int
    cell_xy: FloatArray
    stride_px: FloatArray

    @classmethod
    def for_input(cls, output: int, input_hw: tuple[int, int], strides_px: Sequence[int]) -> GridRowDecoder:
        """For an input of whole strides."""
        grids = [(stride, *(side // stride for side in input_hw)) for stride in strides_px]
        cells = [np.stack(np.meshgrid(np.arange(w), np.arange(h)), axis=-1).reshape(-1, 2) for _, h, w in grids]
        strides = [np.full(h * w, stride) for stride, h, w in grids]
        return cls(output, np.concatenate(cells).astype(np.float64), np.concatenate(strides).astype(np.float64))

    def decode(self, outputs: Sequence[FloatArray32], min_score: FloatArray) -> Candidates:
        """See `Decoder`."""
        rows = outputs[self.output][0]
        kept = np.flatnonzero(~(rows[:, 4] < min_score.min()))
        rows, stride = rows[kept], self.stride_px[kept, None]
        boxes = rows[:, :4].astype(np.float64)
        cxcywh = np.concatenate([boxes[:, :2] + self.cell_xy[kept], np.exp(boxes[:, 2:])], axis=1) * stride
        return Candidates.of(xyxy_from_cxcywh(cxcywh), rows[:, 4:5] * rows[:, 5:], min_score)


@dataclass(frozen=True, slots=True)
class ColumnDecoder:
    """[1, 4 + C, N] as YOLOv8's and YOLO11's exports give it: centre and size in input pixels, class scores."""

    output: int

    def decode(self, outputs: Sequence[FloatArray32], min_score: FloatArray) -> Candidates:
        """See `Decoder`."""
        columns = outputs[self.output][0]
        kept = np.flatnonzero(~(columns[4:].max(axis=0) < min_score.min()))
        rows = columns[:, kept].T
        return Candidates.of(xyxy_from_cxcywh(rows[:, :4].astype(np.float64)), rows[:, 4:], min_score)


@dataclass(frozen=True, slots=True)
class CornerDecoder:
    """Boxes [1, N, 1, 4] or [1, N, 4], left, top, right, bottom as shares of the input, and class scores [1, N, C].

    Decoded exports of YOLOv4 and YOLOv4-tiny; the scores have the objectness in them.
    """

    boxes_output: int
    scores_output: int
    input_hw: tuple[int, int]

    def decode(self, outputs: Sequence[FloatArray32], min_score: FloatArray) -> Candidates:
        """See `Decoder`."""
        scores = outputs[self.scores_output][0]
        kept = np.flatnonzero(~(scores.max(axis=1) < min_score.min()))
        height, width = self.input_hw
        shares = outputs[self.boxes_output].reshape(-1, 4)[kept].astype(np.float64)
        return Candidates.of(shares * np.array([width, height, width, height], np.float64), scores[kept], min_score)


@dataclass(frozen=True, slots=True)
class Head:
    """One raw Darknet head: [1, A (5 + C), rows, columns], anchor by anchor tx, ty, tw, th, objectness, classes.

    Attributes:
        output: which output.
        anchors_px: (A, 2) width and height in input pixels.
        stride_px: (2,) x, y size of a cell.
        scale_x_y: Darknet's stretch of the centres; 1 = none.
    """

    output: int
    anchors_px: FloatArray
    stride_px: FloatArray
    scale_x_y: float


@dataclass(frozen=True, slots=True)
class HeadDecoder:
    """Darknet's [yolo] layers, from the linear outputs before them.

        centre = (s * sigmoid(txy) - (s - 1) / 2 + cell) * stride, s = scale_x_y
        size   = anchor * exp(twh)           score = sigmoid(objectness) * sigmoid(class)

    (Redmon & Farhadi, "YOLOv3", 2018; Bochkovskiy et al., "YOLOv4", 2020, section 3.4 for s.)
    """

    heads: tuple[Head, ...]

    def decode(self, outputs: Sequence[FloatArray32], min_score: FloatArray) -> Candidates:
        """See `Decoder`."""
        parts = [_boxes_of_head(head, outputs[head.output][0], float(min_score.min())) for head in self.heads]
        boxes, scores = (np.concatenate(column) for column in zip(*parts, strict=True))
        return Candidates.of(boxes, scores, min_score)


def _boxes_of_head(head: Head, raw: FloatArray32, min_objectness: float) -> tuple[FloatArray, FloatArray32]:
    """Boxes (K, 4) and class scores (K, C) of the cells of `raw` (A (5 + C), rows, columns) that may matter."""
    n_rows, n_columns = raw.shape[1:]
    cells = raw.reshape(len(head.anchors_px), -1, n_rows, n_columns)
    least = np.float32(_logit(min_objectness))
    anchor, row, column = np.nonzero(~(cells[:, 4] < least))
    told = cells[anchor, :, row, column].astype(np.float64)
    cell_xy = np.stack([column, row], axis=1)
    centre = (head.scale_x_y * _sigmoid(told[:, :2]) - (head.scale_x_y - 1) / 2 + cell_xy) * head.stride_px
    size = head.anchors_px[anchor] * np.exp(told[:, 2:4])
    scores = _sigmoid(told[:, 4:5]) * _sigmoid(told[:, 5:])
    return xyxy_from_cxcywh(np.concatenate([centre, size], axis=1)), scores.astype(np.float32)


def _sigmoid(x: FloatArray) -> FloatArray:
    return np.asarray(1 / (1 + np.exp(-x)))


def _logit(probability: float) -> float:
    """Inverse of the sigmoid; -inf for 0, +inf from 1 on."""
    if probability >= 1:
        return np.inf
    return -np.inf if probability <= 0 else float(np.log(probability / (1 - probability)))
