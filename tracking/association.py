"""Association of tracks and detections: cost matrices, their gates, and the best assignment.

    c_ij = 1 - IoU(predicted box i, detected box j)      inf for incompatible classes
    minimise  sum of c_ij over the pairs (i, j) + max_cost * number of unmatched tracks,  with c_ij <= max_cost

Most tracks and detections of a frame have only one possible partner: these pairs are matched directly, and only the
remaining ones form a linear assignment problem (scipy's solver: Crouse's variant of the Jonker-Volgenant algorithm).
"""

from typing import Literal

import numpy as np
from scipy.optimize import linear_sum_assignment

from track_range.detection.boxes import iou
from track_range.detection.classes import ROAD_CLASSES, SAME_OBJECT_GROUP
from track_range.foundation.arrays import BoolArray, FloatArray, IntArray
from track_range.tracking.motion import BoxFilters, MotionNoise, cxcywh

Classes = Literal["similar", "same", "any"]  # similar: confused by detectors
# (classes, classes) whether detectors confuse two classes
_IS_CONFUSED = np.asarray(SAME_OBJECT_GROUP[:, None] == SAME_OBJECT_GROUP)
# groups of a person and of the two-wheelers
_RIDER_GROUPS = SAME_OBJECT_GROUP[[ROAD_CLASSES.index("person"), ROAD_CLASSES.index("bicycle")]]
_MAY_BE_RIDER = np.isin(SAME_OBJECT_GROUP, _RIDER_GROUPS)  # by class
# 1 - IoU above which a track and a detection are not candidates for each other
_UNRELATED_COST = 0.95
_GROWTH = 0.5  # standard deviation of the relative growth of a box, 1/s
# size up to which one assignment is faster than matching unambiguous pairs first
_MAX_DENSE = 128 * 128


class Assignment:
    """Pairs of N tracks and M detections, collected in stages; each stage matches what is left of
    earlier stages.
    """

    def __init__(self, n_tracks: int, n_detections: int) -> None:
        self._stages: list[tuple[IntArray, IntArray]] = []
        self._n_left = min(n_tracks, n_detections)

    @property
    def is_complete(self) -> bool:
        """Whether no track or no detection is left."""
        return self._n_left == 0

    def pairs(self) -> tuple[IntArray, IntArray]:
        """(K,) and (K,) row numbers of the tracks and of the detections of all pairs so far."""
        if not self._stages:
            return np.zeros(0, np.int64), np.zeros(0, np.int64)
        tracks, detections = zip(*self._stages, strict=True)
        return np.concatenate(tracks), np.concatenate(detections)

    def unmatched(self, tracks: BoolArray, detections: BoolArray) -> tuple[IntArray, IntArray]:
        """Row numbers of the unmatched tracks and detections within the masks (N,) and (M,)."""
        is_free_track, is_free_detection = tracks.copy(), detections.copy()
        for i, j in self._stages:
            is_free_track[i], is_free_detection[j] = False, False
        return is_free_track.nonzero()[0], is_free_detection.nonzero()[0]

    def match(
        self, cost: FloatArray, tracks: BoolArray, detections: BoolArray, *, max_cost: float
    ) -> None:
        """Match the unmatched tracks and detections within the masks (N,) and (M,) at minimum total
        `cost` (N, M).
        """
        if self.is_complete:
            return
        i, j = self.unmatched(tracks, detections)
        if len(i) and len(j):
            self.match_subset(cost[i[:, None], j], i, j, max_cost=max_cost)

    def match_subset(
        self, cost: FloatArray, tracks: IntArray, detections: IntArray, *, max_cost: float
    ) -> None:
        """Match the tracks (n,) and detections (m,) with the given row numbers at minimum total
        `cost` (n, m).
        """
        i, j = min_cost_matching(cost, max_cost=max_cost)
        self._add(tracks[i], detections[j])

    def match_unambiguous(self, cost: FloatArray, tracks: BoolArray, max_cost: FloatArray) -> None:
        """Match tracks within the mask (N,) and detections that are each other's only candidates,
        by 1 - IoU (N, M).

        `max_cost` (M,) is the largest cost of each detection. Later stages would match them too,
        but more slowly: this stage finds most pairs of a frame.
        """
        i, j = (cost <= _UNRELATED_COST).nonzero()
        is_pair = np.bincount(i)[i] == 1
        is_pair &= np.bincount(j)[j] == 1
        is_pair &= tracks[i]
        is_pair &= cost[i, j] <= max_cost[j]
        self._add(i[is_pair], j[is_pair])

    def _add(self, tracks: IntArray, detections: IntArray) -> None:
        if len(tracks):
            self._stages.append((tracks, detections))
            self._n_left -= len(tracks)


