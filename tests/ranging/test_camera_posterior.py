"""The posterior of the cameras against hand-worked numbers, and its sigmas against drawn truths."""

import math
from dataclasses import replace

import numpy as np
import pytest

from track_range.ranging.cameras.evidence import Evidence
from track_range.ranging.cameras.posterior import posterior
from track_range.ranging.cameras.unknowns import Prior, Unknown, camera_priors, mistakes
from track_range.stereo.geometry.focal_curve import FocalCurve
from track_range.stereo.geometry.focal_guess import FocalGuess

RIG, FOCAL, HEIGHT = {Unknown.BASELINE: 1.0}, {Unknown.FOCAL: 1.0}, {Unknown.HEIGHT: 1.0}


def test_equal_parts_of_prior_and_evidence():
    """Both have a sigma of 0.1: the mean is half of the value, and sigma is 0.1 / sqrt(2)."""
    cameras = posterior(
        {Unknown.FOCAL: Prior(0.1, "unknown")}, [Evidence("a turn", FOCAL, 0.2, 0.1)]
    )
    mean, sigma = cameras.estimate(FOCAL)
    assert (mean, sigma) == pytest.approx((0.1, 0.1 / math.sqrt(2)))
    assert cameras.correction(FOCAL) == pytest.approx(0.1)
    assert cameras.sigma_of(FOCAL, 0.1) == pytest.approx(0.1 / math.sqrt(2), rel=1e-6)
    # not corrected: the errors have a mean of 0.1, which is in their sigma
    assert 0.11 < cameras.sigma_of(FOCAL) < 0.14


def test_an_unknown_baseline_is_estimated_and_not_doubted():
    priors = {Unknown.BASELINE: Prior(3.0, "unknown"), Unknown.FOCAL: Prior(0.01)}
    of_both = {**RIG, **FOCAL}
    cameras = posterior(priors, [Evidence("the speed", of_both, 0.4, 0.02)])
    assert cameras.correction(of_both) == pytest.approx(0.4, abs=0.01)
    assert cameras.correction(FOCAL) == pytest.approx(0.0, abs=0.01)
    assert cameras.sigma_of(of_both, 0.4) == pytest.approx(0.02, rel=0.3)
    # the speed does not tell which of the two is wrong, but only one of them was given
    assert cameras.probability(None) > 0.95


def test_without_evidence_sigma_is_that_of_the_calibration():
    """Mistakes that nothing points to do not widen it."""
    for sigma in (0.0, 0.03):
        cameras = posterior(camera_priors(800.0, baseline_m=0.5, scale_sigma=sigma), [])
        assert cameras.sigma_of(RIG) == pytest.approx(math.hypot(0.005, sigma), rel=1e-3)
        assert cameras.probability(None) == pytest.approx(1.0)


def test_sigma_grows_steadily_with_a_contradiction():
    priors = camera_priors(800.0, baseline_m=0.5)
    values = np.arange(0.0, 0.6, 0.005)
    sigmas = []
    for value in values.tolist():
        cameras = posterior(priors, [Evidence("sizes", RIG, value, 0.07)])
        sigmas.append(cameras.sigma_of(RIG))
    assert sigmas[0] < 0.008
    assert np.all(np.diff(sigmas) > -1e-6)
    assert np.max(np.diff(sigmas)) < 0.03
    # in the end, sigma covers both scales
    assert sigmas[-1] == pytest.approx(1 - math.exp(-0.57), abs=0.06)


def two_peaks(first_px, second_px, sigma=0.02):
    """A curve with two normal peaks of equal probability."""
    log_focal = np.linspace(math.log(400), math.log(1600), 1201)
    peaks = [(log_focal - math.log(px)) / sigma for px in (first_px, second_px)]
    return FocalCurve(log_focal, np.logaddexp(*(-0.5 * peak**2 for peak in peaks)))


def test_a_normal_curve_is_a_normal_prior():
    log_focal = np.linspace(math.log(400), math.log(1600), 1201)
    curve = FocalCurve.of_guess(FocalGuess(840.0, 0.05, ""), log_focal)
    shown = Evidence("the speed", {**HEIGHT, Unknown.FOCAL: -1.0}, 0.1, 0.03)
    sizes = Evidence("sizes", HEIGHT, 0.02, 0.08)
    both = []
    for focal in (Prior(0.05, "unknown", 800.0, curve), Prior(0.05, "unknown", 840.0)):
        cameras = posterior(
            {Unknown.FOCAL: focal, Unknown.HEIGHT: Prior(0.2, "unknown")},
            [replace(shown, value=0.1 + math.log(840 / 800) * (focal.curve is not None)), sizes],
        )
        both.append(
            [
                *cameras.estimate(HEIGHT),
                cameras.estimate(FOCAL).mean - math.log(focal.value),
                cameras.estimate(FOCAL).sigma,
                cameras.covariance_of(HEIGHT, FOCAL),
            ]
        )
    assert both[0] == pytest.approx(both[1], rel=0.02)


