"""Plain curves by hand, and monotonic, positive safe curves."""

import numpy as np
import pytest
from hypothesis import given, settings, strategies as st

from track_range.ranging.size_models.plain_curves import PLAIN_CURVES, SAFE_CURVES, within_range

RNG = np.random.default_rng(3)
DISTANCE_M = RNG.uniform(8, 80, 400)
BEARING = RNG.uniform(-0.5, 0.5, 400)
SIZES = np.stack([1.7 / DISTANCE_M, 1.5 / DISTANCE_M], axis=1) * np.exp(
    RNG.normal(0, 0.03, (400, 2))
)
FITTED = {name: fit(SIZES, BEARING, DISTANCE_M) for name, fit in SAFE_CURVES.items()}
FITTED["log-linear"] = PLAIN_CURVES["log-linear"](SIZES, BEARING, DISTANCE_M)


def test_inverse_by_hand():
    """Two boxes, 0.1 at 10 m and 0.02 at 50 m, are on 1 / d = h."""
    sizes = np.array([[1.0, 0.1], [1.0, 0.02]])
    fitted = PLAIN_CURVES["inverse-height"](sizes, np.zeros(2), np.array([10.0, 50.0]))
    assert fitted(np.array([[9.0, 0.05]]), np.zeros(1)) == pytest.approx([20.0])


@pytest.mark.parametrize("name", ["diagonal-3", "height-3"])
def test_polynomial_recovers_its_coefficients(name):
    side = np.linspace(0.1, 1.0, 50)
    sizes = np.stack([0.75 * side, side], axis=1)
    size = np.hypot(*sizes.T) if name == "diagonal-3" else side
    expected = 90 - 80 * size + 30 * size**2 - 5 * size**3
    fitted = PLAIN_CURVES[name](sizes, np.zeros(50), expected)
    np.testing.assert_allclose(fitted(sizes, np.zeros(50)), expected, rtol=1e-9)


def test_log_linear_recovers_its_slopes():
    expected = np.exp(
        0.4 - 0.9 * np.log(SIZES[:, 1]) - 0.1 * np.log(SIZES[:, 0]) + 0.2 * np.abs(BEARING)
    )
    fitted = PLAIN_CURVES["log-linear"](SIZES, BEARING, expected)
    np.testing.assert_allclose(fitted(SIZES, -BEARING), expected, rtol=1e-9)


def test_safe_polynomial_outside_the_fitted_sizes():
    """Outside the fitted sizes the raw polynomial gives a negative distance for a near car."""
    near = np.array([[0.6, 0.5], [0.9, 0.75]])
    raw = PLAIN_CURVES["diagonal-5"](SIZES, BEARING, DISTANCE_M)(near, np.zeros(2))
    safe = FITTED["diagonal-5"](near, np.zeros(2))
    assert (np.abs(raw) > 100).any()
    assert ((safe > 1.0) & (safe < 8.0)).all()


@pytest.mark.parametrize("name", PLAIN_CURVES)
def test_no_distance_far_outside_of_the_fitted_ones(name):
    """Of cars at 10 to 60 m, a curve does not measure boxes as large as those at 0.5 to 4 m."""
    fit = within_range(PLAIN_CURVES[name])
    true_m = np.array([0.5, 1.0, 2.0, 3.0, 30.0])
    sizes = np.array([1.7, 1.5]) / true_m[:, None]
    distance_m = fit(SIZES, BEARING, DISTANCE_M)(sizes, np.zeros(5))
    raw_m = PLAIN_CURVES[name](SIZES, BEARING, DISTANCE_M)(sizes, np.zeros(5))
    is_far = (raw_m < DISTANCE_M.min() / 2) | (raw_m > 2 * DISTANCE_M.max())
    assert is_far[:-1].any()
    np.testing.assert_array_equal(distance_m, np.where(is_far, np.nan, raw_m))
    assert distance_m[-1] == raw_m[-1]


@pytest.mark.parametrize("name", FITTED)
def test_safe_curves_equal_raw_ones_where_decreasing(name):
    middle = (DISTANCE_M > 15) & (DISTANCE_M < 40)
    error = FITTED[name](SIZES[middle], BEARING[middle]) / DISTANCE_M[middle] - 1
    assert 0.005 < np.abs(error).mean() < 0.25


@given(
    st.sampled_from(sorted(FITTED)), st.floats(1e-4, 5.0), st.floats(1.0, 3.0), st.floats(0.2, 4.0)
)
@settings(deadline=None)
def test_distance_never_increases_with_size(name, height, ratio, aspect):
    sizes = np.array([[aspect * height, height], [aspect * height * ratio, height * ratio]])
    small, large = FITTED[name](sizes, np.zeros(2))
    assert 0 < large <= small * (1 + 1e-9)
