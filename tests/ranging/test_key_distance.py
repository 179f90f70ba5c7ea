"""Tests of the growth since a key frame as a measurement of the filters of distances."""

import numpy as np
import pytest

from track_range.foundation.constant_velocity import ConstantVelocity
from track_range.ranging.filtering.distance_filter import DistanceFilters, FilterSettings
from track_range.ranging.filtering.key_distance import Growth, KeyDistance
from track_range.ranging.filtering.observation import Observation
from track_range.ranging.measurement.ranges import Ranges
from track_range.stereo.odometry.ego_motion import EgoMotion

YES = np.array([[True]])


def growth(log_ratio, sigma, *, is_key=False):
    log_ratio = np.atleast_1d(log_ratio)
    return Growth(log_ratio, np.full(len(log_ratio), sigma), np.full(len(log_ratio), is_key))


def grown(key, state, measured, *, outlier_sigma=3.0):
    """Motion and key distance after a growth."""
    innovation = key.innovation(state, measured, valid=YES)
    return key.correct_by_growth(state, innovation, outlier_sigma=outlier_sigma)[:2]


def test_against_a_filter_of_three_states():
    """The same steps with matrices: state [d, v, r], a distance, a step of the systematic error,
    and a growth."""
    rng = np.random.default_rng(0)
    L = rng.normal(size=(3, 3))
    x, P = np.array([48.0, -6.0, 51.0]), L @ L.T + np.eye(3)
    state = ConstantVelocity(
        *(np.array([[value]]) for value in (x[0], x[1], P[0, 0], P[0, 1], P[1, 1]))
    )
    key = KeyDistance(*(np.array([[value]]) for value in (x[2], P[0, 2], P[1, 2], P[2, 2])))

    dt, q = 0.2, 0.7
    F = np.array([[1, dt, 0], [0, 1, 0], [0, 0, 1.0]])
    x, P = F @ x, F @ P @ F.T
    P[:2, :2] += q * np.array([[dt**3 / 3, dt**2 / 2], [dt**2 / 2, dt]])
    state, key = state.predict(dt, q=q), key.predict(np.array([[dt]]))

    step, c = 2.5, x[2] / x[0]
    P += step * np.outer([1, 0, c], [1, 0, c])
    state = ConstantVelocity(state.x, state.v, state.P_xx + step, state.P_xv, state.P_vv)
    key = key.step(state.x, np.array([[step]]))

    for H, nu, R, update in (
        (np.array([1.0, 0, 0]), 1.2, 3.0, "distance"),
        (None, None, 0.01**2, "growth"),
    ):
        if update == "distance":
            S = state.P_xx + R
            key = key.correct(state, np.array([[nu]]), S)
            state = state.correct(np.array([[nu]]), S)
        else:
            H, nu = np.array([-1 / x[0], 0, 1 / x[2]]), 0.06 - np.log(x[2] / x[0])
            state, key = grown(key, state, growth(0.06, 0.01), outlier_sigma=99.0)
        K = P @ H / (H @ P @ H + R)
        x, P = x + K * nu, P - np.outer(K, H @ P)
    assert np.ravel([state.x, state.v, key.r]) == pytest.approx(x)
    got = np.ravel([state.P_xx, state.P_xv, key.P_dr, state.P_vv, key.P_vr, key.P_rr])
    assert got == pytest.approx(P[np.triu_indices(3)])


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


def test_outliers_count_less():
    """A growth of 30 % that was measured with a sigma of 1 % changes the rate by less than one of 2
    %."""
    change_mps = []
    for log_ratio in (0.03, 0.3):
        zero = np.zeros((1, 1))
        state = ConstantVelocity(zero + 50.0, zero - 2.5, zero + 4.0, zero + 1.0, zero + 1.0)
        key = KeyDistance(zero + 50.5, zero + 3.8, zero + 0.8, zero + 4.0)
        after, _ = grown(key, state, growth(log_ratio, 0.01))
        change_mps.append(float(after.v[0, 0] - state.v[0, 0]))
    assert -1.0 < change_mps[1] < 0 > change_mps[0]
    assert abs(change_mps[1]) < 3 * abs(change_mps[0])


def test_without_a_key_frame_nothing_changes():
    zero = np.zeros((1, 1))
    state = ConstantVelocity(zero + 50.0, zero - 2.5, zero + 4.0, zero + 1.0, zero + 1.0)
    none = KeyDistance(zero * np.nan, zero, zero, zero)
    after, key = grown(none, state, growth(0.1, 0.01))
    assert np.array_equal(after.columns, state.columns)
    assert np.isnan(key.r).all()
    started = key.start(state, np.array([True]))
    assert np.ravel(started) == pytest.approx([50.0, 4.0, 1.0, 4.0])


def test_a_key_frame_whose_covariance_is_impossible_is_given_up():
    """Correlations above 1, as rounding and steps far from linear leave them: the state stays as it
    was."""
    state = ConstantVelocity(*(np.array([[value]]) for value in (30.0, -6.0, 10.0, 0.0, 1.0)))
    key = KeyDistance(*(np.array([[value]]) for value in (60.0, 12.0, 20.0, 40.0)))
    after, given_up = grown(key, state, growth(0.9, 0.003))
    assert np.array_equal(after.columns, state.columns)
    assert np.isnan(given_up.r).all()
    key = key._replace(P_vr=np.array([[2.0]]))
    after, kept = grown(key, state, growth(0.9, 0.003))
    assert 0 < after.P_xx.item() < 10
    assert 0 < after.P_vv.item() <= 1
    assert np.isfinite(kept.r).all()


def test_a_model_that_predicts_an_object_behind_the_camera_is_not_measured():
    """Its ratio of distances is negative and has no logarithm."""
    state = ConstantVelocity(*np.array([-0.06, -63.0, 19.0, 0.0, 1.0]).reshape(5, 1, 1))
    key = KeyDistance(*np.array([62.0, 0.0, 0.0, 4.0]).reshape(4, 1, 1))
    innovation = key.innovation(state, growth(0.06, 0.01), valid=YES)
    assert not innovation.valid.any()
    after, _, used = key.correct_by_growth(state, innovation, outlier_sigma=3.0)
    assert used.item() == 0.0
    np.testing.assert_array_equal(after.columns, state.columns)
