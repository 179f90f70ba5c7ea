import numpy as np
import pytest

from track_range.detection.classes import ROAD_CLASSES
from track_range.detection.detections import Detections
from track_range.detection.detector import DetectorError, checked_detections

GOOD = ([1.0, 2.0, 3.0, 4.0], 0.5, 2)


def test_shapes_are_checked():
    with pytest.raises(ValueError, match=r"xyxy_px: .*\(3, 4\)"):
        Detections(
            np.zeros((3, 4)), np.zeros(2), np.zeros(2, np.int64), np.zeros((2, 0), np.float32)
        )


def test_select_takes_rows_in_order():
    detections = Detections.of(
        [[0, 0, 1, 1], [2, 2, 3, 3], [4, 4, 5, 5]], [0.1, 0.2, 0.3], [0, 1, 2]
    )
    chosen = detections.select(np.array([2, 0]))
    assert chosen.score.tolist() == [0.3, 0.1]
    assert chosen.class_id.tolist() == [2, 0]
    assert len(detections.select(np.zeros(3, bool))) == len(Detections.empty()) == 0


@pytest.mark.parametrize(
    ("box", "score", "class_id", "message"),
    [
        (
            [1, 2, 3, 4],
            0.5,
            8,
            "class_id: .*0 person.*5 truck.*7 traffic sign.*from_coco.*got 8 in row 1",
        ),
        ([1, 2, 3, 4], 0.5, -1, "class_id: .*got -1 in row 1"),
        ([1, 2, 3, 4], 1.2, 2, "score: .*0 to 1, got 1.2 in row 1"),
        ([1, 2, 3, 4], -0.1, 2, "score: .*got -0.1"),
        ([1, 2, 3, 4], np.nan, 2, "score: .*got nan"),
        ([1, 2, 3, 4], np.inf, 2, "score: .*got inf"),
        ([3, 2, 1, 4], 0.5, 2, r"xyxy_px: .*left <= right.*got \[3.0, 2.0, 1.0, 4.0\] in row 1"),
        ([1, 4, 3, 2], 0.5, 2, "xyxy_px: .*top <= bottom"),
        ([1, 2, np.nan, 4], 0.5, 2, "xyxy_px: .*finite.*nan"),
        ([1, 2, np.inf, 4], 0.5, 2, "xyxy_px: .*finite.*inf"),
        ([-np.inf, 2, 3, 4], 0.5, 2, "xyxy_px: .*finite.*-inf"),
    ],
)
def test_values_are_checked(box, score, class_id, message):
    good_box, good_score, good_class = GOOD
    with pytest.raises(ValueError, match=message):
        Detections.of(
            [good_box, box, good_box],
            [good_score, score, good_score],
            [good_class, class_id, good_class],
        )


def test_limits_are_valid():
    boxes = Detections.of([[1, 1, 1, 1], [-5, -5, 1e5, 1e5]], [0, 1], [0, len(ROAD_CLASSES) - 1])
    assert boxes.score.tolist() == [0, 1]


def test_coco_numbers_become_road_classes():
    coco = [0, 1, 2, 3, 5, 7, 9, 11, 4, 79]
    boxes = [[i, 0, i + 1, 1] for i in range(len(coco))]
    road = Detections.from_coco(boxes, np.linspace(0.1, 1, len(coco)), coco)
    # airplane and toothbrush are left out
    assert [ROAD_CLASSES[i] for i in road.class_id] == list(ROAD_CLASSES)
    assert road.xyxy_px[:, 0].tolist() == list(range(8))
    assert road.score.tolist() == pytest.approx([0.1 * i for i in range(1, 9)])
    by_category = Detections.from_coco(boxes[:3], [0.5] * 3, [3, 8, 90], n_ids=91)
    assert [ROAD_CLASSES[i] for i in by_category.class_id] == ["car", "truck"]
    assert len(Detections.from_coco([], [], [])) == 0


@pytest.mark.parametrize("number", [-1, 80])
def test_unknown_coco_numbers(number):
    with pytest.raises(ValueError, match=f"0 to 79, got {number}"):
        Detections.from_coco([[0, 0, 1, 1]], [0.5], [number])


def test_detections_are_shown_in_one_line():
    assert (
        repr(Detections.of([[0, 0, 1, 1]] * 3, [0.5] * 3, [2, 5, 2]))
        == "Detections(2 car, 1 truck)"
    )
    assert repr(Detections.empty()) == "Detections(none)"


def returning(value):
    return type("Own", (), {"detect": lambda self, image: value() if callable(value) else value})()


@pytest.mark.parametrize(
    ("value", "words"),
    [
        (
            np.zeros((3, 6)),
            r"Own, frame 0: expected detect\(\) to return Detections.*, got ndarray \(3, 6\)\.$",
        ),
        (([[1, 2, 3, 4]], [0.9], [2]), r"got tuple\.$"),
        (
            lambda: Detections.of(np.ones((4, 5)), np.ones(4), np.ones(4, int)),
            r"expected shape \(N, 4\), .* got \(4, 5\)",
        ),
        (
            lambda: Detections.of([[1, 2, 3, 4]], [0.9], ["car"]),
            r"class_id: expected whole numbers, got .*'car'.*class_id",
        ),
        (lambda: Detections.of(7, [0.9], [2]), r"xyxy_px: expected shape \(N, 4\), .* got \(\)"),
        (
            lambda: Detections([[1, 2, 3, 4]], [0.9], [2], None),
            r"xyxy_px: expected an array, got list",
        ),
        (
            Detections.of([[0.1, 0.2, 0.3, 0.4]], [0.9], [2]),
            r"pixels of the image \(64x48\), got fractions .*0\.1, 0\.2",
        ),
    ],
)
def test_detectors_of_users_learn_what_was_expected(value, words):
    with pytest.raises(DetectorError, match=words):
        checked_detections(returning(value), np.zeros((48, 64, 3), np.uint8), 0)


@pytest.mark.parametrize("boxes", [[[0, 0, 0, 0]], [[-5.0, -5.0, 0.9, 0.9]], []])
def test_boxes_at_the_corner_are_not_fractions(boxes):
    detections = Detections.of(boxes, [0.5] * len(boxes), [2] * len(boxes))
    assert len(
        checked_detections(returning(detections), np.zeros((48, 64, 3), np.uint8), 0)
    ) == len(boxes)
