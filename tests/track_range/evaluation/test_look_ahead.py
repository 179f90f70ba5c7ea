"""Tests of the combination of filters forwards and backwards in time."""

import numpy as np
import pytest

from track_range.evaluation.motion.measured_motion import combined
from track_range.foundation.constant_velocity import ConstantVelocity
from track_range.ranging.filtering.distance_filter import DistanceFilters, FilterSettings
from track_range.ranging.measurement.ranges import Ranges


def state(x, v, P_xx, P_xv, P_vv):
    return ConstantVelocity(
        *(np.atleast_1d(np.asarray(value, float)) for value in (x, v, P_xx, P_xv, P_vv))
    )


def test_by_hand():
    """Two states with equal covariances: the mean with half of them; backwards, the rate has the
    other sign."""
    both = combined(state(40.0, -5.0, 4.0, 1.0, 2.0), state(42.0, 7.0, 4.0, -1.0, 2.0))
    assert np.ravel(both.columns) == pytest.approx([41.0, -6.0, 2.0, 0.5, 1.0])


def test_unknown_states():
    nan = np.nan
    both = combined(state([40.0, nan, nan], [-5.0, nan, nan], *[[1.0] * 3, [0.0] * 3, [1.0] * 3]),
                    state([nan, 30.0, nan], [nan, 2.0, nan], *[[2.0] * 3, [0.0] * 3, [3.0] * 3]))  # fmt: skip
    assert both.x == pytest.approx([40.0, 30.0, nan], nan_ok=True)
    assert both.v == pytest.approx([-5.0, -2.0, nan], nan_ok=True)
    assert both.P_vv == pytest.approx([1.0, 3.0, nan], nan_ok=True)


def test_middle_of_a_drive():
    """Objects with random accelerations: the sigma is true, and far smaller than that of the frames
    so far."""
    rng, n, n_frames = np.random.default_rng(1), 500, 41
    steps = rng.normal(0, 0.5 * np.sqrt(0.1), (n_frames, n)).cumsum(axis=0)
    v_mps = rng.normal(-6.0, 2.0, n) + steps
    true_m = 60.0 + 0.1 * (v_mps.cumsum(axis=0) - v_mps / 2)
    measured_m = true_m * np.exp(rng.normal(0, 0.05, true_m.shape))
    middle, states = n_frames // 2, []
    for sign in (1.0, -1.0):
        filters = DistanceFilters(
            {"a": 1.0}, FilterSettings(acceleration_noise=0.5, learns_noise=False)
        )
        for step in range(middle + 1) if sign > 0 else range(n_frames - 1, middle - 1, -1):
            ranges = Ranges(np.arange(n), measured_m[step], 0.05 * measured_m[step])
            result = filters.update({"a": ranges}, sign * 0.1 * step)["a"]
        states.append(result.state)
    both = combined(*states)
    error = both.v - v_mps[middle]
    assert 0.85 < np.sqrt(np.mean(error**2 / both.P_vv)) < 1.15
    assert np.std(error) < 0.75 * np.std(states[0].v - v_mps[middle])
