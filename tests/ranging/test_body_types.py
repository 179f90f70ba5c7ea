"""Body types: maximum a posteriori fit of a mixture of sizes."""

import numpy as np
import pytest

from track_range.ranging.fitting.prior_fit import STANDARD_BODIES, fit_body_types


def drawn(n_each, *, seed=0):
    """Log sizes of small vans 5 % higher than the standard ones, and of standard high-roof vans."""
    rng = np.random.default_rng(seed)
    small, high = (STANDARD_BODIES["van"][name].moments for name in ("small", "high roof"))
    raised = small[0] + np.array([0.05, 0.0, 0.0])
    return np.concatenate(
        [
            rng.multivariate_normal(raised, small[1], n_each),
            rng.multivariate_normal(*high, n_each // 3),
        ]
    )


def test_types_follow_the_objects():
    log_size = drawn(300)
    bodies = {body.name: body for body in fit_body_types("van", log_size, np.ones(len(log_size)))}
    assert bodies["small"].hwl_m[0] == pytest.approx(1.85 * np.exp(0.05), rel=0.02)
    assert bodies["high roof"].hwl_m[0] == pytest.approx(2.50, rel=0.03)
    assert bodies["small"].share + bodies["flat roof"].share > 0.6
    assert sum(body.share for body in bodies.values()) == pytest.approx(1.0, abs=1e-3)
    for body in bodies.values():
        assert np.linalg.eigvalsh(body.covariance).min() > 0


def test_without_objects_the_types_are_the_standard_ones():
    for name, standard in STANDARD_BODIES.items():
        for body in fit_body_types(name, np.zeros((0, 3)), np.zeros(0)):
            assert body.hwl_m == pytest.approx(standard[body.name].hwl_m, rel=1e-3)
            assert body.share == pytest.approx(standard[body.name].fraction, abs=1e-3)
            assert body.log_sigma == pytest.approx(standard[body.name].log_sigma, rel=1e-2)


def test_one_object_hardly_moves_a_type():
    far = np.log([[2.0, 1.8, 5.5]])
    bodies = fit_body_types("van", far, np.ones(1))
    for body, standard in zip(bodies, STANDARD_BODIES["van"].values(), strict=True):
        assert body.hwl_m[0] == pytest.approx(standard.hwl_m[0], rel=0.02)


def test_classes_without_types():
    assert fit_body_types("car", drawn(10), np.ones(13)) == ()
