"""Winding roads and cameras on them, against numerical derivatives."""

import numpy as np
import pytest

from track_range.simulation.world.road_shape import STRAIGHT, RoadShape, Wobble, pose_on_road
from track_range.simulation.world.scene import AWAY_RAD, RoadUser, Scene

ROAD = RoadShape(swing_m=7.0, hill_m=3.0, swing_phase_rad=1.0, hill_phase_rad=4.0)
Z_M = np.array([0.0, 33.0, 120.0, 250.0])


def user(*, x=0.0, z=30.0):
    return RoadUser(
        track_id=0, kitti_type="Car", size_hwl_m=(1.5, 1.7, 4.0), start_xz_m=(x, z), rotation_y_rad=AWAY_RAD
    )


def test_yaw_and_climb_are_the_slopes_of_the_road():
    step = 1e-4
    slope_x = (ROAD.x_m(Z_M + step) - ROAD.x_m(Z_M - step)) / (2 * step)
    slope_y = (ROAD.y_m(Z_M + step) - ROAD.y_m(Z_M - step)) / (2 * step)
    np.testing.assert_allclose(np.tan(ROAD.yaw_rad(Z_M)), slope_x, atol=1e-7)
    np.testing.assert_allclose(np.tan(ROAD.climb_rad(Z_M)), -slope_y, atol=1e-7)  # y is down
    assert np.abs(slope_x).max() > 0.05
    assert np.abs(slope_y).max() > 0.02


def test_a_road_begins_at_the_origin():
    assert (float(ROAD.x_m(np.array(0.0))), float(ROAD.y_m(np.array(0.0)))) == (0.0, 0.0)


def test_a_camera_on_a_straight_road_is_not_turned():
    pose = pose_on_road(STRAIGHT, 12.0, height_m=1.6, pitch_roll_rad=(0.0, 0.0))
    np.testing.assert_array_equal(pose.camera_from_world, np.eye(3))
    np.testing.assert_allclose(pose.place_m, [0.0, -1.6, 12.0])


def test_a_camera_looks_along_its_road():
    pose = pose_on_road(ROAD, 40.0, height_m=1.6, pitch_roll_rad=(0.0, 0.0))
    at, ahead = (np.array([ROAD.x_m(np.array(z)), ROAD.y_m(np.array(z)), z]) for z in (40.0, 40.1))
    seen = pose.camera_from_world @ (ahead - at)
    assert abs(seen[0] / seen[2]) < 2e-3
    assert abs(seen[1] / seen[2]) < 2e-3
    np.testing.assert_allclose(pose.camera_from_world @ pose.camera_from_world.T, np.eye(3), atol=1e-12)


def test_a_camera_that_pitches_up_sees_the_horizon_lower_and_one_that_rolls_right_sees_it_rise_on_the_left():
    up = pose_on_road(STRAIGHT, 0.0, height_m=1.6, pitch_roll_rad=(0.01, 0.0)).camera_from_world @ (0, 0, 1.0)
    assert up[1] / up[2] == pytest.approx(np.tan(0.01))
    left = pose_on_road(STRAIGHT, 0.0, height_m=1.6, pitch_roll_rad=(0.0, 0.01)).camera_from_world @ (-1.0, 0, 0)
    assert left[1] == pytest.approx(np.sin(0.01))


def test_wobble_has_the_root_mean_square_asked_for_and_repeats():
    wobble = Wobble(pitch_rad=0.004, roll_rad=0.001, seed=3)
    times = np.arange(0, 60, 0.01)
    moved = np.array([wobble.pitch_roll_rad(t) for t in times])
    np.testing.assert_allclose(np.sqrt((moved**2).mean(axis=0)), [0.004, 0.001], rtol=0.02)
    assert wobble.pitch_roll_rad(1.3) == Wobble(pitch_rad=0.004, roll_rad=0.001, seed=3).pitch_roll_rad(1.3)
    assert wobble.pitch_roll_rad(1.3) != Wobble(pitch_rad=0.004, roll_rad=0.001, seed=4).pitch_roll_rad(1.3)


def test_the_ego_speed_is_how_fast_the_camera_moves_through_the_world():
    scene = Scene(seed=0, road_users=(), ego_speed_changes=((0.0, 8.0), (4.0, 16.0)), road=ROAD)
    for time_s in (0.5, 2.0, 3.9, 6.0):
        before, after = (scene.pose(time_s + step).place_m for step in (-1e-4, 1e-4))
        # The camera, 1.65 m above the asphalt, moves a little more or less where the slope changes.
        assert scene.speed_mps(time_s) == pytest.approx(np.linalg.norm(after - before) / 2e-4, rel=3e-3)


def test_who_drives_ahead_on_a_winding_road_stays_in_its_lane():
    scene = Scene(seed=0, road_users=(user(x=3.5, z=30.0),), road=ROAD, ego_speed_mps=10.0)
    pose = scene.pose(2.0)
    world = pose.camera_from_world.T @ scene.location_m(2.0)[0] + pose.place_m
    at = np.array(30.0)
    np.testing.assert_allclose(world, [ROAD.x_m(at) + 3.5, ROAD.y_m(at), 30.0], atol=1e-9)
    turn = scene.turns(2.0)[0]
    forward = pose.camera_from_world.T @ turn[:, 0]
    np.testing.assert_allclose(forward[0] / forward[2], np.tan(ROAD.yaw_rad(at)), atol=2e-3)
    # What KITTI's one angle tells of the turn agrees with it.
    yaw = scene.rotation_y_rad(2.0)[0]
    np.testing.assert_allclose(turn[:, 0], [np.cos(yaw), 0, -np.sin(yaw)], atol=0.06)
