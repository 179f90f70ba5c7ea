"""States of the distance filters against a Kalman filter with matrices."""

import numpy as np
import pytest

from track_range.foundation.constant_velocity import ConstantVelocity
from track_range.ranging.filtering.key_distance import correct_by_growth, innovation
from track_range.ranging.filtering.target_states import TargetStates
from track_range.ranging.measurement.growth import Growth

TAU_S, SIGMA_MPS2 = 1.5, 1.2
YES = np.array([[[True]]])


def one(value):
    return np.full((1, 1, 1), float(value))


def test_against_a_filter_with_matrices():
    """The state [d v a r]: a time step with an input, a step of the systematic error, another scale,
    a distance and a growth."""
    dt, q, distance_m, R, log_ratio, sigma = 0.2, 0.04, 19.0, 0.5, 0.1, 0.03
    L = np.random.default_rng(1).normal(size=(4, 4))
    x, P = np.array([20.0, -3.0, 0.7, 22.0]), L @ L.T + np.eye(4)
    states = TargetStates(np.column_stack([P, x])[..., None, None, None])

    def are_equal():
        table = states.table[..., 0, 0, 0]
        return table == pytest.approx(np.column_stack([P, x]))

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
    B, dV, variance = np.array([-dt / 2, -1, 0, 0]), 0.3, 0.05
    x, P = F @ x + B * dV, F @ P @ F.T + Q + variance * np.outer(B, B)
    states.predict(np.array([dt]), q=one(q)[0], sigma_mps2=one(SIGMA_MPS2)[0])
    states.add_input(np.array([dt]), one(dV), np.array(variance))
    assert are_equal()

    h = np.array([1, 0, 0, x[3] / x[0]])
    P = P + 0.4 * np.outer(h, h)
    states.step(one(0.4))
    assert are_equal()

    x, P = 1.1 * x, 1.21 * P
    states.scale(one(1.1))
    assert are_equal()

    nu, S = distance_m - x[0], P[0, 0] + R
    K = P[:, 0] / S
    x, P = x + K * nu, P - np.outer(K, P[0])
    states.correct_by_distance(one(nu), one(1 / S))
    assert are_equal()

    H = np.array([-1.0, 0.0, 0.0, x[0] / x[3]])
    nu, S = x[0] * (log_ratio - np.log(x[3] / x[0])), H @ P @ H + (x[0] * sigma) ** 2
    K = P @ H / S
    x, P = x + K * nu, P - np.outer(K, P @ H)
    measured = Growth(np.array([log_ratio]), np.array([sigma]), np.array([False]))
    correct_by_growth(states, innovation(states, measured, valid=YES), outlier_sigma=9.0)
    assert are_equal()
    assert np.array_equal(states.P, states.P.swapaxes(0, 1))


def test_starts_and_key_frames_of_some_filters():
    """A filter that starts knows nothing of a and r; a new key frame has the covariances of d."""
    P = np.diag([4.0, 1.0, 0.3, 9.0]) + 0.1
    table = np.repeat(np.column_stack([P, [20.0, -3.0, 0.5, 22.0]])[..., None], 3, axis=2)
    states = TargetStates(table[:, :, None, None])
    first = ConstantVelocity(*(np.array(value) for value in (30.0, -8.0, 2.0, 0.0, 5.0)))
    states.start(np.array([True, False, False]), first, np.array(0.7))
    states.start_key(np.array([False, True, False]))
    started, keyed, other = np.moveaxis(table, -1, 0)
    assert started[:, :4] == pytest.approx(np.diag([2.0, 5.0, 0.7, 0.0]))
    assert started[:3, 4] == pytest.approx([30.0, -8.0, 0.0])
    assert np.isnan(started[3, 4])
    assert keyed[3] == pytest.approx([4.1, 0.1, 0.1, 4.1, 20.0])
    assert keyed[:, 3] == pytest.approx([4.1, 0.1, 0.1, 4.1])
    assert other == pytest.approx(np.column_stack([P, [20.0, -3.0, 0.5, 22.0]]))
