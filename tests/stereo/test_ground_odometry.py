"""GroundOdometry in a street without end, by cameras that look in all directions."""

import math

import numpy as np
import pytest

from tests.stereo.streets import CAMERA, HEIGHT_M, street
from track_range.foundation.sparse_flow import BackgroundFlow
from track_range.stereo.geometry.frames import Frame
from track_range.stereo.geometry.mounting import Mounting
from track_range.stereo.odometry.ground_odometry import GroundOdometry
from track_range.tracking.camera_motion import CameraMotion

NO_BOXES, DT_S = np.zeros((0, 4)), 0.1


def driven(true, assumed, *, speed_mps=8.0, n=11, yaw_rad_s=0.0, height_m=HEIGHT_M):
    """The odometry of an assumed mounting and height, and its motions along the street."""
    odometry = GroundOdometry(CAMERA, height_m, travel_from_camera=assumed.travel_from_camera)
    motions = [
        odometry.update(
            Frame(k, k * DT_S, street(true, speed_mps * k * DT_S, yaw_rad_s * k * DT_S), None),
            NO_BOXES,
        )
        for k in range(n)
    ]
    return odometry, motions


@pytest.mark.parametrize("yaw_deg", [0.0, -30.0, -58.0, 90.0, 180.0])
def test_speed_and_yaw_rate_whatever_the_mounting(yaw_deg):
    mounting = Mounting(yaw_deg=yaw_deg, pitch_deg=5.0)
    _, motions = driven(mounting, mounting)
    speeds_mps = np.array([motion.speed_mps for motion in motions[4:]])
    sigmas_mps = np.array([motion.speed_sigma_mps for motion in motions[4:]])
    assert np.isfinite(speeds_mps).all()
    assert speeds_mps.mean() == pytest.approx(8.0, rel=0.03)
    assert (np.abs(speeds_mps - 8.0) < 3 * sigmas_mps).all()
    assert (sigmas_mps < 1.0).all()
    assert np.abs([motion.yaw_rad_s for motion in motions[4:]]).max() < 0.02


@pytest.mark.parametrize("speed_mps", [0.6, 1.2, 3.0])
def test_slow_speeds_by_frames_that_are_farther_apart(speed_mps):
    """From frame to frame, the road moves by 0.6 to three cells."""
    mounting = Mounting(pitch_deg=5.0)
    _, motions = driven(mounting, mounting, speed_mps=speed_mps, n=14)
    speeds_mps = np.array([motion.speed_mps for motion in motions[4:]])
    sigmas_mps = np.array([motion.speed_sigma_mps for motion in motions[4:]])
    assert (np.abs(speeds_mps - speed_mps) < 1.5 * sigmas_mps).all()
    assert (sigmas_mps < 0.35).all()


