"""Plain curves by hand, and that the safe ones fall everywhere and never turn negative."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from track_range.ranging.size_models.plain_curves import PLAIN_CURVES, SAFE_CURVES

RNG = np.random.default_rng(3)
DISTANCE_M = RNG.uniform(8, 80, 400)
BEARING = RNG.uniform(-0.5, 0.5, 400)
SIZES = np.stack([1.7 / DISTANCE_M, 1.5 / DISTANCE_M], axis=1) * np.exp(RNG.normal(0, 0.03, (400, 2)))
FITTED = {name: curve.fit(SIZES, BEARING, DISTANCE_M) for name, curve in SAFE_CURVES.items()}
FITTED["log-linear"] = PLAIN_CURVES["log-linear"].fit(SIZES, BEARING, DISTANCE_M)


def test_the_inverse_by_hand():
    """Two boxes: 0.1 at 10 m and 0.02 at 50 m are on 1/d = h."""
    sizes = np.array([[1.0, 0.1], [1.0, 0.02]])
    fitted = PLAIN_CURVES["inverse-height"].fit(sizes, np.zeros(2), np.array([10.0, 50.0]))
    assert fitted.predict(np.array([[9.0, 0.05]]), np.zeros(1)) == pytest.approx([20.0])


@pytest.mark.parametrize("name", ["diagonal-3", "height-3"])
def test_a_polynomial_finds_the_one_that_it_was_made_with(name):
    side = np.linspace(0.1, 1.0, 50)
    sizes = np.stack([0.75 * side, side], axis=1)
    size = np.hypot(*sizes.T) if name == "diagonal-3" else side
    wanted = 90 - 80 * size + 30 * size**2 - 5 * size**3
    fitted = PLAIN_CURVES[name].fit(sizes, np.zeros(50), wanted)
    np.testing.assert_allclose(fitted.predict(sizes, np.zeros(50)), wanted, rtol=1e-9)


def test_log_linear_finds_slopes_and_bearing():
    wanted = np.exp(0.4 - 0.9 * np.log(SIZES[:, 1]) - 0.1 * np.log(SIZES[:, 0]) + 0.2 * np.abs(BEARING))
    fitted = PLAIN_CURVES["log-linear"].fit(SIZES, BEARING, wanted)
    np.testing.assert_allclose(fitted.predict(SIZES, -BEARING), wanted, rtol=1e-9)


def test_the_papers_polynomial_is_not_safe_and_the_safe_one_is():
    """Beyond the boxes that it was fitted on it says anything: the near car at a negative distance."""
    near = np.array([[0.6, 0.5], [0.9, 0.75]])
    raw = PLAIN_CURVES["diagonal-5"].fit(SIZES, BEARING, DISTANCE_M).predict(near, np.zeros(2))
    safe = FITTED["diagonal-5"].predict(near, np.zeros(2))
    assert (np.abs(raw) > 100).any()
    assert ((safe > 1.0) & (safe < 8.0)).all()


@pytest.mark.parametrize("name", FITTED)
def test_safe_curves_are_the_raw_ones_where_these_fall(name):
    middle = (DISTANCE_M > 15) & (DISTANCE_M < 40)
    error = FITTED[name].predict(SIZES[middle], BEARING[middle]) / DISTANCE_M[middle] - 1
    assert 0.005 < np.abs(error).mean() < 0.25


@given(st.sampled_from(sorted(FITTED)), st.floats(1e-4, 5.0), st.floats(1.0, 3.0), st.floats(0.2, 4.0))
@settings(deadline=None)
def test_distance_is_positive_and_never_rises_with_size(name, height, ratio, aspect):
    sizes = np.array([[aspect * height, height], [aspect * height * ratio, height * ratio]])
    small, large = FITTED[name].predict(sizes, np.zeros(2))
    assert 0 < large <= small * (1 + 1e-9)
