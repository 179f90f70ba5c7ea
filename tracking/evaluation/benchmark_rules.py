"""Preprocessing of KITTI's and MOTChallenge's evaluations: the truth and result boxes of a sequence that count.

    KITTI     results are dropped that match a neighbouring class (Van for Car, Person for Pedestrian), or truth that is
              truncated or more than largely occluded; also unmatched results at most 25 px high, or with more than half
              of their area in a DontCare region. The remaining truth of the class counts.
    MOT16-20  results that match a person on a vehicle, a static person, a distractor or a reflection are dropped, in
    MOT20 also results that match a vehicle without a motor. Truth that is flagged as evaluated and of
              the class pedestrian counts.
    MOT15     truth that is flagged as evaluated counts.

Matches are the best one-to-one assignment with an IoU of at least 0.5. (The rules follow `evaluate_tracking.py` in
KITTI's development kit, and MOTChallenge; TrackEval implements them in `kitti_2d_box.py` and
`mot_challenge_2d_box.py`.)
"""

from collections.abc import Mapping, Sequence
from dataclasses import replace

import numpy as np
from scipy.optimize import linear_sum_assignment

from track_range.detection.boxes import fraction_inside, iou
from track_range.detection.classes import ROAD_CLASSES
from track_range.detection.formats.video_labels.kitti import KittiLabels
from track_range.detection.formats.video_labels.mot import MotRows
from track_range.foundation.arrays import BoolArray, FloatArray, IntArray
from track_range.tracking.evaluation.tracked_boxes import TrackedBoxes

_MIN_IOU = 0.5  # minimum IoU of a match
# fraction of a result box inside a DontCare region above which it is dropped
_MIN_FRACTION_IGNORED = 0.5
_EPSILON = float(np.finfo(np.float64).eps)  # tolerance of comparisons, as in TrackEval
# by road class: KITTI's and its neighbouring types
KITTI_TYPES: Mapping[str, tuple[str, tuple[str, ...]]] = {
    "car": ("Car", ("Van",)),
    "person": ("Pedestrian", ("Person", "Person_sitting")),
    "bicycle": ("Cyclist", ()),
}
# largest occlusion level and truncation of KITTI's truth that counts
_MAX_OCCLUDED, _MAX_TRUNCATED = 2, 0.0
# for users, of the evaluations of tracks against KITTI's labels and those of MOTChallenge
KITTI_RULE = (
    "KITTI's tracking benchmark: labels that are truncated or more than largely occluded, types such "
    "as Van, DontCare regions, and unmatched tracks up to 25 px high do not count"
)
MOT_RULE = "MOTChallenge: people who are flagged as evaluated count, distractors do not"
MIN_HEIGHT_PX = 25.0  # height up to which KITTI ignores unmatched results
_MOT_PEDESTRIAN = 1  # MOTChallenge's class number of pedestrians
_MOT_DISTRACTORS = (2, 7, 8, 12)  # person on a vehicle, static person, distractor, reflection
_MOT20_DISTRACTOR = 6  # vehicle without a motor, of which MOT20 shows many
_MOT20_CROWD = 13  # a class that only MOT20 has


def kitti_cleaned(
    labels: KittiLabels, results: TrackedBoxes, road_class: str
) -> tuple[TrackedBoxes, TrackedBoxes]:
    """Truth and results that count in KITTI's evaluation; `results` are all of `road_class`, a key
    of `KITTI_TYPES`.
    """
    kitti_type, neighbours = KITTI_TYPES[road_class]
    is_class, is_neighbour = of_kitti_type(labels, (kitti_type,)), of_kitti_type(labels, neighbours)
    # as the development kit, which reads the truncation as an integer and leaves out objects
    # without an identity
    is_clear = (labels.occluded <= _MAX_OCCLUDED) & (np.trunc(labels.truncated) <= _MAX_TRUNCATED)
    is_counted: BoolArray = np.ones(len(results), np.bool_)
    for frame, rows in _by_frame(results):
        in_frame = labels.frame == frame
        labelled = np.flatnonzero(in_frame & (is_class | is_neighbour))
        truth_rows, result_rows = _matched(labels.xyxy_px[labelled], results.xyxy_px[rows])
        unmatched = np.setdiff1d(np.arange(len(rows)), result_rows)
        is_void = is_neighbour[labelled[truth_rows]] | ~is_clear[labelled[truth_rows]]
        boxes = results.xyxy_px[rows[unmatched]]
        regions = labels.xyxy_px[in_frame & (labels.kitti_type == "DontCare")]
        is_low = boxes[:, 3] - boxes[:, 1] <= MIN_HEIGHT_PX + _EPSILON
        is_ignored = (
            fraction_inside(boxes, regions).max(axis=1, initial=0.0)
            > _MIN_FRACTION_IGNORED + _EPSILON
        )
        is_counted[rows[result_rows[is_void]]] = False
        is_counted[rows[unmatched[is_low | is_ignored]]] = False
    truth = _truth(labels.frame, labels.track_id, labels.xyxy_px, is_class & is_clear, results)
    return truth, results.select(is_counted)


