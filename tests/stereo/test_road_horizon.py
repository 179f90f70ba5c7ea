import math

import numpy as np
import pytest

from track_range.stereo.geometry.mounting import Mounting
from track_range.stereo.odometry.road_horizon import (
    RoadHorizon,
    RoadView,
    curvature_fraction,
    unknown_curvature_variance,
)

DT_S = 0.1


def driven(
    n,
    *,
    mounting=0.01,
    curvature_per_m=0.0,
    travelled_m=1.0,
    springs_rad=0.0,
    bias_rad=0.0,
    noise=0.002,
    seed=0,
):
    """The filter after `n` frames of a car on a road of constant curvature, and the true
    horizon."""
    rng = np.random.default_rng(seed)
    road = RoadHorizon()
    before = 0.0
    for _ in range(n):
        springs = springs_rad * rng.normal()
        pitch_rad = curvature_per_m * travelled_m + springs - before + bias_rad
        before = springs
        road.predict(DT_S, pitch_rad=pitch_rad, roll_rad=0.0, travelled_m=travelled_m)
        road.measure(mounting + springs + noise * rng.normal(), noise**2)
    return road.view, mounting + before


def test_prior_is_wide():
    view = RoadHorizon().view
    assert (view.horizon, view.curvature_per_m) == (0.0, 0.0)
    assert 0.02 < math.sqrt(view.horizon_variance) < 0.05


@pytest.mark.parametrize("springs_rad", [0.0, 0.002])
def test_horizon_follows_the_springs(springs_rad):
    view, true = driven(50, springs_rad=springs_rad)
    sigma = math.sqrt(view.horizon_variance)
    assert sigma < 0.001
    assert abs(view.horizon - true) < 3 * sigma


@pytest.mark.parametrize("curvature_per_m", [-4e-4, 3e-4])
def test_curvature_is_rotation_without_a_moving_horizon(curvature_per_m):
    """The camera turns by k V dt per frame while the horizon stays."""
    view, true = driven(100, curvature_per_m=curvature_per_m, travelled_m=2.0)
    assert view.curvature_per_m == pytest.approx(curvature_per_m, abs=1.5e-4)
    assert view.horizon == pytest.approx(true, abs=0.0015)


def test_measurement_ahead_is_the_slope_of_the_road_there():
    road = RoadHorizon()
    road.measure(0.0, 1e-8)
    road.measure(-0.004, 1e-8, ahead_m=20.0)  # y - k 20 / 2
    assert road.view.curvature_per_m == pytest.approx(4e-4, rel=0.01)


def test_outlier_is_refused():
    road = RoadHorizon()
    road.measure(0.01, 1e-6)
    before = road.view
    assert not road.measure(0.1, 1e-6, max_sigma=4.0)
    assert road.view == before
    assert road.measure(0.011, 1e-6, max_sigma=4.0)


def test_unknown_rotation_widens_the_horizon():
    road = RoadHorizon()
    road.measure(0.01, 1e-8)
    before = road.view.horizon_variance
    road.predict(DT_S, pitch_rad=math.nan, roll_rad=math.nan, travelled_m=math.nan)
    assert road.view.horizon_variance > before
    assert road.view.slope == 0.0


def test_roll_tilts_the_horizon_and_returns():
    road = RoadHorizon()
    road.predict(DT_S, pitch_rad=0.0, roll_rad=0.02, travelled_m=1.0)
    # clockwise: the horizon rises on the right-hand side
    assert road.view.slope == pytest.approx(-0.02, rel=0.25)
    for _ in range(100):
        road.predict(DT_S, pitch_rad=0.0, roll_rad=0.0, travelled_m=1.0)
    assert abs(road.view.slope) < 0.001


def test_a_camera_that_looks_to_the_left_sees_the_roll_as_its_horizon():
    """With 0.02 rad of pitch and 0.05 rad of roll, which raises the road on the right of the car:
    the camera sees the left, where it is lower, and its own right side is the front of the car."""
    road = RoadHorizon()
    road.measure(0.02, 1e-12)
    road.measure_roll(0.05, 1e-12)
    view = road.seen(Mounting(yaw_deg=90.0).travel_from_camera)
    assert view.horizon == pytest.approx(0.05, abs=1e-4)
    assert view.slope == pytest.approx(0.02, abs=1e-4)
    assert view.across == pytest.approx((0.0, -1.0), abs=1e-9)  # its axis leads to the left
    back = road.seen(Mounting(yaw_deg=180.0).travel_from_camera)
    assert back.across == pytest.approx((-1.0, 0.0), abs=1e-9)
    assert (back.horizon, back.slope) == pytest.approx((-0.02, 0.05), abs=1e-4)


def test_a_pitched_camera_sees_the_horizon_above_its_axis():
    view = RoadHorizon().seen(Mounting(pitch_deg=2.0).travel_from_camera)
    assert view.horizon == pytest.approx(-math.tan(math.radians(2.0)))


def test_variance_of_the_horizon_of_a_camera_that_looks_aside():
    """At 30 degrees: cos 30 of the pitch and sin 30 of the roll, both unknown by themselves."""
    road = RoadHorizon()
    road.measure(0.0, 1e-12)
    view = road.seen(Mounting(yaw_deg=-30.0).travel_from_camera)
    assert view.horizon_variance == pytest.approx(0.25 * road.roll_variance, rel=1e-3)


def test_scaled_lengths():
    view = RoadView(
        horizon=0.01,
        horizon_variance=1e-6,
        curvature_per_m=2e-4,
        curvature_variance=4e-8,
        covariance=1e-9,
    ).scaled(2.0)
    assert (
        view.horizon,
        view.curvature_per_m,
        view.curvature_variance,
        view.covariance,
    ) == pytest.approx((0.01, 1e-4, 1e-8, 5e-10))


def test_share_of_the_curvature_decreases_with_distance():
    distance_m = np.array([0.0, 10.0, 50.0, 1e4])
    assert curvature_fraction(distance_m)[0] == 1.0
    assert (np.diff(curvature_fraction(distance_m)) < 0).all()
    assert unknown_curvature_variance(distance_m)[[0, -1]] == pytest.approx([0.0, 9e-8])