def iou_cost(
    track_xyxy_px: FloatArray, detected_xyxy_px: FloatArray, *, margin: float = 0.0
) -> FloatArray:
    """(N, M) 1 - IoU, in [0, 1], of boxes (N, 4) and (M, 4), each widened by `margin` times its
    size on every side.

    With a margin, boxes of an object that moved by more than its width still overlap (C-BIoU, Yang
    et al., 2023).
    """
    if margin:
        track_xyxy_px, detected_xyxy_px = (
            widened(track_xyxy_px, margin),
            widened(detected_xyxy_px, margin),
        )
    return 1.0 - iou(track_xyxy_px, detected_xyxy_px)


def distance_cost(
    filters: BoxFilters, detected_xyxy_px: FloatArray, step_s: float, noise: MotionNoise
) -> FloatArray:
    """(N, M) squared Mahalanobis distances of boxes (M, 4) from the predictions of N filters, `step_s` after a frame.

    For objects that move by more than their width from frame to frame, with y the difference of the centres:
        d^2 = (y_x^2 + y_y^2) / S + log(h / h')^2 / (2 r^2 + (growth step)^2)        chi-square distributed, 3 degrees
    """
    box = cxcywh(detected_xyxy_px)
    y = box[None, :, :2] - filters.x[:, None, :2]
    S = filters.P[0] + (noise.measured * filters.height_px) ** 2
    log_height = np.log(box[None, :, 3] / np.maximum(filters.x[:, None, 3], 1.0))
    size_variance = 2 * noise.measured**2 + (_GROWTH * step_s) ** 2
    return np.asarray((y**2).sum(axis=2) / S[:, None] + log_height**2 / size_variance)


def widened(xyxy_px: FloatArray, margin: float) -> FloatArray:
    """(N, 4) boxes with `margin` times their width and height added on every side."""
    pad_px = margin * (xyxy_px[:, 2:] - xyxy_px[:, :2])
    return np.concatenate([xyxy_px[:, :2] - pad_px, xyxy_px[:, 2:] + pad_px], axis=1)


def are_compatible(
    track_class_id: IntArray,
    class_votes: FloatArray,
    detected_class_id: IntArray,
    classes: Classes = "similar",
) -> BoolArray:
    """(N, M) whether a detection has a class that a track had before, or one that detectors confuse
    with it; `class_votes` (N, classes) is above 0 for the classes of a track's boxes.

    All names of a rider, whose boxes `may_be_riders` first brought together, continue its track.
    """
    if classes == "any":
        return np.ones((len(class_votes), len(detected_class_id)), np.bool_)
    continues = _IS_CONFUSED if classes == "similar" else np.eye(len(_IS_CONFUSED), dtype=np.bool_)
    # by row, which is fastest; then the few tracks of several classes
    allowed = continues.take(detected_class_id, axis=1).take(track_class_id, axis=0)
    if np.count_nonzero(class_votes) > len(class_votes):
        several = (np.count_nonzero(class_votes, axis=1) > 1).nonzero()[0]
        is_known = class_votes[several] @ continues > 0
        allowed[several] = is_known.take(detected_class_id, axis=1)
    return allowed


def may_be_riders(track_class_id: IntArray, detected_class_id: IntArray) -> BoolArray:
    """(N, M) whether one of a track and a detection is a person and the other one a bicycle or a
    motorcycle: detectors have either name for one rider, and change it.
    """
    track_group, group = SAME_OBJECT_GROUP[track_class_id], SAME_OBJECT_GROUP[detected_class_id]
    is_either = _MAY_BE_RIDER[track_class_id][:, None] & _MAY_BE_RIDER[detected_class_id]
    return np.asarray(is_either & (track_group[:, None] != group))


def min_cost_matching(cost: FloatArray, *, max_cost: float) -> tuple[IntArray, IntArray]:
    """Rows and columns of the pairs of `cost` (N, M) with minimum total cost; inf forbids a pair,
    there is no NaN.

    `max_cost` is the largest cost of a pair, and the cost of an unmatched row: matching more rows
    is not preferred over a lower total cost.
    """
    if cost.size <= _MAX_DENSE:
        return _dense_matching(cost, max_cost)
    allowed = cost <= max_cost
    n_of_row, n_of_column = allowed.sum(axis=1), allowed.sum(axis=0)
    rows, columns = np.nonzero(allowed & (n_of_row == 1)[:, None] & (n_of_column == 1)[None, :])
    open_rows, open_columns = np.flatnonzero(n_of_row), np.flatnonzero(n_of_column)
    if len(rows) == len(open_rows) or len(rows) == len(open_columns):
        return rows, columns
    i = np.setdiff1d(open_rows, rows, assume_unique=True)
    j = np.setdiff1d(open_columns, columns, assume_unique=True)
    r, c = _dense_matching(cost[np.ix_(i, j)], max_cost)
    return np.concatenate([rows, i[r]]), np.concatenate([columns, j[c]])


def _dense_matching(cost: FloatArray, max_cost: float) -> tuple[IntArray, IntArray]:
    """`min_cost_matching` as one linear assignment problem; its time grows with the third power of
    the size.
    """
    rows, columns = linear_sum_assignment(np.minimum(cost, max_cost))
    is_pair = cost[rows, columns] <= max_cost
    return rows[is_pair], columns[is_pair]