def kitti_cleaned_classes(
    labels: KittiLabels, results: TrackedBoxes
) -> tuple[TrackedBoxes, TrackedBoxes]:
    """`kitti_cleaned` for each class of KITTI with truth that counts; results of the other classes
    do not count.
    """
    cleaned = {
        name: kitti_cleaned(
            labels, results.select(results.class_id == ROAD_CLASSES.index(name)), name
        )
        for name in KITTI_TYPES
    }
    present = {name: both for name, both in cleaned.items() if len(both[0])}
    truths = [
        replace(truth, class_id=np.full(len(truth), ROAD_CLASSES.index(name)))
        for name, (truth, _) in present.items()
    ]
    return TrackedBoxes.joined(truths), TrackedBoxes.joined(
        [tracks for _, tracks in present.values()]
    )


def of_kitti_type(labels: KittiLabels, types: Sequence[str]) -> BoolArray:
    """(N,) mask of the rows of a type, in any case, that have an identity."""
    named = np.char.lower(labels.kitti_type) if len(labels) else labels.kitti_type
    return np.asarray(np.isin(named, [name.lower() for name in types]) & (labels.track_id >= 0))


def mot_cleaned(
    truth: MotRows, results: TrackedBoxes, *, is_mot20: bool = False
) -> tuple[TrackedBoxes, TrackedBoxes]:
    """Truth and results that count in MOTChallenge's evaluation; truth without classes (MOT15) has
    no distractors.

    `is_mot20`: the truth is MOT20's, as its class crowd also shows.
    """
    is_true = truth.score != 0
    has_classes = bool((truth.mot_class > 0).any())
    if has_classes:
        is_true = (np.trunc(truth.score) != 0) & (truth.mot_class == _MOT_PEDESTRIAN)
    is_mot20 = is_mot20 or bool((truth.mot_class == _MOT20_CROWD).any())
    is_distractor = np.isin(truth.mot_class, (*_MOT_DISTRACTORS, *[_MOT20_DISTRACTOR] * is_mot20))
    is_counted: BoolArray = np.ones(len(results), np.bool_)
    for frame, rows in _by_frame(results) if has_classes else ():
        in_frame = np.flatnonzero(truth.frame == frame)
        truth_rows, result_rows = _matched(truth.xyxy_px[in_frame], results.xyxy_px[rows])
        is_counted[rows[result_rows[is_distractor[in_frame[truth_rows]]]]] = False
    return _truth(truth.frame, truth.track_id, truth.xyxy_px, is_true, results), results.select(
        is_counted
    )


def _truth(
    frame: IntArray,
    track_id: IntArray,
    xyxy_px: FloatArray,
    is_counted: BoolArray,
    results: TrackedBoxes,
) -> TrackedBoxes:
    """The truth that counts, with the class of the results."""
    class_id = int(results.class_id[0]) if len(results) else 0
    n = int(np.count_nonzero(is_counted))
    return TrackedBoxes(
        frame[is_counted], track_id[is_counted], xyxy_px[is_counted], np.full(n, class_id)
    )


def _by_frame(boxes: TrackedBoxes) -> list[tuple[int, IntArray]]:
    """Frame numbers in ascending order, each with its rows."""
    order = np.argsort(boxes.frame, kind="stable")
    frames, starts = np.unique(boxes.frame[order], return_index=True)
    return (
        list(zip(frames.tolist(), np.split(order, starts[1:]), strict=True)) if len(frames) else []
    )


def _matched(truth_xyxy_px: FloatArray, xyxy_px: FloatArray) -> tuple[IntArray, IntArray]:
    """Row numbers of matched truth and result boxes: the assignment with the largest total IoU."""
    overlap = iou(truth_xyxy_px, xyxy_px)
    overlap[overlap < _MIN_IOU - _EPSILON] = 0.0
    truth_rows, result_rows = linear_sum_assignment(overlap, maximize=True)
    is_match = overlap[truth_rows, result_rows] > _EPSILON
    return truth_rows[is_match], result_rows[is_match]
