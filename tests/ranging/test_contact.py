"""Probability of contact: by hand, and against Monte Carlo of the same motion."""

from __future__ import annotations

import math
from typing import Any

import numpy as np
import pytest
from hypothesis import given, settings, strategies as st
from scipy.special import ndtr

from track_range.foundation.constant_velocity import ConstantVelocity
from track_range.ranging.warning.contact import (
    Encounter,
    contact_probability,
    needed_deceleration,
    overlap_probability,
    stop_s,
    yielding_probability,
)

EGO = {"horizon_s": 3.5, "manoeuvre_s": 3.0, "ego_length_m": 4.2}
EXACT = 1e-8


def state(
    x: float, v: float, *, P_xx: float = EXACT, P_xv: float = 0.0, P_vv: float = EXACT
) -> ConstantVelocity:
    return ConstantVelocity(*(np.array([value]) for value in (x, v, P_xx, P_xv, P_vv)))


def encounter(
    gap: ConstantVelocity,
    offset: ConstantVelocity,
    *,
    a: float = 0.0,
    a_sigma: float = 0.0,
    ego: tuple[float, float] | None = None,
    half_width_m: float = 1.8,
    A: float = 0.0,
) -> Encounter:
    """An object with the acceleration a, and the ego vehicle with (speed, acceleration); None =
    unknown."""
    V, ego_a = ego or (0.0, 0.0)
    stops = (np.inf, np.inf)
    if ego is not None:
        stops = (
            stop_s(gap.v + V, np.array([a]), 3.0)[0],
            stop_s(np.array([V]), np.array([ego_a]), 3.0)[0],
        )
    values = (np.array([value]) for value in (gap.v[0] + V, a, stops[0], a_sigma))
    return Encounter(
        gap, *values, V, ego_a, float(stops[1]), offset, np.array([half_width_m]), np.array([A])
    )


def probability(*args: ConstantVelocity, **kwargs: Any) -> float:
    return float(contact_probability(encounter(*args, **kwargs), **EGO)[0])


@pytest.mark.parametrize(
    ("gap", "offset", "expected"),
    [
        ((20.0, -10.0), (0.0, 0.0), 1.0),  # 2 s ahead in the path
        ((40.0, -10.0), (0.0, 0.0), 0.0),  # 4 s ahead, beyond the horizon
        ((20.0, 5.0), (0.0, 0.0), 0.0),  # draws away
        ((20.0, -10.0), (3.5, 0.0), 0.0),  # in the next lane
        ((20.0, -10.0), (3.5, -1.75), 1.0),  # is in the path after 2 s
        ((20.0, -10.0), (1.0, 3.0), 0.0),  # has left it by then
    ],
)
def test_certain_motion(
    gap: tuple[float, float], offset: tuple[float, float], expected: float
) -> None:
    assert probability(state(*gap), state(*offset)) == pytest.approx(expected, abs=1e-6)


def test_uncertain_arrival_by_hand() -> None:
    """30 m at 10 +- 1 m/s: arrival within 3.5 s if the speed exceeds 30 / 3.5 = 8.57 m/s, Phi(1.43)
    = 0.923."""
    assert probability(state(30.0, -10.0, P_vv=1.0), state(0.0, 0.0)) == pytest.approx(
        ndtr(10 - 30 / 3.5), abs=1e-3
    )


def test_uncertain_offset_by_hand() -> None:
    """Offset 0 +- 1 m and reach 1.8 m: P(|N(0, 1)| <= 1.8) = 0.928."""
    expected = ndtr(1.8) - ndtr(-1.8)
    assert probability(state(20.0, -10.0), state(0.0, 0.0, P_xx=1.0)) == pytest.approx(
        expected, abs=1e-6
    )


def test_acceleration_brings_the_contact_forward() -> None:
    gap, offset = state(30.0, -6.0), state(0.0, 0.0)
    assert probability(gap, offset) == pytest.approx(0.0, abs=1e-6)
    assert probability(gap, offset, a=-4.0) == pytest.approx(1.0, abs=1e-6)
    # brakes in time
    assert probability(state(18.0, -6.0), offset, a=3.0) == pytest.approx(0.0, abs=1e-6)


