"""Association: which box of this frame belongs to which track, as a cost matrix, its gates and the best assignment.

    cost = 1 - IoU(predicted box, detected box)      inf where the classes cannot be one object
    minimise the sum of costs over pairs, a track left alone costing max_cost

The rectangular assignment is scipy's (Crouse's form of Jonker and Volgenant's algorithm).
"""

from __future__ import annotations

import numpy as np
from scipy.optimize import linear_sum_assignment

from detection.boxes import iou
from detection.classes import SAME_OBJECT_GROUP
from detection.detections import BoolArray, FloatArray, IntArray


def iou_cost(track_xyxy_px: FloatArray, found_xyxy_px: FloatArray, *, margin: float = 0.0) -> FloatArray:
    """(N, M) 1 - IoU, in [0, 1], of boxes widened by `margin` of their own size on every side.

    A margin lets a box that moved by more than its width find itself again (Yang et al., C-BIoU, 2023).
    """
    return 1.0 - iou(widened(track_xyxy_px, margin), widened(found_xyxy_px, margin))


def widened(xyxy_px: FloatArray, margin: float) -> FloatArray:
    """(N, 4) boxes with `margin` times their width and height added on every side."""
    pad_px = margin * (xyxy_px[:, 2:] - xyxy_px[:, :2])
    return np.concatenate([xyxy_px[:, :2] - pad_px, xyxy_px[:, 2:] + pad_px], axis=1)


def are_compatible(track_class_id: IntArray, found_class_id: IntArray) -> BoolArray:
    """(N, M) whether a track and a box may be one object: detectors take cars, buses and trucks for each other."""
    return np.asarray(SAME_OBJECT_GROUP[track_class_id][:, None] == SAME_OBJECT_GROUP[found_class_id][None, :])


def assigned(cost: FloatArray, *, max_cost: float) -> tuple[IntArray, IntArray]:
    """Rows and columns of the pairs of least total cost, each pair at most `max_cost`; inf forbids a pair.

    Args:
        cost: (N, M), no NaN; N or M may be 0.
        max_cost: also what leaving a row alone costs, so that no pair is made only to make more pairs.
    """
    rows, columns = linear_sum_assignment(np.minimum(cost, max_cost))
    good = cost[rows, columns] <= max_cost
    return np.asarray(rows[good], np.int64), np.asarray(columns[good], np.int64)
