import numpy as np
import pytest
from filterpy.kalman import KalmanFilter

from ranging.ranges import Ranges
from ranging.smoothing import DistanceFilter, FilterSettings

SETTINGS = FilterSettings(noise_share=1.0, outlier_sigma=np.inf)


def measured(ids, distance_m, sigma_m=1.0):
    distance_m = np.array(distance_m, float)
    return Ranges(np.array(ids), distance_m, np.where(np.isnan(distance_m), np.nan, sigma_m))


def test_equals_filterpy_with_uneven_steps():
    rng = np.random.default_rng(1)
    ours = DistanceFilter(SETTINGS)
    oracle = KalmanFilter(dim_x=2, dim_z=1)
    oracle.H = np.array([[1.0, 0.0]])
    time_s = np.cumsum(rng.uniform(0.03, 0.3, 40))
    for i, t in enumerate(time_s):
        z = 90 - 8 * t + rng.normal()
        result = ours.update(measured([7], [z]), t)
        if i == 0:
            oracle.x, oracle.P, oracle.R = np.array([[z], [0.0]]), np.diag([1.0, 225.0]), np.eye(1)
        else:
            dt = t - time_s[i - 1]
            oracle.F = np.array([[1, dt], [0, 1]])
            oracle.Q = 4.0 * np.array([[dt**3 / 3, dt**2 / 2], [dt**2 / 2, dt]])
            oracle.predict()
            oracle.update(z)
        assert result.ranges.distance_m[0] == pytest.approx(oracle.x[0, 0])
        assert result.ranges.sigma_m[0] == pytest.approx(np.sqrt(oracle.P[0, 0]))
    assert result.rate_mps[0] == pytest.approx(oracle.x[1, 0])
    assert result.rate_mps[0] == pytest.approx(-8, abs=1.5)


def test_innovations_of_simulated_motion_are_as_large_as_the_filter_says():
    rng = np.random.default_rng(2)
    n, dt = 300, 0.1
    ids = np.arange(n)
    distance, rate = rng.uniform(80, 120, n), rng.normal(0, 8, n)
    tracker = DistanceFilter(SETTINGS)
    squared = []
    for step in range(40):
        kick = rng.normal(0, 2.0 * np.sqrt(dt), n)
        distance, rate = distance + rate * dt + kick * dt / 2, rate + kick
        result = tracker.update(measured(ids, distance + rng.normal(0, 0.5, n), 0.5), step * dt)
        if step > 20:
            squared.append(((result.ranges.distance_m - distance) / result.ranges.sigma_m) ** 2)
    assert 0.85 < np.mean(squared) < 1.15  # normalised squared error of a one-dimensional estimate


def test_tracks_come_go_and_are_remembered_through_a_gap():
    tracker = DistanceFilter()
    for step in range(10):
        tracker.update(measured([1, 2], [30 - step, 50.0]), step * 0.1)
    assert len(tracker.update(measured([], []), 1.0).rate_mps) == 0
    back = tracker.update(measured([3, 1], [10.0, np.nan]), 1.3)
    assert back.ranges.distance_m[0] == 10.0
    assert back.ranges.distance_m[1] == pytest.approx(17, abs=1.5)  # 10 m/s closing, 4 steps after 21 m
    gone = tracker.update(measured([1], [np.nan]), 2.5)
    assert np.isnan(gone.ranges.distance_m).all()
    assert np.isnan(gone.ranges.sigma_m).all()


def test_one_wild_measurement_moves_the_distance_little():
    tracker = DistanceFilter()
    for step in range(20):
        tracker.update(measured([1], [30.0]), step * 0.1)
    assert tracker.update(measured([1], [60.0]), 2.0).ranges.distance_m[0] == pytest.approx(30, abs=2)


def test_a_track_that_is_plainly_elsewhere_is_followed_after_three_measurements():
    tracker = DistanceFilter()
    for step in range(20):
        tracker.update(measured([1], [15.0]), step * 0.1)
    moved = [tracker.update(measured([1], [60.0]), 2.0 + step * 0.1).ranges.distance_m[0] for step in range(4)]
    assert max(moved[:2]) < 20
    assert moved[2:] == pytest.approx([60.0, 60.0])


def test_two_wild_ones_and_a_good_one_do_not_restart_the_filter():
    tracker = DistanceFilter()
    for step in range(30):
        tracker.update(measured([1], [50 - step]), step * 0.1)
    for step, distance_m in ((30, 60.0), (31, 60.0), (32, 18.0), (33, 60.0), (34, 16.0)):
        result = tracker.update(measured([1], [distance_m]), step * 0.1)
    assert result.rate_mps[0] == pytest.approx(-10, abs=2.5)


def test_a_step_between_ways_of_measuring_is_no_speed():
    """Mono says 6.6 m, stereo 4.4 m: where one takes over from the other nothing has moved."""
    rates = {}
    for name, ways in (("told", (0, 1)), ("not told", (0, 0))):
        tracker = DistanceFilter()
        for step in range(16):
            way, distance_m = (ways[0], 6.6) if step < 8 else (ways[1], 4.4)
            result = tracker.update(measured([1], [distance_m], 0.6), step * 0.1, way=np.array([way]))
            rates.setdefault(name, []).append(abs(result.rate_mps[0]))
    assert np.nanmax(rates["told"]) < 0.5 < 2.0 < np.nanmax(rates["not told"])
    assert np.isnan(rates["told"][8:11]).all()  # and for a third of a second nothing is said
    assert np.isfinite(rates["told"][12:]).all()


def test_the_part_of_sigma_that_a_track_keeps_does_not_average_out():
    tracker = DistanceFilter(FilterSettings(noise_share=0.6))
    for step in range(50):
        result = tracker.update(measured([1], [30.0], 2.0), step * 0.1)
    assert result.ranges.sigma_m[0] > 0.8 * 2.0


def test_two_filters_share_nothing():
    first, second = DistanceFilter(), DistanceFilter()
    first.update(measured([1], [30.0]), 0.0)
    assert np.isnan(second.update(measured([1], [np.nan]), 0.1).ranges.distance_m).all()