def test_braking_vehicle_does_not_reverse() -> None:
    """8 m ahead at 2 m/s and braking with 2 m/s^2, it stops after about 1.4 m; the ego vehicle
    needs 4.7 s at 2 m/s."""
    gap, offset = state(8.0, 0.0), state(0.0, 0.0)
    assert probability(gap, offset, a=-2.0, ego=(2.0, 0.0)) == pytest.approx(0.0, abs=1e-6)
    assert probability(gap, offset, a=-2.0) == pytest.approx(1.0, abs=1e-6)  # unknown speeds


def test_braking_ego_vehicle_stops() -> None:
    gap, offset = state(5.0, -3.0), state(0.0, 0.0)
    assert probability(gap, offset, ego=(3.0, 0.0)) == pytest.approx(1.0, abs=1e-6)
    assert probability(gap, offset, ego=(3.0, -2.0)) == pytest.approx(0.0, abs=1e-6)


@pytest.mark.parametrize("acceleration_mps2", [-0.5, -2.0, -8.0])
def test_stop(acceleration_mps2: float) -> None:
    time_s = float(stop_s(np.array([1.0]), np.array([acceleration_mps2]), 3.0)[0])
    assert 1.0 + acceleration_mps2 * 3.0 * (1 - np.exp(-time_s / 3.0)) == pytest.approx(
        0.0, abs=1e-6
    )


def test_no_stop() -> None:
    speeds, accelerations = np.array([-3.0, 5.0, 5.0, 9.0]), np.array([-1.0, 0.0, 1.0, -2.0])
    assert stop_s(speeds, accelerations, 3.0).tolist() == [0.0, np.inf, np.inf, np.inf]


@pytest.mark.parametrize(
    ("gap", "a", "ego", "expected"),
    [
        ((30.0, -10.0), 0.0, (10.0, 0.0), 2.5),  # static: 10^2 / (2 (30 - 10))
        ((30.0, -10.0), 0.0, (20.0, 0.0), 2.5),  # slower by 10 m/s
        ((30.0, -10.0), 0.0, None, 2.5),
        ((30.0, -10.0), 0.0, (10.0, -2.0), 64 / 42),  # already brakes
        ((30.0, 2.0), 0.0, (10.0, 0.0), 0.0),  # draws away
        # stops before the speeds are equal
        ((10.5, 0.0), -2.0, (15.0, 0.0), 15**2 / (2 * (9.5 + 13**2 / 4))),
        ((10.0, -2.0), -1.0, (20.0, 0.0), 1 + 9 / 15),  # goes on braking
    ],
)
def test_needed_deceleration(
    gap: tuple[float, float], a: float, ego: tuple[float, float] | None, expected: float
) -> None:
    met = encounter(state(*gap), state(0.0, 0.0), a=a, ego=ego)
    assert needed_deceleration(met, 1.0)[0] == pytest.approx(expected, rel=1e-6)


def test_person_may_run_into_the_side() -> None:
    """Walks at 2 m/s and is 0.5 m beside the reach when the front arrives; the car passes for
    another 0.42 s."""
    gap = state(20.0, -10.0)
    assert probability(gap, state(1.2 + 0.5 + 4.0, -2.0), half_width_m=1.2) == pytest.approx(
        1.0, abs=0.2
    )
    assert probability(gap, state(1.2 + 1.2 + 4.0, -2.0), half_width_m=1.2) == pytest.approx(
        0.0, abs=1e-6
    )


@pytest.mark.parametrize(
    ("x_m", "v_mps", "expected"),
    [
        (5.8, -2.0, 0.95),  # stops within 4 m by 0.5 m/s2
        (5.8, -math.sqrt(24.0), 0.475),  # needs the 3 m/s2 that half of all would choose
        (2.8, 4.0, 0.01),  # needs 8 m/s2
        (1.0, -3.0, 0.0),  # is in the path
    ],
)
def test_vehicles_beside_the_path_give_way_if_they_can(
    x_m: float, v_mps: float, expected: float
) -> None:
    one = encounter(state(20.0, -10.0), state(x_m, v_mps))
    assert yielding_probability(one)[0] == pytest.approx(expected, abs=0.01)


