"""Calibration of scores: hand-worked examples, simulated detectors, and which detections are
counted."""

import json
from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given, settings, strategies as st

from track_range.detection.classes import ROAD_CLASSES
from track_range.detection.detections import Detections
from track_range.detection.evaluation.score_calibration import Reliability, evaluate_calibration
from track_range.detection.formats.image_labels.image_truth import ANY_CLASS, ImageTruth

N = len(ROAD_CLASSES)
CAR, BUS, TRUCK = (ROAD_CLASSES.index(name) for name in ("car", "bus", "truck"))


def square(x, side=10.0):
    return [x, 0.0, x + side, side]


def test_by_hand():
    # Bin 0.8-0.9: scores 0.8 and 0.88, one of them true; bin 0.3-0.4: 0.3, false; bin 0.9-1: 1.0,
    # true
    score = np.array([0.8, 0.88, 0.3, 1.0])
    reliability = Reliability.of(score, np.array([True, False, False, True]))
    assert reliability.n.tolist() == [0, 0, 0, 1, 0, 0, 0, 0, 2, 1]
    assert reliability.n_true.tolist() == [0, 0, 0, 0, 0, 0, 0, 0, 1, 1]
    assert reliability.mean_score[[3, 8, 9]] == pytest.approx([0.3, 0.84, 1.0])
    assert reliability.precision[[3, 8, 9]].tolist() == [0.0, 0.5, 1.0]
    assert reliability.ece == pytest.approx((2 * 0.34 + 0.3 + 0.0) / 4)
    assert reliability.mce == pytest.approx(0.34)
    assert reliability.overconfidence == pytest.approx((0.8 + 0.88 + 0.3 + 1.0) / 4 - 2 / 4)
    spread = np.sqrt([0.3 * 0.7, 0.8 * 0.2 + 0.88 * 0.12, 0.0])
    assert reliability.ece_if_calibrated == pytest.approx(np.sqrt(2 / np.pi) * spread.sum() / 4)


def test_calibrated_and_overconfident_detector():
    rng = np.random.default_rng(0)
    score, luck = rng.uniform(0.05, 1, 40_000), rng.uniform(0, 1, 40_000)
    calibrated, over = Reliability.of(score, luck < score), Reliability.of(score, luck < score**2)
    assert calibrated.ece < 0.012
    assert abs(calibrated.overconfidence) < 0.01
    expected = (1.05 / 2) - (1 - 0.05**3) / (3 * 0.95)  # means of s and s^2 between 0.05 and 1
    assert over.ece == pytest.approx(expected, abs=0.012)
    assert over.overconfidence == pytest.approx(expected, abs=0.01)
    under = Reliability.of(score, luck < np.sqrt(score))
    assert under.overconfidence < -0.1


@pytest.mark.parametrize("n", [60, 600])
def test_error_by_chance(n):
    """The expected ECE of calibrated scores is the mean over many draws."""
    rng = np.random.default_rng(3)
    score = rng.uniform(0.05, 1, n)
    draws = [Reliability.of(score, rng.uniform(0, 1, n) < score) for _ in range(300)]
    assert np.mean([draw.ece for draw in draws]) == pytest.approx(
        draws[0].ece_if_calibrated, rel=0.06
    )


