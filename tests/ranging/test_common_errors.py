"""Scale and disparity offset that objects have in common, on drawn objects."""

import numpy as np
import pytest

from track_range.ranging.cameras.common_errors import common_errors, common_scale

SCALE = 0.05
SIGMA = 0.08  # of the own error of an object


def drawn(n, offset_px, seed):
    """(N,) ratios, variances and inverse disparities of objects, of which every seventh is a
    mismatch."""
    rng = np.random.default_rng(seed)
    true_px = rng.uniform(8.0, 60.0, n)
    measured_px = true_px - offset_px
    own = rng.normal(0, np.hypot(SIGMA, 0.06), n) + 0.7 * (np.arange(n) % 7 == 6)
    value = SCALE + np.log(true_px / measured_px) + own
    return value, np.full(n, SIGMA**2), 1.0 / measured_px


@pytest.mark.parametrize("offset_px", [-4.0, 0.0, 4.0])
def test_near_and_far_objects_separate_scale_and_offset(offset_px):
    deviations = []
    for seed in range(30):
        errors = common_errors(*drawn(20, offset_px, seed))
        sigma = np.sqrt(np.diag(np.linalg.inv(errors.information)))
        assert sigma[1] < 3.5
        deviations.append((errors.mean - [SCALE, offset_px]) / sigma)
    assert 0.6 < np.std(deviations) < 1.5
    assert np.abs(np.mean(deviations, axis=0)).max() < 0.6


def test_objects_at_one_distance_do_not_separate_them():
    """A sum of the two is known; its parts are not."""
    rng = np.random.default_rng(1)
    errors = common_errors(rng.normal(0.2, 0.05, 20), np.full(20, SIGMA**2), np.full(20, 1 / 20.0))
    covariance = np.linalg.inv(errors.information)
    at_20_px = np.array([1.0, 1 / 20.0])
    assert np.sqrt(covariance[1, 1]) > 4.0
    assert np.sqrt(at_20_px @ covariance @ at_20_px) < 0.08


def test_equations_have_the_same_information():
    errors = common_errors(*drawn(20, 4.0, 5))
    rows = np.array(errors.equations())
    np.testing.assert_allclose(rows[:, :2].T @ rows[:, :2], errors.information)
    np.testing.assert_allclose(rows[:, :2] @ errors.mean, rows[:, 2])


def test_a_further_error_of_the_scale_widens_only_the_scale():
    plain = np.linalg.inv(common_errors(*drawn(20, 0.0, 3)).information)
    wide = np.linalg.inv(common_errors(*drawn(20, 0.0, 3), shared_variance=0.01).information)
    np.testing.assert_allclose(wide - plain, [[0.01, 0.0], [0.0, 0.0]], atol=1e-9)


def test_common_scale_of_one_object_may_be_that_of_a_mismatch():
    one = common_scale(np.array([0.3]), np.array([SIGMA**2]))
    three = common_scale(np.array([0.3, 0.25, 0.35]), np.full(3, SIGMA**2))
    assert one[0] == pytest.approx(0.3, abs=0.01)
    assert one[1] > 0.25
    assert three[1] < 0.1
