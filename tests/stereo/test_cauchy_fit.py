"""Linear fits of values of which some are wrong."""

import numpy as np
import pytest

from track_range.stereo.geometry.cauchy_fit import cauchy_fit


def test_cauchy_fit_of_a_line_with_wrong_values() -> None:
    """One value in twenty is wrong by 5 or more; the errors of 300 fits are as stated."""
    rng = np.random.default_rng(0)
    x = np.linspace(-1.0, 1.0, 200)
    design = np.stack([np.ones(200), x], axis=1)
    sigmas = []
    for _ in range(300):
        values = 3.0 - 2.0 * x + 0.1 * rng.normal(size=200)
        values[rng.random(200) < 0.05] += rng.uniform(5.0, 20.0)
        fit = cauchy_fit(design, values, least_scale=0.01, n_rounds=6)
        assert fit.residual == pytest.approx(values - design @ fit.solution)
        sigmas.append((fit.solution - [3.0, -2.0]) / np.sqrt(np.diag(fit.covariance)))
    assert np.abs(np.mean(sigmas, axis=0)).max() < 0.6
    assert 0.8 < np.std(sigmas) < 1.2


def test_cauchy_fit_of_exact_values_has_the_least_scale() -> None:
    design = np.stack([np.ones(50), np.arange(50.0)], axis=1)
    fit = cauchy_fit(design, design @ [1.0, 0.5], least_scale=0.2)
    assert fit.solution == pytest.approx([1.0, 0.5], abs=1e-4)
    # variance of a mean of 50 values at their middle
    middle = np.array([1.0, 24.5])
    assert middle @ fit.covariance @ middle == pytest.approx(0.2**2 / 50, rel=0.01)