def test_evidence_chooses_between_the_peaks_of_a_curve():
    """Heights of 1.2 times the expected one belong to 1 / 1.2 of the focal length."""
    priors = {
        Unknown.FOCAL: Prior(0.3, "unknown", 800.0, two_peaks(800.0, 1000.0)),
        Unknown.HEIGHT: Prior(0.05, "given", 1.5),
    }
    alone = posterior(priors, [])
    mean, sigma = alone.estimate(FOCAL)
    assert mean == pytest.approx(-math.log(1000 / 800) / 2, abs=1e-3)
    assert sigma == pytest.approx(math.hypot(math.log(1000 / 800) / 2, 0.02), rel=0.01)
    # h - f = log(1.25): either f = log(800 / 1000), or the height is 4.5 sigma too small
    cameras = posterior(
        priors, [Evidence("the speed", {**HEIGHT, Unknown.FOCAL: -1.0}, math.log(1.25), 0.01)]
    )
    assert cameras.correction(FOCAL) == pytest.approx(math.log(800 / 1000), abs=0.02)
    assert cameras.correction(HEIGHT) == pytest.approx(0.0, abs=0.03)


def test_curve_of_a_sum_of_unknowns():
    """By the speed and the height, the focal length is known as well as both together."""
    priors = {Unknown.FOCAL: Prior(3.0, "unknown"), Unknown.HEIGHT: Prior(0.04, "unknown")}
    cameras = posterior(priors, [Evidence("the speed", {**HEIGHT, Unknown.FOCAL: -1.0}, 0.2, 0.03)])
    values = np.array([-0.2, -0.2 + 0.05, -0.2 - 0.1])
    log_p = cameras.log_density(FOCAL, values)
    assert log_p[0] - log_p[1:] == pytest.approx([0.5, 2.0], rel=0.01)


@pytest.mark.slow
def test_errors_of_drawn_drives_are_within_sigma_as_often_as_stated():
    """Baselines and sizes are drawn from their priors."""
    rng = np.random.default_rng(0)
    priors = camera_priors(800.0, baseline_m=0.5)
    parts = mistakes(Unknown.BASELINE)
    weights = np.exp([part.log_weight for part in parts])
    is_wrong = rng.random(4000) < weights.sum()
    within = np.zeros(2)
    for wrong in is_wrong.tolist():
        error = rng.normal(0, 0.005)
        if wrong:
            part = parts[rng.choice(len(parts), p=weights / weights.sum())]
            error = rng.normal(part.mean, part.sigma)
        shown = Evidence("sizes", RIG, error + rng.normal(0, 0.07), 0.07)
        sigma = posterior(priors, [shown]).sigma_of(RIG)
        within += [abs(1 - math.exp(-error)) < k * sigma for k in (1, 2)]
    assert 0.66 < within[0] / len(is_wrong) < 0.78
    assert 0.945 < within[1] / len(is_wrong) < 0.975


def test_a_bound_counts_only_where_it_is_broken():
    priors = {Unknown.BASELINE: Prior(0.1, "unknown")}
    low, high = Evidence("slow", RIG, -0.3, 0.1), Evidence("fast", RIG, 0.3, 0.1)
    assert posterior(priors, [], bounds=[low]).estimate(RIG) == pytest.approx((0.0, 0.1))
    assert posterior(priors, [], bounds=[high]).estimate(RIG).mean == pytest.approx(0.15)


def test_evidence_that_may_be_wrong_and_usual_values_exclude_nothing_alone():
    priors = {Unknown.HEIGHT: Prior(0.1, "given")}
    for max_chi2, is_believed in ((4.0, True), (math.inf, False)):
        lane = Evidence("the lane lines", HEIGHT, 0.7, 0.1, max_chi2)
        p_right = posterior(priors, [lane]).probability(None)
        assert (p_right > 0.8) == is_believed
    usual = posterior({Unknown.HEIGHT: Prior(0.1, "usual")}, [Evidence("lines", HEIGHT, 0.7, 0.1)])
    assert usual.probability(None) == pytest.approx(1.0)
    assert usual.correction(HEIGHT) == pytest.approx(0.69, abs=0.02)
