"""What does not count in KITTI's and MOTChallenge's evaluations: cleaning truth and results of one sequence.

    KITTI     results that match a neighbouring class (Van beside Car, Person beside Pedestrian), or truth that is
              truncated or more than largely occluded, are dropped; so are those that match nothing and are at most
              25 px high, or lie by half in a DontCare region. Truth of the class that is none of that counts.
    MOT16-20  results that match a person on a vehicle, a static person, a distractor or a reflection are dropped.
              Truth that is marked to be considered and of the class pedestrian counts.
    MOT15     truth that is marked to be considered counts.

"Matches" is the best one-to-one assignment at an IoU of 0.5. (The rules are
those of `evaluate_tracking.py` in KITTI's development kit and of MOTChallenge; TrackEval, another project, has them in
its `kitti_2d_box.py` and `mot_challenge_2d_box.py`.)
"""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np
from scipy.optimize import linear_sum_assignment

from track_range.detection.boxes import iou, share_inside
from track_range.detection.formats.kitti import KittiLabels
from track_range.foundation.arrays import BoolArray, FloatArray, IntArray
from track_range.tracking.mot_format import MotRows
from track_range.tracking.tracked_boxes import TrackedBoxes

_MIN_IOU = 0.5
_MIN_SHARE_IGNORED = 0.5
_EPSILON = float(np.finfo(np.float64).eps)

KITTI_TYPES: Mapping[str, tuple[str, tuple[str, ...]]] = {
    "car": ("Car", ("Van",)),
    "person": ("Pedestrian", ("Person", "Person_sitting")),
    "bicycle": ("Cyclist", ()),
}
"""By road class: KITTI's type, and its neighbours. KITTI itself ranks cars and pedestrians only."""

_MAX_OCCLUDED, _MAX_TRUNCATED = 2, 0.0

MIN_HEIGHT_PX = 25.0
"""KITTI: lower boxes count neither as detected nor as missed."""

_MOT_PEDESTRIAN = 1
_MOT_DISTRACTORS = (2, 7, 8, 12)
"""Person on a vehicle, static person, distractor, reflection."""


def kitti_cleaned(labels: KittiLabels, results: TrackedBoxes, road_class: str) -> tuple[TrackedBoxes, TrackedBoxes]:
    """Truth and results that count for one of `KITTI_TYPES`; `results` are all of that class."""
    kitti_type, neighbours = KITTI_TYPES[road_class]
    is_class, is_neighbour = labels.kitti_type == kitti_type, np.isin(labels.kitti_type, neighbours)
    is_clear = (labels.occluded <= _MAX_OCCLUDED) & (labels.truncated <= _MAX_TRUNCATED + _EPSILON)
    keep: BoolArray = np.ones(len(results), np.bool_)
    for frame, rows in _by_frame(results):
        here = labels.frame == frame
        near = np.flatnonzero(here & (is_class | is_neighbour))
        truth_rows, result_rows = _matched(labels.xyxy_px[near], results.xyxy_px[rows])
        unmatched = np.setdiff1d(np.arange(len(rows)), result_rows)
        void = is_neighbour[near[truth_rows]] | ~is_clear[near[truth_rows]]
        boxes = results.xyxy_px[rows[unmatched]]
        regions = labels.xyxy_px[here & (labels.kitti_type == "DontCare")]
        low = boxes[:, 3] - boxes[:, 1] <= MIN_HEIGHT_PX + _EPSILON
        inside = share_inside(boxes, regions).max(axis=1, initial=0.0) > _MIN_SHARE_IGNORED + _EPSILON
        keep[rows[result_rows[void]]] = False
        keep[rows[unmatched[low | inside]]] = False
    return _truth(labels.frame, labels.track_id, labels.xyxy_px, is_class & is_clear, results), results.select(keep)


def mot_cleaned(truth: MotRows, results: TrackedBoxes) -> tuple[TrackedBoxes, TrackedBoxes]:
    """Truth and results that count; a truth without classes (MOT15's) has no distractors."""
    counts = truth.score != 0
    has_classes = bool((truth.mot_class > 0).any())
    if has_classes:
        counts &= truth.mot_class == _MOT_PEDESTRIAN
    is_distractor = np.isin(truth.mot_class, _MOT_DISTRACTORS)
    keep: BoolArray = np.ones(len(results), np.bool_)
    for frame, rows in _by_frame(results) if has_classes else ():
        here = np.flatnonzero(truth.frame == frame)
        truth_rows, result_rows = _matched(truth.xyxy_px[here], results.xyxy_px[rows])
        keep[rows[result_rows[is_distractor[here[truth_rows]]]]] = False
    return _truth(truth.frame, truth.track_id, truth.xyxy_px, counts, results), results.select(keep)


def _truth(
    frame: IntArray, track_id: IntArray, xyxy_px: FloatArray, counts: BoolArray, results: TrackedBoxes
) -> TrackedBoxes:
    """The truth that counts, of the results' class."""
    class_id = int(results.class_id[0]) if len(results) else 0
    n = int(np.count_nonzero(counts))
    return TrackedBoxes(frame[counts], track_id[counts], xyxy_px[counts], np.full(n, class_id))


def _by_frame(boxes: TrackedBoxes) -> list[tuple[int, IntArray]]:
    """Frame numbers and the rows of each."""
    order = np.argsort(boxes.frame, kind="stable")
    frames, starts = np.unique(boxes.frame[order], return_index=True)
    return list(zip(frames.tolist(), np.split(order, starts[1:]), strict=True)) if len(frames) else []


def _matched(truth_xyxy_px: FloatArray, xyxy_px: FloatArray) -> tuple[IntArray, IntArray]:
    """Rows of truth and of results that belong together."""
    overlap = iou(truth_xyxy_px, xyxy_px)
    overlap[overlap < _MIN_IOU - _EPSILON] = 0.0
    truth_rows, result_rows = linear_sum_assignment(overlap, maximize=True)
    real = overlap[truth_rows, result_rows] > _EPSILON
    return truth_rows[real], result_rows[real]
