"""Robust location and scale, and the jackknife."""

from __future__ import annotations

import numpy as np
import pytest

from track_range.foundation.robust_statistics import (
    jackknife_sigma,
    mad_sigma,
    median_of,
    quantile_of,
    weighted_median,
)


def test_mad_sigma_of_a_normal_distribution_with_outliers() -> None:
    values = np.random.default_rng(0).normal(5.0, 2.0, 20_000)
    assert mad_sigma(values) == pytest.approx(2.0, rel=0.03)
    values[:200] = 1e6
    assert mad_sigma(values) == pytest.approx(2.0, rel=0.05)


def test_mad_sigma_worked_by_hand() -> None:
    assert mad_sigma(np.array([1.0, 2.0, 4.0, 8.0, 100.0])) == pytest.approx(1.4826 * 3.0)


@pytest.mark.parametrize("dtype", [np.float32, np.float64])
@pytest.mark.parametrize("shape", [(1,), (2,), (7,), (8,), (3, 5), (4, 6), (2, 3, 300)])
def test_median_equals_that_of_numpy(shape: tuple[int, ...], dtype: type) -> None:
    values = np.random.default_rng(0).normal(size=shape).astype(dtype)
    expected = np.median(values, axis=-1)
    np.testing.assert_array_equal(median_of(values), expected)
    assert median_of(values).dtype == expected.dtype


@pytest.mark.parametrize("n", [1, 2, 5, 12])
@pytest.mark.parametrize("level", [0.0, 0.3, 0.8, 1.0])
def test_quantile_equals_that_of_numpy(n: int, level: float) -> None:
    values = np.random.default_rng(n).normal(size=n)
    assert quantile_of(values, level) == pytest.approx(np.quantile(values, level), rel=1e-12)


def test_weighted_median_with_equal_weights() -> None:
    for n in (1, 4, 7):
        values = np.random.default_rng(n).normal(size=n)
        assert weighted_median(values, np.full(n, 3.0)) == pytest.approx(np.median(values))


def test_weighted_median_with_unequal_weights() -> None:
    assert weighted_median(np.array([3.0, 1.0, 2.0]), np.array([100.0, 1.0, 1.0])) == pytest.approx(
        3.0, abs=0.02
    )
    # 0.5, 2.5; half is 2
    assert weighted_median(np.array([1.0, 2.0]), np.array([1.0, 3.0])) == pytest.approx(1.75)


def test_jackknife_sigma_is_the_standard_error() -> None:
    values = np.random.default_rng(1).normal(size=20)
    without_one = np.array([[np.delete(values, i).mean()] for i in range(20)])
    assert jackknife_sigma(without_one)[0] == pytest.approx(values.std(ddof=1) / np.sqrt(20))