def test_frames_between_two_that_are_compared():
    """25 frames/s: every second one has the predicted speed and yaw rate, the last step, and the
    last horizon, on which the camera pitches."""
    mounting, speed_mps, yaw_rad_s = Mounting(pitch_deg=5.0), 8.0, 0.1
    odometry = GroundOdometry(CAMERA, HEIGHT_M, travel_from_camera=mounting.travel_from_camera)
    steps, sigmas = [], []
    for k in range(17):
        time_s = k / 25
        image = street(mounting, speed_mps * time_s, yaw_rad_s * time_s)
        motion = odometry.update(Frame(k, time_s, image, None), NO_BOXES)
        steps.append(odometry.step(motion))
        sigmas.append(math.sqrt(odometry.view.horizon_variance))
        if k > 8:
            assert motion.speed_mps == pytest.approx(speed_mps, rel=0.05)
            assert motion.yaw_rad_s == pytest.approx(yaw_rad_s, abs=0.03)
            assert steps[-1].time_s == pytest.approx((2 * ((k - 1) // 2) + 1) / 25)
            assert steps[-1].dt_s == pytest.approx(2 / 25)
    assert steps[-1] is steps[-2]
    assert math.sqrt(sigmas[-1] ** 2 - sigmas[-2] ** 2) == pytest.approx(0.0025 * 0.5, rel=0.05)


@pytest.mark.parametrize(("speed_mps", "dt_s"), [(8.0, 0.1), (22.0, 0.05)])
def test_frames_of_20_per_second_are_compared_while_the_road_between_them_is_short(speed_mps, dt_s):
    """With each other at the speeds of motorways; the tracker follows the same corners."""
    mounting, flow = Mounting(pitch_deg=5.0), BackgroundFlow()
    axes = mounting.travel_from_camera
    odometry = GroundOdometry(CAMERA, HEIGHT_M, flow=flow, travel_from_camera=axes)
    of_tracker = CameraMotion(flow=flow)
    for k in range(15):
        image = street(mounting, speed_mps * k / 20)
        motion = odometry.update(Frame(k, k / 20, image, None), NO_BOXES)
        moved = of_tracker.update(np.dstack([image] * 3), NO_BOXES, k / 20)
        if k > 8:
            assert motion.speed_mps == pytest.approx(speed_mps, rel=0.05)
            assert odometry.motion.dt_s == pytest.approx(dt_s)
            np.testing.assert_allclose(moved, np.eye(2, 3), atol=1.0)


def test_camera_that_stops_is_at_rest():
    mounting = Mounting(pitch_deg=5.0)
    odometry, _ = driven(mounting, mounting, speed_mps=0.6)
    image = street(mounting, 0.6)
    at_rest = [odometry.update(Frame(k, k * DT_S, image, None), NO_BOXES) for k in range(11, 17)]
    assert all(motion.is_still for motion in at_rest)
    assert abs(at_rest[-1].speed_mps) < 0.15
    assert abs(at_rest[-1].speed_mps) < at_rest[-1].speed_sigma_mps < 0.2


CLOUDS = np.asarray(street(Mounting(pitch_deg=5.0), 0.0)[150:], np.uint8)


@pytest.mark.parametrize("has_road", [True, False])
def test_clouds_behind_the_last_house_are_no_rest(has_road):
    """From the 20th frame on, the corners are in clouds, and then also the road has none."""
    mounting = Mounting(pitch_deg=5.0)
    odometry = GroundOdometry(CAMERA, HEIGHT_M, travel_from_camera=mounting.travel_from_camera)
    speeds_mps, horizon = [], 114
    for k in range(45):
        image = street(mounting, 0.8 * k)
        if k >= 20:
            image[:horizon] = CLOUDS[:horizon]
            if not has_road:
                image[horizon:] = 120
        motion = odometry.update(Frame(k, k * DT_S, image, None), NO_BOXES)
        assert not motion.is_still
        speeds_mps.append(motion.speed_mps)
    known = np.isfinite(speeds_mps)
    assert np.abs(np.array(speeds_mps)[known][4:] - 8.0).max() < 0.6
    assert known[20:].mean() > 0.9 if has_road else not known[31:].any()


def test_pitch_of_a_camera_that_looks_aside_is_measured():
    """Lanes beside the car show that the camera looks down by 2 degrees, which was not given."""
    odometry, motions = driven(Mounting(yaw_deg=90.0, pitch_deg=2.0), Mounting(yaw_deg=90.0), n=16)
    sigma = math.sqrt(odometry.view.horizon_variance)
    assert odometry.view.horizon == pytest.approx(-math.tan(math.radians(2.0)), abs=2.5 * sigma)
    assert 0.001 < sigma < 0.02
    assert motions[-1].speed_mps == pytest.approx(8.0, abs=2 * motions[-1].speed_sigma_mps)


@pytest.mark.parametrize("height_m", [HEIGHT_M, HEIGHT_M / 1.4])
def test_horizon_beside_the_car_whatever_the_height(height_m):
    """If the camera is taken to be too low, a wall 9 m beside it seems to be 6.4 m away."""
    mounting = Mounting(yaw_deg=90.0, pitch_deg=2.4)
    odometry, motions = driven(mounting, mounting, n=16, height_m=height_m)
    sigma = math.sqrt(odometry.view.horizon_variance)
    assert odometry.view.horizon == pytest.approx(-math.tan(math.radians(2.4)), abs=2 * sigma)
    assert 0.001 < sigma < 0.02
    speed_mps = motions[-1].speed_mps * HEIGHT_M / height_m
    assert speed_mps == pytest.approx(8.0, rel=0.05)
