"""Tests of winding roads and cameras on them, against numerical derivatives."""

import numpy as np
import pytest

from track_range.simulation.world.road_shape import STRAIGHT, RoadShape, Wobble, pose_on_road
from track_range.simulation.world.scene import AWAY_RAD, RoadUser, Scene

ROAD = RoadShape(swing_m=7.0, hill_m=3.0, swing_phase_rad=1.0, hill_phase_rad=4.0)
BENT = RoadShape(hill_m=3.0, bend_rad=-0.8, bend_at_m=60.0, bend_half_m=20.0)
Z_M = np.array([0.0, 33.0, 120.0, 250.0])


def user(*, x=0.0, z=30.0):
    return RoadUser(
        track_id=0,
        kitti_type="Car",
        size_hwl_m=(1.5, 1.7, 4.0),
        start_xz_m=(x, z),
        rotation_y_rad=AWAY_RAD,
    )


@pytest.mark.parametrize("road", [ROAD, BENT], ids=["winding", "bent"])
def test_yaw_and_climb_are_the_slopes_of_the_road(road):
    step = 1e-4
    slope_x = (road.x_m(Z_M + step) - road.x_m(Z_M - step)) / (2 * step)
    slope_y = (road.y_m(Z_M + step) - road.y_m(Z_M - step)) / (2 * step)
    np.testing.assert_allclose(np.tan(road.yaw_rad(Z_M)), slope_x, atol=1e-7)
    np.testing.assert_allclose(np.tan(road.climb_rad(Z_M)), -slope_y, atol=1e-7)  # y is down
    assert np.abs(slope_x).max() > 0.05
    assert np.abs(slope_y).max() > 0.02


@pytest.mark.parametrize("road", [ROAD, BENT], ids=["winding", "bent"])
def test_road_starts_at_the_origin(road):
    assert float(road.x_m(np.array(0.0))) == pytest.approx(0.0, abs=1e-12)
    assert float(road.y_m(np.array(0.0))) == 0.0


def test_bend_turns_by_its_angle_and_keeps_the_width_of_its_straights():
    road = RoadShape(bend_rad=np.radians(50.0), bend_at_m=120.0, bend_half_m=15.0)
    before_rad, middle_rad, after_rad = road.yaw_rad(np.array([0.0, 120.0, 240.0]))
    assert after_rad - before_rad == pytest.approx(np.radians(50.0), abs=1e-5)
    assert middle_rad == 0.0
    # The edges of a lane are 3.5 m apart, measured perpendicularly to its direction.
    left_m, right_m = road.x_m(np.array(0.0), -1.75), road.x_m(np.array(0.0), 1.75)
    assert (right_m - left_m) * np.cos(before_rad) == pytest.approx(3.5, abs=1e-4)
    assert not road.is_straight
    # The logarithm of the hyperbolic cosine does not overflow far from the bend.
    assert np.isfinite(road.x_m(np.array([-1e5, 1e5]))).all()


def test_camera_on_a_straight_road_is_not_rotated():
    pose = pose_on_road(STRAIGHT, 12.0, height_m=1.6, pitch_roll_rad=(0.0, 0.0))
    np.testing.assert_array_equal(pose.camera_from_world, np.eye(3))
    np.testing.assert_allclose(pose.position_m, [0.0, -1.6, 12.0])


def test_camera_is_directed_along_the_road():
    pose = pose_on_road(ROAD, 40.0, height_m=1.6, pitch_roll_rad=(0.0, 0.0))
    below, ahead = (
        np.array([ROAD.x_m(np.array(z)), ROAD.y_m(np.array(z)), z]) for z in (40.0, 40.1)
    )
    direction = pose.camera_from_world @ (ahead - below)
    assert abs(direction[0] / direction[2]) < 2e-3
    assert abs(direction[1] / direction[2]) < 2e-3
    np.testing.assert_allclose(
        pose.camera_from_world @ pose.camera_from_world.T, np.eye(3), atol=1e-12
    )


def test_signs_of_pitch_and_roll():
    """Pitch up lowers the horizon in the image; roll to the right raises it on the right."""
    up = pose_on_road(STRAIGHT, 0.0, height_m=1.6, pitch_roll_rad=(0.01, 0.0)).camera_from_world @ (
        0,
        0,
        1.0,
    )
    assert up[1] / up[2] == pytest.approx(np.tan(0.01))
    left = pose_on_road(
        STRAIGHT, 0.0, height_m=1.6, pitch_roll_rad=(0.0, 0.01)
    ).camera_from_world @ (-1.0, 0, 0)
    assert left[1] == pytest.approx(np.sin(0.01))


def test_root_mean_square_of_wobble():
    wobble = Wobble(pitch_rad=0.004, roll_rad=0.001, seed=3)
    times = np.arange(0, 60, 0.01)
    pitch_roll_rad = np.array([wobble.pitch_roll_rad(t) for t in times])
    np.testing.assert_allclose(np.sqrt((pitch_roll_rad**2).mean(axis=0)), [0.004, 0.001], rtol=0.02)
    assert wobble.pitch_roll_rad(1.3) == Wobble(
        pitch_rad=0.004, roll_rad=0.001, seed=3
    ).pitch_roll_rad(1.3)
    assert wobble.pitch_roll_rad(1.3) != Wobble(
        pitch_rad=0.004, roll_rad=0.001, seed=4
    ).pitch_roll_rad(1.3)


def test_ego_speed_is_the_speed_of_the_camera():
    scene = Scene(seed=0, road_users=(), ego_speed_changes=((0.0, 8.0), (4.0, 16.0)), road=ROAD)
    for time_s in (0.5, 2.0, 3.9, 6.0):
        before, after = (scene.pose(time_s + step).position_m for step in (-1e-4, 1e-4))
        # The camera, 1.65 m above the asphalt, moves slightly more or less where the slope changes.
        assert scene.speed_mps(time_s) == pytest.approx(
            np.linalg.norm(after - before) / 2e-4, rel=3e-3
        )


def test_vehicle_on_a_winding_road_stays_in_its_lane():
    scene = Scene(seed=0, road_users=(user(x=3.5, z=30.0),), road=ROAD, ego_speed_mps=10.0)
    pose = scene.pose(2.0)
    world = pose.camera_from_world.T @ scene.location_m(2.0)[0] + pose.position_m
    z = np.array(30.0)
    np.testing.assert_allclose(world, [ROAD.x_m(z) + 3.5, ROAD.y_m(z), 30.0], atol=1e-9)
    rotation = scene.rotations(2.0)[0]
    forward = pose.camera_from_world.T @ rotation[:, 0]
    np.testing.assert_allclose(forward[0] / forward[2], np.tan(ROAD.yaw_rad(z)), atol=2e-3)
    # KITTI's rotation_y agrees with the rotation.
    yaw = scene.rotation_y_rad(2.0)[0]
    np.testing.assert_allclose(rotation[:, 0], [np.cos(yaw), 0, -np.sin(yaw)], atol=0.06)
