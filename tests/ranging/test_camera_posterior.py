"""The posterior of the cameras against hand-worked numbers, and its sigmas against drawn truths."""

import math

import numpy as np
import pytest

from track_range.ranging.cameras.evidence import Evidence
from track_range.ranging.cameras.posterior import posterior
from track_range.ranging.cameras.unknowns import Prior, Unknown, camera_priors, mistakes

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
