"""Acceleration of moving objects as a state of the distance filters, and the lag behind it."""

import numpy as np

from track_range.ranging.filtering.distance_filter import DistanceFilters
from track_range.ranging.filtering.own_acceleration import without_lag
from track_range.ranging.measurement.ranges import Ranges
from track_range.stereo.odometry.ego_motion import EgoMotion

TAU_S = 1.5


def closing_of(lead_mps, *, seed, sigma=0.02):
    """(N,) true and measured closing speeds with sigmas of a lead with the speeds (N,), 30 m ahead
    at first, from a camera at 14 m/s, and those without lag behind the true acceleration; 10 Hz,
    distances with independent relative errors."""
    rng, dt, ego_mps = np.random.default_rng(seed), 0.1, 14.0
    gap_m = 30.0 + np.cumsum(dt * (lead_mps - ego_mps))
    acceleration_mps2 = np.gradient(lead_mps, dt)
    filters, rows = DistanceFilters({"fused": 1.0}), []
    ego = EgoMotion(ego_mps, 0.05, 0.0)
    for i, true_m in enumerate(gap_m):
        z = np.array([true_m * np.exp(sigma * rng.normal())])
        measured = {"fused": Ranges(np.array([1]), z, sigma * z, 0.1 * sigma * z)}
        state = filters.update(measured, dt * i, ego=ego)["fused"]
        missed_mps2 = acceleration_mps2[i] - state.own_mps2
        corrected = without_lag(state.state, missed_mps2, 0.0 * missed_mps2)
        known = ego_mps - lead_mps[i], -state.rate_mps[0], state.rate_sigma_mps[0]
        rows.append((*known, -corrected.v[0]))
    return np.array(rows).T


def test_a_lead_that_brakes():
    """14 m/s for 3 s, then 4 m/s^2: after 1.5 s, the rate lags by less than 0.3 s of that."""
    t = 0.1 * np.arange(46)
    lead_mps = 14.0 - 4.0 * np.clip(t - 3.0, 0.0, None)
    errors = []
    for seed in range(12):
        true, measured, sigma, _ = closing_of(lead_mps, seed=seed)
        errors.append(true[-1] - measured[-1])
        assert abs(errors[-1]) < 3 * sigma[-1]
    assert -0.4 < np.mean(errors) < 1.2


def test_a_known_braking_is_followed_without_lag():
    """From 0.6 s to 3 s after its start: the filter alone is behind, as it follows it late, and the
    part that it does follow is not corrected again."""
    t = 0.1 * np.arange(61)
    lead_mps = 14.0 - 3.0 * np.clip(t - 3.0, 0.0, None)
    true, measured, _, corrected = np.mean(
        [closing_of(lead_mps, seed=seed) for seed in range(12)], axis=0
    )
    late, left = (true - measured)[36:], (true - corrected)[36:]
    assert late.max() > 1.5
    assert np.sqrt(np.mean(left**2)) < 0.6 * np.sqrt(np.mean(late**2))
    assert -0.5 < left[20:].mean() < 0.5


def test_sigma_of_moving_objects():
    """Speeds whose accelerations last: errors are as large as stated, within two-sided bounds."""
    in_sigmas = []
    for seed in range(30):
        rng = np.random.default_rng(1000 + seed)
        a, speeds = 0.0, [14.0]
        for _ in range(60):
            a = np.exp(-0.1 / TAU_S) * a + rng.normal() * 1.1 * np.sqrt(1 - np.exp(-0.2 / TAU_S))
            speeds.append(speeds[-1] + 0.1 * a)
        true, measured, sigma, _ = closing_of(np.array(speeds), seed=seed)
        in_sigmas.append(np.abs(measured - true)[10:] / sigma[10:])
    in_sigmas = np.concatenate(in_sigmas)
    assert 0.6 < np.mean(in_sigmas < 1) < 0.85
    assert 0.9 < np.mean(in_sigmas < 2) < 0.99
