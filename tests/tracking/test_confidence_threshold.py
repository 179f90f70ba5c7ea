from __future__ import annotations

import numpy as np
import pytest

from track_range.detection.classes import ROAD_CLASSES
from track_range.detection.detections import Detections
from track_range.tracking.confidence_threshold import (
    ConfidenceThreshold,
    ConfidenceThresholdSettings,
)

CAR, TRUCK, PERSON = (ROAD_CLASSES.index(name) for name in ("car", "truck", "person"))


def stream(
    threshold: ConfidenceThreshold,
    *,
    n_frames: int,
    true_from: float,
    class_id: int = CAR,
    seed: int = 0,
) -> None:
    """Frames of 20 static objects with scores from `true_from` to 1, and 20 random false boxes with
    lower scores."""
    rng = np.random.default_rng(seed)
    corner = np.stack([100.0 * np.arange(20), np.zeros(20)], axis=1)
    for _ in range(n_frames):
        false_corner = np.stack([100.0 * np.arange(20), rng.uniform(100, 5000, 20)], axis=1)
        at = np.concatenate([corner, false_corner])
        score = np.concatenate([rng.uniform(true_from, 1.0, 20), rng.uniform(0.1, true_from, 20)])
        threshold.update(
            Detections.of(np.concatenate([at, at + 40.0], axis=1), score, np.full(40, class_id))
        )


@pytest.mark.parametrize("true_from", [0.45, 0.6, 0.8])
def test_threshold_where_boxes_persist(true_from: float) -> None:
    threshold = ConfidenceThreshold(ConfidenceThresholdSettings())
    stream(threshold, n_frames=60, true_from=true_from)
    assert threshold.of(np.array([CAR]))[0] == pytest.approx(true_from, abs=0.07)


def test_initial_threshold() -> None:
    threshold = ConfidenceThreshold(ConfidenceThresholdSettings(first=0.55))
    assert threshold.of(np.array([CAR, PERSON])).tolist() == [0.55, 0.55]
    assert threshold.of(np.zeros(0, np.int64)).shape == (0,)


def test_prior_outweighs_a_single_frame() -> None:
    """A single box against the prior's ten boxes in every bin."""
    threshold = ConfidenceThreshold(ConfidenceThresholdSettings(first=0.55))
    box = Detections.of([[0, 0, 40, 40]], [0.95], [CAR])
    threshold.update(box)
    threshold.update(box)
    assert threshold.of(np.array([CAR]))[0] == pytest.approx(0.55, abs=0.02)


def test_groups_of_classes_are_independent() -> None:
    threshold = ConfidenceThreshold(ConfidenceThresholdSettings())
    stream(threshold, n_frames=60, true_from=0.8, class_id=PERSON)
    person, car, truck = threshold.of(np.array([PERSON, CAR, TRUCK]))
    assert person > 0.7
    assert car == truck == 0.4  # detectors confuse cars and trucks


def test_limits_for_perfect_and_useless_detectors() -> None:
    good, bad = (
        ConfidenceThreshold(ConfidenceThresholdSettings()),
        ConfidenceThreshold(ConfidenceThresholdSettings()),
    )
    rng = np.random.default_rng(2)
    corner = np.stack([100.0 * np.arange(40), np.zeros(40)], axis=1)
    for _ in range(60):
        good.update(
            Detections.of(
                np.concatenate([corner, corner + 40], axis=1), rng.uniform(0.1, 1, 40), [CAR] * 40
            )
        )
    assert good.of(np.array([CAR]))[0] == 0.3
    stream(bad, n_frames=60, true_from=0.97)
    assert bad.of(np.array([CAR]))[0] == 0.9


def test_fixed_threshold_and_sampling_of_many_boxes() -> None:
    threshold = ConfidenceThreshold(ConfidenceThresholdSettings(min_fraction=0.0, first=0.2))
    stream(threshold, n_frames=30, true_from=0.8)
    assert threshold.of(np.array([CAR]))[0] == 0.2
    crowd = ConfidenceThreshold(ConfidenceThresholdSettings())
    rng = np.random.default_rng(4)
    at = rng.uniform(0, 10_000, (5000, 2))
    for _ in range(3):
        crowd.update(
            Detections.of(
                np.concatenate([at, at + 10], axis=1), np.full(5000, 0.95), np.full(5000, CAR)
            )
        )
    assert crowd.of(np.array([CAR]))[0] == pytest.approx(0.4, abs=0.02)


def test_frames_without_boxes() -> None:
    threshold = ConfidenceThreshold(ConfidenceThresholdSettings())
    for _ in range(3):
        threshold.update(Detections.empty())
    stream(threshold, n_frames=1, true_from=0.5)
    threshold.update(Detections.empty())
    assert 0.3 <= threshold.of(np.array([CAR]))[0] <= 0.9
