"""Tests of the positions of road users, and that they do not collide."""

from dataclasses import replace
from itertools import combinations

import cv2
import numpy as np
import pytest

from track_range.simulation.world.scene import AWAY_RAD, TOWARDS_RAD, RoadUser, Scene, make_scene


def user(track_id=0, *, x=0.5, z=20.0, heading=AWAY_RAD, speed=8.0):
    size = (1.5, 1.7, 4.0)
    return RoadUser(
        track_id=track_id,
        kitti_type="Car",
        size_hwl_m=size,
        start_xz_m=(x, z),
        rotation_y_rad=heading,
        speed_mps=speed,
    )


def test_car_ahead_moves_by_the_relative_speed():
    scene = Scene(seed=0, road_users=(user(),), ego_speed_mps=10.0, camera_height_m=1.6)
    # 20 m + 2 s (8 m/s - 10 m/s)
    np.testing.assert_allclose(scene.location_m(2.0), [[0.5, 1.6, 16.0]], atol=1e-12)


def test_oncoming_car_closes_with_both_speeds():
    scene = Scene(seed=0, road_users=(user(heading=TOWARDS_RAD),), ego_speed_mps=10.0)
    np.testing.assert_allclose(scene.location_m(0.5)[0, 2], 20.0 - 0.5 * 18.0)


def test_rotation_zero_is_along_x():
    scene = Scene(seed=0, road_users=(user(heading=0.0, speed=1.5),), ego_speed_mps=0.0)
    np.testing.assert_allclose(scene.location_m(2.0)[0, [0, 2]], [3.5, 20.0], atol=1e-12)


def test_empty_road():
    assert Scene(seed=0, road_users=()).location_m(1.0).shape == (0, 3)


def test_track_ids_must_be_unique():
    with pytest.raises(ValueError, match="unique track ids"):
        Scene(seed=0, road_users=(user(3), user(3)))


def test_same_seed_gives_the_same_scene():
    assert make_scene(4) == make_scene(4)
    assert make_scene(4) != make_scene(5)


@pytest.mark.parametrize("seed", range(4))
def test_scene_contains_every_type_of_road_user(seed):
    scene = make_scene(seed)
    ids = [road_user.track_id for road_user in scene.road_users]
    assert len(set(ids)) == len(ids)
    assert {road_user.kitti_type for road_user in scene.road_users} == {
        "Car",
        "Van",
        "Truck",
        "Pedestrian",
        "Cyclist",
    }


@pytest.mark.slow
@pytest.mark.parametrize("seed", range(4))
def test_no_collisions(seed):
    scene = make_scene(seed, seconds=10.0)
    size = scene.size_hwl_m()
    for time_s in np.arange(0, 10.01, 0.25):
        location = scene.location_m(time_s)
        for i, j in combinations(range(len(location)), 2):
            if np.hypot(*(location[i] - location[j])[[0, 2]]) < (size[i] + size[j])[2] / 2 + 1:
                rectangles = [
                    (
                        (location[k, 0], location[k, 2]),
                        (size[k, 2], size[k, 1]),
                        -np.degrees(scene.rotation_y_rad()[k]),
                    )
                    for k in (i, j)
                ]
                kind, _ = cv2.rotatedRectangleIntersection(*rectangles)
                assert kind == cv2.INTERSECT_NONE, (
                    time_s,
                    scene.road_users[i],
                    scene.road_users[j],
                )


def test_longer_drive_has_more_parked_cars():
    assert len(make_scene(0, seconds=20.0).road_users) > len(make_scene(0, seconds=5.0).road_users)


def test_larger_cars():
    scene = make_scene(seed=3)
    larger = scene.with_car_sizes(1.1)
    for before, after in zip(scene.road_users, larger.road_users, strict=True):
        factor = 1.1 if before.kitti_type == "Car" else 1.0
        assert after.size_hwl_m == pytest.approx(tuple(factor * size for size in before.size_hwl_m))


def test_pitched_camera():
    """Pitched up by 2 degrees, the point straight ahead at 50 m appears 50 tan(2 degrees) = 1.746 m
    lower."""
    scene = make_scene(seed=3)
    pitched = replace(scene, camera_pitch_rad=np.radians(2.0))
    ahead = scene.pose(0.0).position_m + np.array([0.0, 0.0, 50.0])
    seen = pitched.pose(0.0).camera_from_world @ (ahead - pitched.pose(0.0).position_m)
    assert seen[1] / seen[2] * 50.0 == pytest.approx(1.746, abs=1e-3)
