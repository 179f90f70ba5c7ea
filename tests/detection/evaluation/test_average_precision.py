"""Average precision: hand-worked examples, comparison with pycocotools, and truth against
itself."""

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given, settings, strategies as st

from tests.detection.evaluation.labelled_scenes import coco_figures, random_scene
from track_range.detection.classes import ROAD_CLASSES
from track_range.detection.detections import Detections
from track_range.detection.evaluation import MIN_BOXES, evaluate_detections
from track_range.detection.formats.image_labels.image_truth import (
    ANY_CLASS,
    ImageTruth,
    truth_of_kitti,
)
from track_range.detection.formats.video_labels.kitti import read_kitti

N = len(ROAD_CLASSES)
CAR = ROAD_CLASSES.index("car")
ALL = np.arange(N)
HALF = np.full(N, 0.5)


def scores(detections, truth, **options):
    arguments = {"working_score": HALF, "known_class_id": ALL, "min_boxes": 1} | options
    return evaluate_detections(detections, truth, **arguments)


def square(x, side=10.0):
    return [x, 0.0, x + side, side]


def test_by_hand():
    # Three cars; detections in the order hit, miss, hit: precision 1, 1/2, 2/3 at recall 1/3, 1/3,
    # 2/3.
    truth = ImageTruth.of([square(0), square(100), square(200)], [CAR] * 3)
    detections = Detections.of([square(0), square(50), square(100)], [0.9, 0.8, 0.4], [CAR] * 3)
    car = scores([detections], [truth]).by_class[CAR]
    # interpolated precision 1 at recall 0 .. 0.33, 2/3 at 0.34 .. 0.66, 0 above
    assert car.ap50 == pytest.approx((34 * 1 + 33 * 2 / 3) / 101)
    assert (car.n_images, car.n_boxes) == (1, 3)
    # at 0.5 and above
    assert (car.precision, car.recall) == (pytest.approx(1 / 2), pytest.approx(1 / 3))
    assert car.best_score == 0.4


def test_shifted_box_matches_up_to_iou_two_thirds():
    truth = ImageTruth.of([square(0)], [CAR])
    car = scores([Detections.of([square(2)], [0.9], [CAR])], [truth]).by_class[CAR]  # IoU 80 / 120
    assert (car.ap50, car.ap50_95) == (1.0, pytest.approx(0.4))  # 0.50, 0.55, 0.60, 0.65


def test_ignored_labels_and_regions():
    truth = ImageTruth.of(
        [square(0), square(100), [200, 0, 300, 100], square(400)],
        [CAR, CAR, ANY_CLASS, ANY_CLASS],
        is_ignored=[False, True, False, False],
        is_region=[False, False, True, False],
    )
    inside = [[210, 10, 220, 20], [230, 10, 240, 20]]  # two in one region
    detections = Detections.of(
        [square(0), square(100), *inside, square(400)], [0.6, 0.9, 0.9, 0.8, 0.7], [CAR] * 5
    )
    car = scores([detections], [truth]).by_class[CAR]
    assert (car.n_boxes, car.ap50, car.precision, car.recall) == (1, 1.0, 1.0, 1.0)
    twice = Detections.of([square(0), square(100), square(100)], [0.6, 0.9, 0.8], [CAR] * 3)
    # an ignored label is matched once
    assert scores([twice], [truth]).by_class[CAR].precision == 0.5


def test_incompletely_labelled_images_are_excluded():
    full, part = ImageTruth.of([square(0)], [CAR]), ImageTruth.of([], [])
    complete = np.arange(N) != CAR
    part = replace(part, is_complete=complete)
    detections = Detections.of([square(0)], [0.9], [CAR])
    assert scores([detections, detections], [full, part]).by_class[CAR].precision == 1.0
    assert scores([detections, detections], [full, full]).by_class[CAR].n_images == 2


def test_means_over_known_classes():
    rare = MIN_BOXES - 1
    boxes = [square(20.0 * i) for i in range(MIN_BOXES)]
    person = 0
    truth = ImageTruth.of(boxes + boxes[:rare], [CAR] * MIN_BOXES + [person] * rare)
    detections = Detections.of(boxes, [0.9] * MIN_BOXES, [CAR] * MIN_BOXES)
    evaluated = evaluate_detections([detections], [truth], working_score=HALF, known_class_id=ALL)
    assert (evaluated.mean("ap50"), evaluated.by_class[person].ap50) == (1.0, 0.0)
    assert evaluated.as_dict()["averaged_classes"] == ["car"]
    assert evaluated.as_dict()["classes"]["person"]["precision"] is None
    assert np.isnan(evaluated.mean("ap50", [person]))
    limited = evaluate_detections(
        [detections], [truth], working_score=HALF, known_class_id=np.array([person])
    )
    assert limited.as_dict()["averaged_classes"] == []
    assert not limited.by_class[CAR].is_known


