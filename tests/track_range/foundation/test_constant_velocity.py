import numpy as np
import pytest
from filterpy.kalman import KalmanFilter

from track_range.foundation.constant_velocity import ConstantVelocity

START = (3.0, -2.0, 4.0, 0.5, 9.0)


def states(shape):
    return ConstantVelocity(*(np.full(shape, number) for number in START))


def arrays(state):
    return [state.x, state.v, state.P_xx, state.P_xv, state.P_vv]


def test_equals_filterpy():
    rng = np.random.default_rng(1)
    oracle = KalmanFilter(dim_x=2, dim_z=1)
    oracle.x, oracle.P = np.array([[3.0], [-2.0]]), np.array([[4.0, 0.5], [0.5, 9.0]])
    oracle.H = np.array([[1.0, 0.0]])
    state, q = states((2, 3)), 1.5
    for _ in range(30):
        dt, z, R = rng.uniform(0.01, 0.4), rng.normal(), rng.uniform(0.1, 3.0)
        oracle.F = np.array([[1, dt], [0, 1]])
        oracle.Q = q * np.array([[dt**3 / 3, dt**2 / 2], [dt**2 / 2, dt]])
        oracle.predict()
        oracle.update(np.array([[z]]), R=np.array([[R]]))
        state = state.predict(dt, q=q)
        state = state.update(z - state.x, R)
        expected = [*oracle.x[:, 0], oracle.P[0, 0], oracle.P[0, 1], oracle.P[1, 1]]
        for array, number in zip(arrays(state), expected, strict=True):
            assert array == pytest.approx(np.full((2, 3), number))


def test_two_half_steps_equal_one_step():
    once = states(1).predict(0.2, q=2.0)
    twice = states(1).predict(0.1, q=2.0).predict(0.1, q=2.0)
    for a, b in zip(arrays(once), arrays(twice), strict=True):
        assert a == pytest.approx(b)


def test_invalid_measurements_are_ignored():
    state = states(2).update(
        np.array([1.0, np.nan]), np.array([2.0, np.nan]), valid=np.array([True, False])
    )
    assert [array[1] for array in arrays(state)] == list(START)
    assert state.x[0] == pytest.approx(3.0 + 4.0 / 6.0)


def test_shared_covariance():
    value, shared = np.array([[1.0, 2.0, 3.0]]), np.ones((1, 1))
    state = (
        ConstantVelocity(value, value, shared, 0 * shared, shared)
        .predict(1.0, q=0.0)
        .update(np.ones((1, 3)), 2.0)
    )
    assert state.P_xx.shape == (1, 1)
    assert state.x == pytest.approx(np.array([[2.5, 4.5, 6.5]]))
