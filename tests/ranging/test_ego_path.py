"""Ego path: exact circles, the growth of its covariance, gaps, and positions in the world."""

import math

import numpy as np
import pytest

from track_range.ranging.world.ego_path import EgoPath
from track_range.stereo.odometry.ego_motion import EgoMotion

STEP_S = 0.1


def driven(n, speed_mps=10.0, yaw_rad_s=0.0, *, speed_sigma_mps=0.1, rng=None):
    """Poses of n frames at constant speed and yaw rate; with `rng`, errors whose sum grows as the
    model says."""
    path = EgoPath()
    noise = np.zeros(n) if rng is None else rng.normal(0.0, 0.005 * math.sqrt(1.0 / STEP_S), n)
    motions = [EgoMotion(speed_mps, speed_sigma_mps, yaw_rad_s + w) for w in noise.tolist()]
    return [path.update(STEP_S * i, motion) for i, motion in enumerate(motions)]


def test_a_right_turn_goes_to_negative_y():
    pose = driven(51, 10.0, 0.2)[-1]  # a circle of 50 m to the right, 1 rad in 5 s
    assert pose.heading_rad == pytest.approx(-1.0)
    assert pose.x_m == pytest.approx(50 * math.sin(1.0), abs=0.02)
    assert pose.y_m == pytest.approx(-50 * (1 - math.cos(1.0)), abs=0.02)


def test_points_in_the_world():
    # a quarter to the right: the optical axis is -y, its right is -x
    pose = driven(51, 10.0, math.pi / 2 / 5)[-1]
    x_m, y_m = pose.to_world(np.array([10.0, 0.0]), np.array([0.0, 2.0]))
    assert x_m - pose.x_m == pytest.approx([0.0, -2.0], abs=1e-9)
    assert y_m - pose.y_m == pytest.approx([-10.0, 0.0], abs=1e-9)


def test_sigma_grows_with_the_distance():
    start, middle, end = (driven(201)[i] for i in (0, 100, 200))
    assert start.sigmas == (0.0, 0.0, 0.0)
    # an error of the speed that all frames share
    assert middle.sigmas[0] == pytest.approx(0.1 * 10, rel=1e-6)
    assert end.sigmas[0] == pytest.approx(0.1 * 20, rel=1e-6)
    assert end.sigmas[1] > 2 * middle.sigmas[1] > 0
    assert end.sigmas[2] == pytest.approx(math.hypot(0.005 * math.sqrt(20), 0.0005 * 20), rel=1e-6)


def test_errors_of_speeds_that_are_new_in_each_frame_average_out():
    path = EgoPath()
    motion = EgoMotion(10.0, 0.5, 0.0, noise_mps=0.3)
    end = [path.update(STEP_S * i, motion) for i in range(101)][-1]
    # 0.4 m/s for 10 s, and 0.3 m/s that lasts 0.3 s each
    assert end.sigmas[0] == pytest.approx(math.hypot(0.4 * 10, 0.3 * math.sqrt(0.3 * 10)), rel=1e-6)


def test_sigma_to_the_side_is_that_of_noisy_yaw_rates():
    rng = np.random.default_rng(3)
    ends = [driven(101, rng=rng)[-1] for _ in range(300)]
    error_m = np.array([pose.y_m for pose in ends])
    without_bias = math.sqrt(ends[0].covariance[1, 1] - (0.0005 * 10 * 10**2 / 2) ** 2)
    assert 0.9 < error_m.std() / without_bias < 1.1


def test_a_still_camera_stays_where_it_is():
    path = EgoPath()
    path.update(0.0, EgoMotion(10.0, 0.1, 0.0))
    before = path.update(STEP_S, EgoMotion(10.0, 0.1, 0.0))
    after = path.update(5.0, EgoMotion(0.05, 0.1, 0.01, is_still=True))
    assert (after.x_m, after.y_m, after.heading_rad) == (before.x_m, before.y_m, before.heading_rad)
    assert after.sigmas == pytest.approx(before.sigmas)


def test_a_gap_is_bridged_with_a_growing_sigma():
    path = EgoPath()
    assert math.isnan(path.update(0.0, EgoMotion()).x_m)
    known = [path.update(STEP_S * i, EgoMotion(10.0, 0.1, 0.0)) for i in range(1, 12)]
    # the origin is where the speed is first known
    assert (known[0].x_m, known[0].sigmas) == (0.0, (0.0, 0.0, 0.0))
    gap = [path.update(STEP_S * i, EgoMotion()) for i in range(12, 32)]
    assert gap[-1].x_m == pytest.approx(30.0)
    assert gap[-1].sigmas[0] > math.hypot(known[-1].sigmas[0], 0.3)
    assert (np.diff([pose.sigmas[0] for pose in gap]) > 0).all()


def test_unknown_yaw_is_less_certain():
    known, unknown = driven(51)[-1], driven(51, yaw_rad_s=math.nan)[-1]
    assert unknown.sigmas[2] > 3 * known.sigmas[2]


def test_a_camera_that_looks_aside_takes_the_same_path():
    """A camera that looks 90 degrees to the left moves to its right."""
    ahead, aside = EgoPath(), EgoPath()
    for i in range(51):
        ahead_pose = ahead.update(STEP_S * i, EgoMotion(10.0, 0.1, 0.2))
        seen = EgoMotion(0.0, 0.0, 0.2, right_mps=10.0, right_sigma_mps=0.1)
        pose = aside.update(STEP_S * i, seen)
    # x of the map is the first axis, to the left of the drive
    assert (-pose.y_m, pose.x_m) == pytest.approx((ahead_pose.x_m, ahead_pose.y_m))
    assert pose.heading_rad == pytest.approx(ahead_pose.heading_rad)
    x, y, heading = ahead_pose.sigmas
    assert pose.sigmas == pytest.approx((y, x, heading))


def test_a_gap_of_some_seconds_contains_a_vehicle_that_drives_off():
    """At rest, then 4 s without a speed, in which a vehicle may reach 1.5 m/s2 x 4 s."""
    path = EgoPath()
    for i in range(5):
        path.update(STEP_S * i, EgoMotion(0.0, 0.1, 0.0, right_mps=0.0, right_sigma_mps=0.16))
    pose = path.update(STEP_S * 4, EgoMotion())
    for i in range(1, 41):
        pose = path.update(STEP_S * (4 + i), EgoMotion())
    # 1.5 m/s2 (4 s)^2 / 2 = 12 m along the drive, 58 degrees to the right of the axis
    x_sigma_m, y_sigma_m, _ = pose.sigmas
    assert math.hypot(x_sigma_m, y_sigma_m) == pytest.approx(12.0, rel=0.06)
    assert y_sigma_m / x_sigma_m == pytest.approx(1.6, rel=0.01)
