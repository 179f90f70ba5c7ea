"""Association: which box of this frame belongs to which track, as a cost matrix, its gates and the best assignment.

    cost = 1 - IoU(predicted box, detected box)      inf where the classes cannot be one object
    minimise the sum of costs over pairs, a track left alone costing max_cost

Most tracks and boxes of a frame have but one partner that they could take: those pairs are taken at once, and only the
rest is a problem of assignment, scipy's (Crouse's form of Jonker and Volgenant's algorithm).
"""

from __future__ import annotations

from typing import Literal

import numpy as np
from scipy.optimize import linear_sum_assignment

from track_range.detection.boxes import iou
from track_range.detection.classes import SAME_OBJECT_GROUP
from track_range.foundation.arrays import BoolArray, FloatArray, IntArray

Classes = Literal["similar", "same", "any"]
"""Which classes may be one object: those that detectors take for each other, equal ones only, or all."""


def iou_cost(track_xyxy_px: FloatArray, found_xyxy_px: FloatArray, *, margin: float = 0.0) -> FloatArray:
    """(N, M) 1 - IoU, in [0, 1], of boxes widened by `margin` of their own size on every side.

    A margin lets a box that moved by more than its width find itself again (Yang et al., C-BIoU, 2023).
    """
    if margin:
        track_xyxy_px, found_xyxy_px = widened(track_xyxy_px, margin), widened(found_xyxy_px, margin)
    return 1.0 - iou(track_xyxy_px, found_xyxy_px)


def widened(xyxy_px: FloatArray, margin: float) -> FloatArray:
    """(N, 4) boxes with `margin` times their width and height added on every side."""
    pad_px = margin * (xyxy_px[:, 2:] - xyxy_px[:, :2])
    return np.concatenate([xyxy_px[:, :2] - pad_px, xyxy_px[:, 2:] + pad_px], axis=1)


def are_compatible(track_class_id: IntArray, found_class_id: IntArray, classes: Classes = "similar") -> BoolArray:
    """(N, M) whether a track and a box may be one object: detectors take cars, buses and trucks for each other."""
    if classes == "any":
        return np.ones((len(track_class_id), len(found_class_id)), np.bool_)
    if classes == "similar":
        track_class_id, found_class_id = SAME_OBJECT_GROUP[track_class_id], SAME_OBJECT_GROUP[found_class_id]
    return np.asarray(track_class_id[:, None] == found_class_id[None, :])


def assigned(cost: FloatArray, *, max_cost: float) -> tuple[IntArray, IntArray]:
    """Rows and columns of the pairs of least total cost, each pair at most `max_cost`; inf forbids a pair.

    Args:
        cost: (N, M), no NaN; N or M may be 0.
        max_cost: also what leaving a row alone costs, so that no pair is made only to make more pairs.
    """
    may = cost <= max_cost
    n_of_row, n_of_column = may.sum(axis=1), may.sum(axis=0)
    rows, columns = np.nonzero(may & (n_of_row == 1)[:, None] & (n_of_column == 1)[None, :])
    open_rows, open_columns = np.flatnonzero(n_of_row), np.flatnonzero(n_of_column)
    if len(rows) == len(open_rows) or len(rows) == len(open_columns):
        return rows, columns
    i = np.setdiff1d(open_rows, rows, assume_unique=True)
    j = np.setdiff1d(open_columns, columns, assume_unique=True)
    rest = cost[np.ix_(i, j)]
    r, c = linear_sum_assignment(np.minimum(rest, max_cost))
    good = rest[r, c] <= max_cost
    return np.concatenate([rows, i[r[good]]]), np.concatenate([columns, j[c[good]]])