@settings(deadline=None, max_examples=40)
@given(
    st.lists(st.tuples(st.integers(0, 1000), st.booleans()), min_size=1, max_size=60),
    st.integers(1, 20),
)
def test_equals_the_definition(rows, n_bins):
    score, is_true = np.array([k / 1000 for k, _ in rows]), np.array([true for _, true in rows])
    bins: dict[int, list[int]] = {}
    for i, (k, _) in enumerate(rows):
        bins.setdefault(min(k * n_bins // 1000, n_bins - 1), []).append(i)
    gaps = {m: abs(np.mean(is_true[i]) - np.mean(score[i])) for m, i in bins.items()}
    reliability = Reliability.of(score, is_true, n_bins=n_bins)
    assert {m: n for m, n in enumerate(reliability.n.tolist()) if n} == {
        m: len(i) for m, i in bins.items()
    }
    assert reliability.ece == pytest.approx(
        sum(len(bins[m]) * gap for m, gap in gaps.items()) / len(rows)
    )
    assert reliability.mce == pytest.approx(max(gaps.values()))


def test_counted_detections():
    truth = ImageTruth.of(
        [square(0), square(100), [200, 0, 300, 100], square(400)],
        [CAR, CAR, ANY_CLASS, BUS],
        is_ignored=[False, True, False, False],
        is_region=[False, False, True, False],
    )
    detections = Detections.of(
        # a match, its duplicate, two of ignored labels, one of low score, a bus, a truck of which
        # there are no labels
        [square(0), square(1), square(100), square(210), square(600), square(400), square(700)],
        [0.95, 0.55, 0.9, 0.9, 0.04, 0.75, 0.9],
        [CAR, CAR, CAR, CAR, CAR, BUS, TRUCK],
    )
    calibration = evaluate_calibration([detections], [truth], known_class_id=np.arange(N))
    assert sorted(calibration.by_class) == [CAR, BUS]
    assert (calibration.by_class[CAR].n.sum(), calibration.by_class[CAR].n_true.sum()) == (2, 1)
    assert calibration.by_class[CAR].ece == pytest.approx((0.05 + 0.55) / 2)
    assert calibration.overall.ece == pytest.approx((0.05 + 0.55 + 0.25) / 3)
    lower = evaluate_calibration([detections], [truth], known_class_id=np.arange(N), min_score=0.0)
    assert lower.by_class[CAR].n.sum() == 3
    no_bus = evaluate_calibration([detections], [truth], known_class_id=np.array([CAR]))
    assert list(no_bus.by_class) == [CAR]
    tall = evaluate_calibration(
        [detections], [truth], known_class_id=np.arange(N), min_height_px=20.0
    )
    assert tall.by_class == {}


def test_incompletely_labelled_images_are_excluded():
    full, part = ImageTruth.of([square(0)], [CAR]), ImageTruth.of([], [])
    part = replace(part, is_complete=np.arange(N) != CAR)
    detections = Detections.of([square(0)], [0.9], [CAR])
    calibration = evaluate_calibration(
        [detections, detections], [full, part], known_class_id=np.arange(N)
    )
    assert calibration.overall.n.sum() == 1


def test_json():
    truth = ImageTruth.of([square(0)], [CAR])
    detections = Detections.of([square(0), square(100)], [0.75, 0.25], [CAR] * 2)
    figures = evaluate_calibration([detections], [truth], known_class_id=np.arange(N)).as_dict()
    assert json.loads(json.dumps(figures, allow_nan=False)) == figures
    assert (figures["min_score"], figures["min_iou"]) == (0.05, 0.5)
    assert figures["classes"]["car"] == figures["all"]
    row = figures["all"]
    assert (row["n"], row["mean_score"], row["precision"], row["ece"]) == (2, 0.5, 0.5, 0.25)
    assert row["bins"][7] == {
        "from": pytest.approx(0.7), "to": pytest.approx(0.8), "n": 1, "n_true": 1, "mean_score": 0.75, "precision": 1.0
    }  # fmt: skip
    assert row["bins"][0]["precision"] is None
    empty = evaluate_calibration(
        [Detections.empty()], [truth], known_class_id=np.arange(N)
    ).as_dict()["all"]
    assert (empty["n"], empty["ece"], empty["mce"], empty["ece_if_calibrated"]) == (
        0,
        None,
        None,
        None,
    )


@pytest.mark.parametrize("n_bins", [0, -3])
def test_too_few_bins(n_bins):
    with pytest.raises(ValueError, match=f"n_bins: .*{n_bins}"):
        evaluate_calibration([], [], known_class_id=np.arange(N), n_bins=n_bins)


def test_unequal_numbers_of_images():
    with pytest.raises(ValueError, match="expected 1 images"):
        evaluate_calibration([], [ImageTruth.of([], [])], known_class_id=np.arange(N))
