"""Acceleration of moving objects as a state of the distance filters."""

import numpy as np
import pytest

from track_range.foundation.constant_velocity import ConstantVelocity
from track_range.ranging.filtering.distance_filter import DistanceFilters
from track_range.ranging.filtering.key_distance import KeyDistance
from track_range.ranging.filtering.own_acceleration import OwnAcceleration, without_lag
from track_range.ranging.measurement.growth import Growth
from track_range.ranging.measurement.ranges import Ranges
from track_range.stereo.odometry.ego_motion import EgoMotion

TAU_S, SIGMA_MPS2 = 1.5, 1.2
YES = np.array([[[True]]])


def one(value):
    return np.full((1, 1, 1), float(value))


def parts_of(x, P):
    """Motion, acceleration and key distance of the state [d v a r]."""
    motion = ConstantVelocity(one(x[0]), one(x[1]), one(P[0, 0]), one(P[0, 1]), one(P[1, 1]))
    own = OwnAcceleration(one(x[2]), one(P[0, 2]), one(P[1, 2]), one(P[2, 2]), one(P[3, 2]))
    return motion, own, KeyDistance(one(x[3]), one(P[0, 3]), one(P[1, 3]), one(P[3, 3]))


def values(motion, own, key):
    return np.array([part.item() for part in (*motion.columns, *own, *key)])


def of_matrix(x, P):
    own = [x[2], P[0, 2], P[1, 2], P[2, 2], P[3, 2]]
    key = [x[3], P[0, 3], P[1, 3], P[3, 3]]
    return np.array([x[0], x[1], P[0, 0], P[0, 1], P[1, 1], *own, *key])


def test_against_a_filter_of_four_states():
    """The same steps with matrices: state [d v a r], a time step, a distance and a growth."""
    dt, q, distance_m, R, log_ratio, sigma = 0.2, 0.04, 19.0, 0.5, 0.1, 0.03
    L = np.random.default_rng(1).normal(size=(4, 4))
    x, P = np.array([20.0, -3.0, 0.7, 22.0]), L @ L.T + np.eye(4)
    motion, own, key = parts_of(x, P)

    e = np.exp(-dt / TAU_S)
    g = TAU_S * (1 - e)
    f = TAU_S * (dt - g)
    F = np.array([[1, dt, f, 0], [0, 1, g, 0], [0, 0, e, 0], [0, 0, 0, 1]])
    jerk = 2 * SIGMA_MPS2**2 / TAU_S
    Q = np.zeros((4, 4))
    Q[:2, :2] = q * np.array([[dt**3 / 3, dt**2 / 2], [dt**2 / 2, dt]])
    Q[1, 1] += jerk * dt**3 / 3
    Q[1, 2] = Q[2, 1] = jerk * dt**2 / 2
    Q[2, 2] = SIGMA_MPS2**2 * (1 - e * e)
    x, P = F @ x, F @ P @ F.T + Q
    key = own.predict_key(key, one(dt))
    motion, own = own.predict(motion.predict(one(dt), q=q), one(dt), one(SIGMA_MPS2))
    assert values(motion, own, key) == pytest.approx(of_matrix(x, P))

    nu, S = distance_m - x[0], P[0, 0] + R
    K = P[:, 0] / S
    x, P = x + K * nu, P - np.outer(K, P[0])
    own = own.correct(motion, key.P_dr, one(nu), one(S))
    key = key.correct(motion, one(nu), one(S))
    motion = motion.correct(one(nu), one(S))
    assert values(motion, own, key) == pytest.approx(of_matrix(x, P))

    H = np.array([-1.0, 0.0, 0.0, x[0] / x[3]])
    nu, S = x[0] * (log_ratio - np.log(x[3] / x[0])), H @ P @ H + (x[0] * sigma) ** 2
    K = P @ H / S
    x, P = x + K * nu, P - np.outer(K, P @ H)
    measured = Growth(np.array([log_ratio]), np.array([sigma]), np.array([False]))
    growth = key.innovation(motion, measured, valid=YES)
    motion, key, used = key.correct_by_growth(motion, growth, outlier_sigma=9.0)
    own = own.correct_by_growth(growth, used)
    assert values(motion, own, key) == pytest.approx(of_matrix(x, P))


def test_key_frames_and_restarts():
    """A new key frame has the covariance of d; a filter that restarts knows nothing of a."""
    own = OwnAcceleration(*(one(value) for value in (0.5, 0.1, 0.2, 0.3, 0.4)))
    assert own.start_key(YES).P_ra.item() == 0.1
    assert own.start_key(~YES).P_ra.item() == 0.4
    started = own.restart(YES, one(2.0))
    assert [part.item() for part in started] == [0.0, 0.0, 0.0, 4.0, 0.0]
    assert [part.item() for part in own.restart(~YES, one(2.0))] == [part.item() for part in own]


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
