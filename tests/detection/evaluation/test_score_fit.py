"""Fit of scores: recovered coefficients, classes with few matches, and cross-validation."""

import numpy as np
import pytest
from scipy.special import expit, logit

from track_range.detection.classes import ROAD_CLASSES
from track_range.detection.detections import Detections
from track_range.detection.evaluation.score_fit import (
    ScoreSamples,
    cross_validated,
    fit_scores,
    reliability,
)
from track_range.detection.formats.image_labels.image_truth import ImageTruth

PERSON, BICYCLE, CAR, BUS = (
    ROAD_CLASSES.index(name) for name in ("person", "bicycle", "car", "bus")
)


def drawn(class_id, n, slope, offset, seed=0):
    """Samples whose scores are wrong by a known slope and offset."""
    rng = np.random.default_rng(seed)
    score = rng.uniform(0.02, 0.98, n)
    is_match = rng.uniform(size=n) < expit(slope * logit(score) + offset)
    return ScoreSamples(np.full(n, class_id), score, is_match)


def joined(*parts):
    return ScoreSamples(
        *(
            np.concatenate([getattr(part, key) for part in parts])
            for key in ("class_id", "score", "is_match")
        )
    )


def test_coefficients_are_recovered():
    samples = joined(drawn(CAR, 20_000, 1.6, 0.4, seed=1), drawn(PERSON, 20_000, 0.8, -0.5, seed=2))
    fit = fit_scores(samples)
    assert fit.slope[[CAR, PERSON]] == pytest.approx([1.6, 0.8], abs=0.06)
    assert fit.offset[[CAR, PERSON]] == pytest.approx([0.4, -0.5], abs=0.06)
    assert (
        reliability(fit.probability(samples.score, samples.class_id), samples.is_match).ece < 0.015
    )
    assert fit.as_dict()["car"]["n_positives"] == fit.n_positives[CAR] > 5000


def test_classes_with_few_matches_share_the_coefficients_of_all():
    samples = joined(drawn(CAR, 4000, 1.5, 0.3), drawn(BUS, 30, 0.2, -3.0))
    fit = fit_scores(samples)
    assert fit.n_positives[BUS] < 40
    assert (fit.slope[BUS], fit.offset[BUS]) == (fit.slope[BICYCLE], fit.offset[BICYCLE])
    assert fit.slope[BUS] == pytest.approx(1.5, abs=0.2)


def test_a_class_deviates_less_the_fewer_its_matches():
    cars = drawn(CAR, 4000, 1.0, 0.0)
    few, many = (fit_scores(joined(cars, drawn(BUS, n, 2.5, 0.0, seed=3))) for n in (100, 4000))
    assert fit_scores(cars).slope[CAR] < few.slope[BUS] < many.slope[BUS]


def test_scores_that_separate_the_samples_do_not_become_certain():
    score = np.concatenate([np.linspace(0.6, 0.9, 60), np.linspace(0.1, 0.4, 40)])
    fit = fit_scores(ScoreSamples(np.full(100, CAR), score, np.arange(100) < 60))
    probability = fit.probability(np.array([0.3, 0.7]), np.array([CAR, CAR]))
    assert 0.001 < probability[0] < 0.2
    assert 0.8 < probability[1] < 0.999


def test_slopes_are_positive_also_if_low_scores_match():
    score = np.linspace(0.05, 0.95, 200)
    fit = fit_scores(ScoreSamples(np.full(200, CAR), score, np.arange(200) < 100))
    assert (fit.slope > 0).all()


def test_too_few_samples():
    score = np.linspace(0.1, 0.9, 60)
    assert fit_scores(ScoreSamples(np.full(60, CAR), score, np.arange(60) < 20)) is None
    assert fit_scores(ScoreSamples(np.full(60, CAR), score, np.full(60, True))) is None


def images(n, *, seed=0):
    """Images with one car each, detected at score s in a fraction s^2 of the cases; else the box is
    beside the car."""
    rng = np.random.default_rng(seed)
    detections, truth = [], []
    for score in rng.uniform(0.02, 1, n):
        x = 0.0 if rng.uniform() < score**2 else 100.0
        detections.append(Detections.of([[x, 0, x + 50, 40]], [score], [CAR]))
        truth.append(ImageTruth.of([[0, 0, 50, 40]], [CAR]))
    return detections, truth


def test_cross_validation_of_overconfident_scores():
    detections, truth = images(600)
    known = np.array([CAR])
    samples = ScoreSamples.of(detections, truth, known)
    assert len(samples.score) == 600
    before, after = (
        reliability(samples.score, samples.is_match),
        cross_validated(detections, truth, known),
    )
    assert before.ece > 0.1
    assert after.ece < 0.05
    assert cross_validated(detections[:10], truth[:10], known) is None


def test_unknown_and_unlabelled_classes_are_no_samples():
    detections, truth = images(50)
    assert len(ScoreSamples.of(detections, truth, np.array([PERSON])).score) == 0
    assert len(ScoreSamples.of([], [], np.arange(8)).score) == 0
