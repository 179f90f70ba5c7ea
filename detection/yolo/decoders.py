"""Decoding of networks' outputs into candidate boxes: where the numbers of a box are, and what they
mean.

Boxes are in the network's corner coordinates (pixel i of the input covers [i, i + 1)); scores are
probabilities. A decoder first drops the boxes whose score cannot reach the smallest threshold, with
one comparison per box, and decodes the remaining few per cent. NaN deliberately passes this
comparison, so that boxes with NaN or overflowing numbers are counted when they are dropped. Callers
silence numpy's overflow warnings.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from typing import Literal

import numpy as np

from track_range.detection.boxes import xyxy_from_cxcywh
from track_range.foundation.arrays import BoolArray, FloatArray, FloatArray32, IntArray

_ROUNDING = 1e-3  # excess over 1 of scores by rounding in half precision


@dataclass(frozen=True, slots=True)
class Candidates:
    """The N boxes of one image that reach their class's threshold, before non-maximum
    suppression.
    """

    xyxy_net: FloatArray  # (N, 4) in the network's corner coordinates, finite
    score: FloatArray  # (N,) confidence in [0, 1]
    class_index: IntArray  # (N,) index into the network's class names
    # number of boxes dropped because of NaN, infinite numbers or labels without a class name
    n_invalid: int
    # (N, 2) centre of the grid cell that each box belongs to; NaN without a grid
    cell_px: FloatArray

    @classmethod
    def of(
        cls,
        xyxy_net: FloatArray,
        class_score: FloatArray32,
        min_score: FloatArray,
        cell_px: FloatArray | None = None,
    ) -> Candidates:
        """The boxes (N, 4) whose best class in `class_score` (N, C) reaches the `min_score` (C,) of
        that class.
        """
        class_index = class_score.argmax(axis=1) if len(class_score) else np.zeros(0, np.int64)
        score = class_score[np.arange(len(class_score)), class_index].astype(np.float64)
        is_finite = np.isfinite(score) & np.isfinite(xyxy_net).all(axis=1)
        return cls._of_valid(xyxy_net, score, class_index, is_finite, min_score, cell_px)

    @classmethod
    def of_labels(
        cls, xyxy_net: FloatArray, score: FloatArray, label: FloatArray, min_score: FloatArray
    ) -> Candidates:
        """The boxes (N, 4) whose `score` (N,) reaches the `min_score` (C,) of the class `label`
        (N,).

        Scores above 1 and labels that are not whole numbers from 0 to C - 1 are invalid, like
        numbers that are not finite: the outputs belong to another network, or there are too few
        class names.
        """
        is_label = (label >= 0) & (label < len(min_score)) & (label == np.floor(label))
        is_valid = is_label & (score <= 1 + _ROUNDING) & np.isfinite(xyxy_net).all(axis=1)
        return cls._of_valid(
            xyxy_net,
            score,
            np.where(is_label, label, 0).astype(np.int64),
            is_valid,
            min_score,
            None,
        )

    @classmethod
    def _of_valid(
        cls,
        xyxy_net: FloatArray,
        score: FloatArray,
        class_index: IntArray,
        is_valid: BoolArray,
        min_score: FloatArray,
        cell_px: FloatArray | None,
    ) -> Candidates:
        is_candidate = is_valid & (score >= min_score[class_index])
        cells = np.full((len(score), 2), np.nan) if cell_px is None else cell_px
        return cls(
            xyxy_net[is_candidate],
            np.minimum(score[is_candidate], 1.0),
            class_index[is_candidate],
            int(np.count_nonzero(~is_valid)),
            cells[is_candidate],
        )


# outputs, (C,) thresholds (above 1 = left out)
Decoder = Callable[[Sequence[FloatArray32], FloatArray], Candidates]
# numbers (K, k) of the rows (K,) -> (K, 4) corners in pixels
BoxCode = Callable[[FloatArray, IntArray], FloatArray]
Activation = Literal["none", "sigmoid", "softmax"]


@dataclass(frozen=True, slots=True)
class Part:
    """Columns of the N rows of one output: [1, ..., K] with K columns, or [1, A K, ...], anchor by
    anchor.
    """

    output: int
    columns: slice = field(default_factory=lambda: slice(None))
    n_anchors: int = 0  # A of [1, A K, ...]; 0 = the columns are the last dimension

    def of(self, outputs: Sequence[FloatArray32]) -> FloatArray32:
        """(N, k) the columns of all rows."""
        array: FloatArray32 = outputs[self.output][0]
        if not self.n_anchors:
            return np.asarray(array.reshape(-1, array.shape[-1])[:, self.columns])
        planes = array.reshape(self.n_anchors, array.shape[0] // self.n_anchors, -1)[
            :, self.columns
        ]
        return np.asarray(
            planes[0].T
            if self.n_anchors == 1
            else planes.transpose(0, 2, 1).reshape(-1, planes.shape[1])
        )

    def at(self, outputs: Sequence[FloatArray32], rows: IntArray) -> FloatArray32:
        """(K, k) the columns of some rows (K,)."""
        if self.n_anchors <= 1:
            return self.of(outputs)[rows]
        array = outputs[self.output][0]
        planes = array.reshape(self.n_anchors, array.shape[0] // self.n_anchors, -1)
        anchor, cell = np.divmod(rows, planes.shape[2])
        return np.asarray(planes[anchor, :, cell][:, self.columns])


@dataclass(frozen=True, slots=True, kw_only=True)
class BoxRows:
    """N boxes in the outputs. score = activation(objectness) * activation(class score); 1 without
    an objectness.
    """

    boxes: Part
    scores: Part
    code: BoxCode  # meaning of the columns of `boxes`
    objectness: Part | None = None
    activation: Activation = "none"  # still to be applied to the scores
    classes: slice = field(
        default_factory=lambda: slice(None)
    )  # columns of the scores, after the activation, that are classes; others: background
    cell_px: FloatArray | None = None  # (N, 2) centres of the grid cells


def decode_rows(
    levels: Sequence[BoxRows], outputs: Sequence[FloatArray32], min_score: FloatArray
) -> Candidates:
    """Candidates of all levels; each level has the rows of one grid."""
    boxes, cells = [np.zeros((0, 4))], [np.zeros((0, 2))]
    scores = [np.zeros((0, len(min_score)), np.float32)]
    lowest = float(min_score.min())
    threshold = {"none": lowest, "sigmoid": logit(lowest), "softmax": -np.inf}
    for level in levels:
        # the score cannot exceed the objectness
        highest = level.scores if level.objectness is None else level.objectness
        kept = _rows_reaching(highest.of(outputs), np.float32(threshold[level.activation]))
        if not len(kept):
            continue
        score = _activated(level.scores.at(outputs, kept), level.activation)[:, level.classes]
        if level.objectness is not None:
            score = _activated(level.objectness.at(outputs, kept), level.activation) * score
        boxes.append(level.code(level.boxes.at(outputs, kept).astype(np.float64), kept))
        scores.append(score.astype(np.float32))
        cells.append(
            np.full((len(kept), 2), np.nan) if level.cell_px is None else level.cell_px[kept]
        )
    return Candidates.of(
        np.concatenate(boxes), np.concatenate(scores), min_score, np.concatenate(cells)
    )


def _rows_reaching(values: FloatArray32, threshold: np.float32) -> IntArray:
    """Numbers of the rows (N, k) in which any value reaches the threshold, or is NaN."""
    if values.shape[1] == 1:
        return np.flatnonzero(~(values[:, 0] < threshold))
    if not values.flags.c_contiguous:  # columns are contiguous, whose largest values are fast
        return np.flatnonzero(~(values.max(axis=1) < threshold))
    # all values with one comparison, which is faster than the largest one of each short row
    rows = np.flatnonzero(~(values.ravel() < threshold)) // values.shape[1]
    is_first = np.ones(len(rows), np.bool_)
    is_first[1:] = rows[1:] != rows[:-1]
    return np.asarray(rows[is_first])


def _activated(values: FloatArray32, activation: Activation) -> FloatArray | FloatArray32:
    if activation == "none":
        return values
    return (
        sigmoid(values.astype(np.float64))
        if activation == "sigmoid"
        else softmax(values.astype(np.float64), axis=1)
    )


@dataclass(frozen=True, slots=True)
class GridCells:
    """The grid cells of N boxes, ordered by grid, anchor and row."""

    column_row: FloatArray  # (N, 2)
    stride_px: FloatArray  # (N, 2) size of the cell in x and y

    @classmethod
    def of(
        cls,
        input_hw: tuple[int, int],
        strides_px: Sequence[int],
        n_anchors: int = 1,
        *,
        is_rounded_up: bool = False,
    ) -> GridCells:
        """The cells of an input of this size; unless `is_rounded_up`, all strides divide the
        size.
        """
        cells, strides = [np.zeros((0, 2))], [np.zeros((0, 2))]
        for s in strides_px:
            grid_hw = [-(-side // s) if is_rounded_up else side // s for side in input_hw]
            grid = cls.of_grid(input_hw, grid_hw, n_anchors)
            cells.append(grid.column_row)
            strides.append(np.full((len(grid.column_row), 2), float(s)))
        return cls(np.concatenate(cells), np.concatenate(strides))

    @classmethod
    def of_grid(
        cls, input_hw: tuple[int, int], grid_hw: Sequence[int], n_anchors: int = 1
    ) -> GridCells:
        """The cells of one grid of h rows and w columns."""
        (height, width), (h, w) = input_hw, grid_hw
        cells = (
            np.stack(np.meshgrid(np.arange(w), np.arange(h)), axis=-1)
            .reshape(-1, 2)
            .astype(np.float64)
        )
        return cls(
            np.tile(cells, (n_anchors, 1)), np.full((n_anchors * h * w, 2), (width / w, height / h))
        )

    def points_px(self, offset: float = 0.5) -> FloatArray:
        """(N, 2) x and y of the point at `offset` of each cell."""
        return np.asarray((self.column_row + offset) * self.stride_px)


def corners(unit_xy: tuple[float, float] = (1.0, 1.0)) -> BoxCode:
    """Left, top, right, bottom in units of `unit_xy` pixels: 1, or the size of the input."""
    scale = np.array([*unit_xy, *unit_xy], np.float64)
    return lambda numbers, _: numbers * scale


def rows_first(unit_xy: tuple[float, float]) -> BoxCode:
    """Top, left, bottom, right in units of `unit_xy` pixels."""
    code = corners(unit_xy)
    return lambda numbers, rows: code(numbers[:, [1, 0, 3, 2]], rows)


def centres(unit_xy: tuple[float, float] = (1.0, 1.0)) -> BoxCode:
    """Centre x, y, width, height in units of `unit_xy` pixels."""
    scale = np.array([*unit_xy, *unit_xy], np.float64)
    return lambda numbers, _: xyxy_from_cxcywh(numbers * scale)


def cell_offsets(cells: GridCells) -> BoxCode:
    """YOLOX's offset from the cell in cells, log size in strides (Ge et al., "YOLOX", 2021).

    centre = (xy + cell) * stride        size = exp(wh) * stride
    """

    def code(numbers: FloatArray, rows: IntArray) -> FloatArray:
        cxcywh = np.concatenate(
            [numbers[:, :2] + cells.column_row[rows], np.exp(numbers[:, 2:])], axis=1
        )
        return xyxy_from_cxcywh(cxcywh * np.tile(cells.stride_px[rows], 2))

    return code


def distances(centre_px: FloatArray) -> BoxCode:
    """Distances in pixels from a point (N, 2) of each cell to left, top, right, bottom, as in
    RTMDet.
    """

    def code(numbers: FloatArray, rows: IntArray) -> FloatArray:
        point = centre_px[rows]
        return np.concatenate([point - numbers[:, :2], point + numbers[:, 2:]], axis=1)

    return code


def binned_distances(
    centre_px: FloatArray,
    stride_px: FloatArray,
    n_bins: int,
    clipped_to_hw: tuple[int, int] | None = None,
) -> BoxCode:
    """Logits of R + 1 = `n_bins` distances for each side ("Generalized Focal Loss", Li et al. 2020,
    equations 5 and 6).

    P(k) = exp(t_k) / sum over j of exp(t_j)          distance = stride * sum over k of k P(k)
    """
    point_code = distances(centre_px)
    bins, side_px = np.arange(n_bins), np.tile(stride_px, 2)

    def code(numbers: FloatArray, rows: IntArray) -> FloatArray:
        probability = softmax(numbers.reshape(-1, 4, n_bins), axis=2)
        boxes = point_code((probability @ bins) * side_px[rows], rows)
        return (
            boxes if clipped_to_hw is None else np.clip(boxes, 0, np.tile(clipped_to_hw[::-1], 2))
        )

    return code


def anchored(
    cells: GridCells,
    anchors_px: FloatArray,
    *,
    scale_x_y: float = 2.0,
    size: Literal["exp", "square"],
    is_logit: bool,
) -> BoxCode:
    """Offsets and sizes relative to A anchors (A, 2) of the cells of one grid.

        centre = (s * sigmoid(t_xy) - (s - 1) / 2 + cell) * stride        s = scale_x_y
        size   = anchor * exp(t_wh), or anchor * (2 sigmoid(t_wh))^2

    (Redmon & Farhadi, "YOLOv3", 2018; Bochkovskiy et al., "YOLOv4", 2020, section 3.4 for s;
    YOLOv5's head, with s = 2, for the second size.) Without `is_logit`, the sigmoid is part of the
    network.
    """

    def code(numbers: FloatArray, rows: IntArray) -> FloatArray:
        anchor = anchors_px[rows // (len(cells.column_row) // len(anchors_px))]
        fraction = sigmoid(numbers) if is_logit else numbers
        offset = scale_x_y * fraction[:, :2] - (scale_x_y - 1) / 2 + cells.column_row[rows]
        factor = np.exp(numbers[:, 2:]) if size == "exp" else (2 * fraction[:, 2:]) ** 2
        return xyxy_from_cxcywh(
            np.concatenate([offset * cells.stride_px[rows], anchor * factor], axis=1)
        )

    return code


def softmax(x: FloatArray, axis: int) -> FloatArray:
    """exp(x) / (sum of exp(x)) along an axis."""
    relative = np.exp(x - x.max(axis=axis, keepdims=True))
    return np.asarray(relative / relative.sum(axis=axis, keepdims=True))


def sigmoid(x: FloatArray) -> FloatArray:
    """1 / (1 + exp(-x))."""
    return np.asarray(1 / (1 + np.exp(-x)))


def logit(probability: float) -> float:
    """log(p / (1 - p)), the inverse of the sigmoid; -inf for p <= 0, +inf for p >= 1."""
    if probability >= 1:
        return np.inf
    return -np.inf if probability <= 0 else float(np.log(probability / (1 - probability)))