def test_overlap_against_the_normal_distribution() -> None:
    offset = state(1.0, -0.5, P_xx=0.2, P_xv=0.1, P_vv=0.3)
    sigma = np.sqrt(0.2 + 2 * 2 * 0.1 + 4 * 0.3 + (0.4 * 4 / 2) ** 2)
    expected = ndtr(1.5 / sigma) - ndtr(-1.5 / sigma)
    assert overlap_probability(offset, np.array([1.5]), np.array([0.4]), 2.0)[0] == pytest.approx(
        expected
    )


def test_monte_carlo() -> None:
    """100,000 motions with the means and covariances of the encounter; arrival and overlap drawn
    separately."""
    rng = np.random.default_rng(4)
    n = 100_000
    gap = state(26.0, -9.0, P_xx=0.5, P_xv=0.2, P_vv=0.8)
    offset = state(2.5, -1.0, P_xx=0.1, P_xv=0.02, P_vv=0.09)
    exact = probability(gap, offset, a=-0.5, a_sigma=0.7, A=0.2)
    g, v = rng.multivariate_normal([26.0, -9.0], [[0.5, 0.2], [0.2, 0.8]], n).T
    a = rng.normal(-0.5, 0.7, n)
    o, u = rng.multivariate_normal([2.5, -1.0], [[0.1, 0.02], [0.02, 0.09]], n).T
    A = rng.normal(0.0, 0.2, n)
    arrival_s = np.full(n, np.inf)
    for t in np.arange(0.01, 3.5 + 1e-9, 0.01)[::-1]:
        h = 9.0 * np.expm1(-t / 3.0) + 3.0 * t
        arrival_s = np.where(g + v * t + a * h <= 0, t, arrival_s)
    t = np.minimum(arrival_s, 3.5)
    x, side = o + u * t + A * t * t / 2, u * 4.2 / 9.0
    is_hit = (
        (x >= -1.8 - np.maximum(side, 0))
        & (x <= 1.8 + np.maximum(-side, 0))
        & np.isfinite(arrival_s)
    )
    assert exact == pytest.approx(is_hit.mean(), abs=0.02)


@settings(max_examples=50, deadline=None)
@given(
    gap=st.tuples(st.floats(-5, 200), st.floats(-60, 60)),
    offset=st.tuples(st.floats(-30, 30), st.floats(-10, 10)),
    sigmas=st.tuples(*(st.floats(0, 10) for _ in range(4))),
    a=st.floats(-10, 10),
)
def test_probability_is_within_limits(
    gap: tuple[float, float],
    offset: tuple[float, float],
    sigmas: tuple[float, float, float, float],
    a: float,
) -> None:
    d, v, x, u = (sigma**2 for sigma in sigmas)
    p = probability(state(*gap, P_xx=d, P_vv=v), state(*offset, P_xx=x, P_vv=u), a=a, a_sigma=0.5)
    assert -1e-9 <= p <= 1 + 1e-9
    mirrored = (-offset[0], -offset[1])
    assert p == pytest.approx(
        probability(
            state(*gap, P_xx=d, P_vv=v), state(*mirrored, P_xx=x, P_vv=u), a=a, a_sigma=0.5
        ),
        abs=1e-9,
    )


def test_unknown_motion() -> None:
    nan = float("nan")
    assert np.isnan(probability(state(nan, -10.0), state(0.0, 0.0)))
    assert np.isnan(probability(state(20.0, -10.0), state(nan, 0.0)))
    empty = ConstantVelocity(*(np.zeros(0) for _ in range(5)))
    zero = np.zeros(0)
    none = Encounter(empty, zero, zero, zero, zero, 0.0, 0.0, np.inf, empty, zero, zero)
    assert contact_probability(none, **EGO).shape == (0,)
