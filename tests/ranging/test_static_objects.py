"""Tests of the two hypotheses of a static and of a moving object."""

import numpy as np
import pytest

from track_range.foundation.constant_velocity import ConstantVelocity
from track_range.ranging.filtering.distance_filter import DistanceFilters
from track_range.ranging.filtering.static_objects import with_static_hypothesis
from track_range.ranging.ranges import Ranges


def result(v, sigma_mps, static_mps, *, d=50.0, systematic=0.0):
    v, sigma_mps = np.atleast_1d(v), np.atleast_1d(sigma_mps)
    state = ConstantVelocity(d + 0 * v, v, 0 * v + 4.0, 0.5 * sigma_mps, sigma_mps**2)
    return with_static_hypothesis(
        state, np.full(len(v), systematic), np.full(len(v), static_mps), ego_sigma_mps=0.0, own_sigma_mps=8.0
    )


def test_by_hand():
    """v = -12 with a sigma of 2 m/s, static objects at -10: s_0^2 = 0.25 + 0.09, S = 4.34, under M 4 + 64."""
    rated = result(-12.0, 2.0, -10.0)
    likelihoods = np.sqrt(68 / 4.34) * np.exp(-2 * (1 / 4.34 - 1 / 68))
    p = 1 / (1 + 3 / likelihoods)
    step = 4 / 4.34 * 2
    assert rated.v == pytest.approx([-12.0 + p * step])
    assert rated.P_vv == pytest.approx([4 * (1 - p * 4 / 4.34) + p * (1 - p) * step**2])
    assert rated.P_xv == pytest.approx([1.0 * (1 - p * 4 / 4.34)])
    assert (rated.x, rated.P_xx) == (50.0, 4.0)


def test_limits():
    """Unknown ego speed and clearly moving objects: the filter's rate; a precise rate of a static object stays."""
    for rated, expected_mps, sigma_mps in (
        (result(-12.0, 2.0, np.nan), -12.0, 2.0),
        (result(-25.0, 2.0, -10.0), -25.0, 2.0),
        (result(80.0, 2.0, 0.0), 80.0, 2.0),
        (result(-10.1, 0.05, -10.0), -10.1, 0.05),
    ):
        assert rated.v == pytest.approx([expected_mps], abs=0.02)
        assert np.sqrt(rated.P_vv) == pytest.approx([sigma_mps], rel=0.02)
    # The systematic error counts as an error of the rate: 10 % of 12 m/s.
    assert result(-12.0, 0.5, np.nan, systematic=0.01).P_vv == pytest.approx([0.25 + 1.44])


def test_sigma_is_true_for_static_and_moving_objects():
    rng = np.random.default_rng(3)
    n, ego_mps = 40_000, 12.0
    own_mps = np.where(rng.random(n) < 0.25, rng.normal(0, 0.5, n), rng.normal(0, 8.0, n))
    sigma_mps = rng.uniform(0.3, 4.0, n)
    measured_mps = own_mps - ego_mps + rng.normal(0, sigma_mps)
    rated = result(measured_mps, sigma_mps, -ego_mps)
    error, sigma = rated.v - (own_mps - ego_mps), np.sqrt(rated.P_vv)
    assert 0.97 < np.sqrt(np.mean((error / sigma) ** 2)) < 1.06
    is_static = np.abs(own_mps) < 1.0
    gain = np.abs(error[is_static]).mean() / np.abs(measured_mps - own_mps + ego_mps)[is_static].mean()
    assert 0.3 < gain < 0.75


def test_objects_beside_a_turning_camera():
    """Yaw to the right by 0.2 rad/s, object 30 m away at a bearing of 0.5: a static one has -10 + 3 m/s."""
    from track_range.ranging.filtering.cut_boxes import CutBoxes

    zero = np.zeros(1)
    cut = CutBoxes(zero > 0, zero, zero, zero + 4.2, zero + 0.5)
    rates = {}
    for yaw_rad_s in (0.0, 0.2):
        filters = DistanceFilters({"a": 0.5})
        rng = np.random.default_rng(2)
        for step in range(10):
            ranges = Ranges(np.array([1]), np.array([37.0 - 0.7 * step + rng.normal(0, 0.3)]), np.array([0.6]))
            options = {"ego_speed_mps": 10.0, "ego_sigma_mps": 0.1, "yaw_rad_s": yaw_rad_s, "cut": cut}
            filtered = filters.update({"a": ranges}, 0.1 * step, **options)["a"]
        rates[yaw_rad_s] = float(filtered.rate_mps[0]), float(filtered.rate_sigma_mps[0])
    assert rates[0.2][0] == pytest.approx(-7.0, abs=0.5)
    assert rates[0.2][1] < 0.8 * rates[0.0][1]