def test_no_detections_and_no_labels():
    empty = scores([Detections.empty()], [ImageTruth.of([], [])])
    assert empty.by_class == {}
    assert empty.as_dict()["ap50"] is None
    limited = scores([Detections.empty()], [ImageTruth.of([square(0)], [CAR])]).by_class[CAR]
    assert (limited.ap50, limited.recall) == (0.0, 0.0)
    false_positive = scores(
        [Detections.of([square(0)], [0.9], [CAR])], [ImageTruth.of([], [])]
    ).by_class[CAR]
    assert false_positive.precision == 0.0
    assert np.isnan(false_positive.ap50)
    assert np.isnan(false_positive.recall)


def test_unequal_numbers_of_images():
    with pytest.raises(ValueError, match="expected 1 images"):
        scores([], [ImageTruth.of([], [])])


def test_arrays_of_unequal_length():
    with pytest.raises(ValueError, match="is_ignored: expected shape"):
        ImageTruth.of([square(0)], [CAR], is_ignored=[True, False])


@pytest.mark.parametrize("seed", range(12))
def test_equals_pycocotools(seed):
    detections, truth = random_scene(np.random.default_rng(seed), n_images=25)
    by_class = scores(detections, truth).by_class
    for class_id in range(3):
        ((ap50_95, ap50, _),) = coco_figures(detections, truth, class_id)
        actual = by_class[class_id]
        assert (actual.ap50_95, actual.ap50) == (
            pytest.approx(ap50_95, abs=1e-12),
            pytest.approx(ap50, abs=1e-12),
        )


def test_hundred_detections_per_image():
    rng = np.random.default_rng(0)
    boxes = [square(20.0 * i) for i in range(150)]
    detections = Detections.of(boxes, rng.permutation(150) / 150, [CAR] * 150)
    truth = ImageTruth.of(boxes, [CAR] * 150)
    assert scores([detections], [truth]).by_class[CAR].ap50 == pytest.approx(
        coco_figures([detections], [truth], CAR)[0][1]
    )


@settings(deadline=None, max_examples=30)
@given(st.integers(0, 10_000))
def test_truth_against_itself_is_perfect(seed):
    rng = np.random.default_rng(seed)
    _, truth = random_scene(rng, n_images=5)
    detections = [
        Detections.of(t.xyxy_px, rng.uniform(0.5, 1, len(t.class_id)), t.class_id) for t in truth
    ]
    evaluated = scores(detections, truth)
    assert all(
        figures.ap50_95 == pytest.approx(1.0)
        for figures in evaluated.by_class.values()
        if figures.n_boxes
    )
    assert scores(detections[::-1], truth[::-1]).as_dict() == evaluated.as_dict()


def test_kitti_labels(shared_data):
    labels = read_kitti(shared_data / "kitti_stereo/0005/label.txt")
    truth = [truth_of_kitti(labels.select(labels.frame == i)) for i in range(16)]
    perfect = [
        Detections.of(t.xyxy_px, np.ones(len(t.class_id)), np.maximum(t.class_id, 0)) for t in truth
    ]
    n_cars = int(np.count_nonzero(labels.kitti_type == "Car"))
    car = scores(perfect, truth).by_class[CAR]
    assert (car.n_boxes, car.ap50) == (n_cars, 1.0)
    types = {
        "Van": (CAR, True, False),
        "DontCare": (ANY_CLASS, True, True),
        "Misc": (ANY_CLASS, True, False),
    }
    for name, expected in types.items():
        rows = labels.kitti_type == name
        if rows.any():
            one = truth_of_kitti(labels.select(rows))
            assert (one.class_id[0], one.is_ignored[0], one.is_region[0]) == expected


def test_recall_at_precision_by_hand():
    # hit, miss, hit, miss: precision 1, 1/2, 2/3, 1/2 at recall 1/4, 1/4, 2/4, 2/4
    truth = ImageTruth.of([square(0), square(100), square(200), square(300)], [CAR] * 4)
    detections = Detections.of(
        [square(0), square(50), square(100), square(150)], [0.9, 0.8, 0.7, 0.6], [CAR] * 4
    )
    evaluated = scores([detections], [truth])
    # at 0.5, 0.6, 0.7, 0.8, 0.9, 0.95
    assert evaluated.by_class[CAR].recall_at == (0.5, 0.5, 0.25, 0.25, 0.25, 0.25)
    assert evaluated.as_dict()["classes"]["car"]["recall_at"]["0.6"] == 0.5


def test_low_objects_are_ignored():
    # cars of 10 and 30 px; detections of both, and false positives of 10 and 30 px
    truth = ImageTruth.of([square(0), square(100, 30)], [CAR] * 2)
    detections = Detections.of(
        [square(0), square(100, 30), square(300), square(400, 30)], [0.9, 0.8, 0.7, 0.6], [CAR] * 4
    )
    car = scores([detections], [truth], min_height_px=25.0).by_class[CAR]
    assert (car.n_boxes, car.recall, car.precision) == (1, 1.0, 0.5)
    # a low box that matches a label of sufficient height counts
    low = Detections.of([[100.0, 0, 130, 20]], [0.9], [CAR])
    assert scores([low], [truth], min_height_px=25.0).by_class[CAR].recall == 1.0
