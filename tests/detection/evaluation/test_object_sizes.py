"""Accuracy by size of object: hand-worked examples, and comparison with pycocotools."""

import json

import numpy as np
import pytest

from tests.detection.evaluation.labelled_scenes import coco_figures, random_scene
from track_range.detection.classes import ROAD_CLASSES
from track_range.detection.detections import Detections
from track_range.detection.evaluation import evaluate_detections
from track_range.detection.evaluation.object_sizes import MIN_BIN_BOXES, SIZE_BINS, evaluate_by_size
from track_range.detection.formats.image_labels.image_truth import ImageTruth

N = len(ROAD_CLASSES)
CAR, BUS = ROAD_CLASSES.index("car"), ROAD_CLASSES.index("bus")


def scores(detections, truth, **options):
    arguments = {
        "working_score": np.full(N, 0.5),
        "known_class_id": np.arange(N),
        "min_boxes": 1,
        "min_bin_boxes": 1,
    }
    return evaluate_by_size(detections, truth, **(arguments | options))


def box(x, width, height):
    return [x, 0.0, x + width, height]


def test_by_hand():
    # Cars of 20, 50 and 120 px; all are found, the medium one with a low score; false positives of
    # 20 and 120 px.
    boxes = [box(0, 20, 20), box(200, 50, 50), box(400, 120, 120)]
    truth = ImageTruth.of(boxes, [CAR] * 3)
    wrong = [box(600, 20, 20), box(800, 120, 120)]
    detections = Detections.of(boxes + wrong, [0.9, 0.4, 0.7, 0.95, 0.6], [CAR] * 5)
    small, medium, large = (
        bin_scores.by_class[CAR] for bin_scores in scores([detections], [truth])
    )
    assert (small.n_boxes, medium.n_boxes, large.n_boxes) == (1, 1, 1)
    # only the small false positive is the better one
    assert (small.ap50, medium.ap50, large.ap50) == (0.5, 1.0, 1.0)
    assert (small.recall, medium.recall, large.recall) == (1.0, 0.0, 1.0)  # at 0.5 and above
    by_height = scores([detections], [truth], measure="height")
    assert [bin_scores.by_class[CAR].n_boxes for bin_scores in by_height] == [1, 0, 1, 1]
    assert np.isnan(by_height[1].by_class[CAR].ap50)


def test_limits_belong_to_the_upper_bin():
    truth = ImageTruth.of(
        [box(0, 32, 32), box(200, 96, 96), box(400, 10, 25), box(500, 10, 100)], [CAR] * 4
    )
    counts = {
        measure: [
            one.by_class[CAR].n_boxes
            for one in scores([Detections.empty()], [truth], measure=measure)
        ]
        for measure in SIZE_BINS
    }
    assert counts == {"area": [2, 1, 1], "height": [0, 2, 1, 1]}


def test_detection_of_another_size_that_matches_counts():
    # IoU 0.6: a label of 30 x 30 px, found by a medium box; the label of 40 x 40 px is found by a
    # small one
    truth = ImageTruth.of([box(0, 30, 30), box(200, 40, 40)], [CAR] * 2)
    detections = Detections.of([box(0, 50, 30), box(200, 40, 24)], [0.9, 0.8], [CAR] * 2)
    small, medium, _ = scores([detections], [truth])
    assert (small.by_class[CAR].ap50, medium.by_class[CAR].ap50) == (1.0, 1.0)


@pytest.mark.parametrize("measure", SIZE_BINS)
@pytest.mark.parametrize("seed", range(6))
def test_equals_pycocotools(seed, measure):
    scale = 3.9 if measure == "area" else 3.7  # so that all bins are used, and no box is at a limit
    detections, truth = random_scene(np.random.default_rng(seed), n_images=60, scale=scale)
    by_bin = scores(detections, truth, measure=measure, working_score=np.zeros(N))
    for class_id in range(3):
        expected = coco_figures(detections, truth, class_id, SIZE_BINS[measure])
        actual = [bin_scores.by_class[class_id] for bin_scores in by_bin]
        figures = [(row.ap50_95, row.ap50, row.recall) for row in actual]
        assert figures == [pytest.approx(row, abs=1e-12, nan_ok=True) for row in expected]
        assert sum(row.n_boxes > 0 for row in actual) >= 2


def test_bins_divide_the_labels():
    detections, truth = random_scene(np.random.default_rng(1), n_images=20, scale=4.3)
    arguments = {"working_score": np.full(N, 0.5), "known_class_id": np.arange(N)}
    everything = evaluate_detections(detections, truth, **arguments)
    for measure in SIZE_BINS:
        by_bin = scores(detections, truth, measure=measure)
        for class_id, whole in everything.by_class.items():
            assert (
                sum(bin_scores.by_class[class_id].n_boxes for bin_scores in by_bin) == whole.n_boxes
            )


def test_means_and_json():
    cars, buses = (
        [box(60.0 * i, 20, 20) for i in range(n)] for n in (MIN_BIN_BOXES, MIN_BIN_BOXES - 1)
    )
    truth = ImageTruth.of(
        cars + buses + [box(2000, 200, 200)], [CAR] * len(cars) + [BUS] * (len(buses) + 1)
    )
    detections = Detections.of(cars, [0.9] * len(cars), [CAR] * len(cars))
    small, medium, large = scores([detections], [truth], min_bin_boxes=MIN_BIN_BOXES)
    assert (small.mean("ap50"), small.by_class[BUS].ap50) == (1.0, 0.0)  # too few buses
    row = small.as_dict()
    assert (row["name"], row["from_px2"], row["to_px2"]) == ("small", 0.0, 1024.0)
    assert (row["n_boxes"], row["ap50"], row["averaged_classes"]) == (len(cars), 1.0, ["car"])
    assert medium.as_dict()["classes"]["car"] == {
        "n_boxes": 0, "ap50": None, "ap50_95": None, "recall": None, "is_averaged": False
    }  # fmt: skip
    assert (large.as_dict()["to_px2"], large.as_dict()["ap50"]) == (None, None)
    assert json.loads(json.dumps(row, allow_nan=False)) == row
    few = scores([detections], [truth], min_boxes=len(cars) + 1)
    assert few[0].as_dict()["averaged_classes"] == []
    unknown = scores([detections], [truth], known_class_id=np.array([BUS]))
    assert unknown[0].as_dict()["averaged_classes"] == ["bus"]


def test_minimum_height_applies_in_all_bins():
    truth = ImageTruth.of([box(0, 20, 20), box(200, 20, 30)], [CAR] * 2)
    detections = Detections.of([box(200, 20, 30), box(400, 20, 20)], [0.8, 0.9], [CAR] * 2)
    small = scores([detections], [truth], min_height_px=25.0)[0].by_class[CAR]
    assert (small.n_boxes, small.ap50) == (1, 1.0)


def test_unequal_numbers_of_images():
    with pytest.raises(ValueError, match="expected 1 images"):
        scores([], [ImageTruth.of([], [])])


def test_unknown_measure():
    with pytest.raises(ValueError, match=r"measure: .*'width'"):
        scores([], [], measure="width")
