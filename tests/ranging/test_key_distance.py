"""Tests of the growth since a key frame as a measurement of the filters of distances."""

import numpy as np
import pytest

from track_range.ranging.filtering.distance_filter import DistanceFilters, FilterSettings
from track_range.ranging.filtering.key_distance import correct_by_growth, innovation
from track_range.ranging.filtering.observation import Observation
from track_range.ranging.filtering.target_states import TargetStates
from track_range.ranging.measurement.growth import Growth
from track_range.ranging.measurement.ranges import Ranges
from track_range.stereo.odometry.ego_motion import EgoMotion

YES = np.array([[[True]]])


def growth(log_ratio, sigma, *, is_key=False):
    log_ratio = np.atleast_1d(log_ratio)
    return Growth(log_ratio, np.full(len(log_ratio), sigma), np.full(len(log_ratio), is_key))


def states_of(x, P):
    """The states of one filter with the mean [d v a r] and the covariance (4, 4)."""
    return TargetStates(np.column_stack([P, x])[..., None, None, None])


def grown(states, measured, *, outlier_sigma=3.0):
    """A copy of the states after a growth."""
    states = TargetStates(states.table.copy())
    shown = innovation(states, measured, valid=YES)
    correct_by_growth(states, shown, outlier_sigma=outlier_sigma)
    return states


def run(sigma_growth, *, seed=0, n=400, n_frames=15, offset=1.2):
    """Objects that start at 60 m, closing at 8 m/s, with distances that are 20 % too long, and
    growths of 1 %."""
    rng = np.random.default_rng(seed)
    filters = DistanceFilters(
        {"a": 0.7},
        FilterSettings(max_rate_sigma_mps=99.0, acceleration_noise=0.5, learns_noise=False),
    )
    key_m = np.full(n, np.nan)
    for step in range(n_frames):
        true_m = 60.0 - 0.8 * step
        distance_m = offset * true_m * np.exp(rng.normal(0, 0.08, n))
        log_ratio = np.log(key_m / true_m) + rng.normal(0, 0.01, n)
        measured = Ranges(
            np.arange(n), distance_m, distance_m * np.hypot(0.08, 0.2), distance_m * 0.2
        )
        is_key = step % 6 == 0
        seen = None if sigma_growth is None else growth(log_ratio, sigma_growth, is_key=is_key)
        result = filters.update({"a": measured}, 0.1 * step, observation=Observation(growth=seen))[
            "a"
        ]
        key_m = np.full(n, true_m) if is_key else key_m
    return result, true_m


def test_growth_makes_rates_precise_and_their_sigma_true():
    """The rate has the relative error of the distance, the time to collision has none."""
    with_growth, true_m = run(0.01)
    without, _ = run(None)
    for result, spread_mps in ((with_growth, (0.4, 0.8)), (without, (1.2, 4.5))):
        assert spread_mps[0] < np.std(result.state.v) < spread_mps[1]
        assert 0.8 < np.std(result.state.v) / np.sqrt(result.state.P_vv).mean() < 1.2
    assert with_growth.state.v.mean() == pytest.approx(-8.0 * 1.2, abs=0.4)
    assert np.median(with_growth.ttc_s) == pytest.approx(true_m / 8.0, rel=0.05)


def test_growth_tells_moving_from_static_objects():
    """Cars ahead at 4 m/s, from a camera at 10 m/s: with noisy distances alone, most appear to be
    parked."""
    n, rng, close = 200, np.random.default_rng(5), {}
    for has_growth in (False, True):
        filters, key_m = DistanceFilters({"a": 0.7}), np.full(n, np.nan)
        for step in range(12):
            true_m = np.full(n, 60.0 - 0.6 * step)
            distance_m = true_m * np.exp(rng.normal(0, 0.1, n))
            log_ratio, is_key = np.log(key_m / true_m) + rng.normal(0, 0.008, n), step == 0
            measured = Ranges(np.arange(n), distance_m, 0.14 * distance_m, 0.1 * distance_m)
            seen = growth(log_ratio, 0.008, is_key=is_key) if has_growth else None
            result = filters.update(
                {"a": measured},
                0.1 * step,
                observation=Observation(growth=seen),
                ego=EgoMotion(10.0, 0.1),
            )
            key_m = true_m if is_key else key_m
        close[has_growth] = np.mean(np.abs(result["a"].state.v + 6.0) < 1.5)
    assert 0.0 <= close[False] < 0.4
    assert 0.75 < close[True] <= 1.0


def covariance(P_dd, P_dv, P_vv, P_dr, P_vr, P_rr):
    """(4, 4) covariance of [d v a r]; a is known."""
    return np.array(
        [[P_dd, P_dv, 0, P_dr], [P_dv, P_vv, 0, P_vr], [0, 0, 0, 0], [P_dr, P_vr, 0, P_rr]]
    )


def test_outliers_count_less():
    """A growth of 30 % that was measured with a sigma of 1 % changes the rate by less than one of 2
    %."""
    before = states_of([50.0, -2.5, 0.0, 50.5], covariance(4.0, 1.0, 1.0, 3.8, 0.8, 4.0))
    change_mps = [
        (grown(before, growth(log_ratio, 0.01)).v - before.v).item() for log_ratio in (0.03, 0.3)
    ]
    assert -1.0 < change_mps[1] < 0 > change_mps[0]
    assert abs(change_mps[1]) < 3 * abs(change_mps[0])


def test_without_a_key_frame_nothing_changes():
    before = states_of([50.0, -2.5, 0.0, np.nan], covariance(4.0, 1.0, 1.0, 0.0, 0.0, 0.0))
    after = grown(before, growth(0.1, 0.01))
    np.testing.assert_array_equal(after.table, before.table)


def test_a_key_frame_whose_covariance_is_impossible_is_given_up():
    """Correlations above 1, as rounding and steps far from linear leave them: the state stays as it
    was."""
    x = [30.0, -6.0, 0.0, 60.0]
    before = states_of(x, covariance(10.0, 0.0, 1.0, 12.0, 20.0, 40.0))
    after = grown(before, growth(0.9, 0.003))
    np.testing.assert_array_equal(after.motion.columns, before.motion.columns)
    assert np.isnan(after.r).all()
    kept = grown(states_of(x, covariance(10.0, 0.0, 1.0, 12.0, 2.0, 40.0)), growth(0.9, 0.003))
    assert 0 < kept.P_dd.item() < 10
    assert 0 < kept.P[1, 1].item() <= 1
    assert np.isfinite(kept.r).all()


def test_a_model_that_predicts_an_object_behind_the_camera_is_not_measured():
    """Its ratio of distances is negative and has no logarithm."""
    before = states_of([-0.06, -63.0, 0.0, 62.0], covariance(19.0, 0.0, 1.0, 0.0, 0.0, 4.0))
    assert not innovation(before, growth(0.06, 0.01), valid=YES).valid.any()
    np.testing.assert_array_equal(grown(before, growth(0.06, 0.01)).table, before.table)
