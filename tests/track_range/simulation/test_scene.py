"""Where road users are, and that nobody stands in anybody."""

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


def test_a_car_ahead_moves_by_its_speed_less_ours():
    scene = Scene(seed=0, road_users=(user(),), ego_speed_mps=10.0, camera_height_m=1.6)
    # 20 m + 2 s (8 m/s - 10 m/s)
    np.testing.assert_allclose(scene.location_m(2.0), [[0.5, 1.6, 16.0]], atol=1e-12)


def test_an_oncoming_car_closes_with_both_speeds():
    scene = Scene(seed=0, road_users=(user(heading=TOWARDS_RAD),), ego_speed_mps=10.0)
    np.testing.assert_allclose(scene.location_m(0.5)[0, 2], 20.0 - 0.5 * 18.0)


def test_rotation_zero_heads_along_x():
    scene = Scene(seed=0, road_users=(user(heading=0.0, speed=1.5),), ego_speed_mps=0.0)
    np.testing.assert_allclose(scene.location_m(2.0)[0, [0, 2]], [3.5, 20.0], atol=1e-12)


def test_an_empty_road_has_no_rows():
    assert Scene(seed=0, road_users=()).location_m(1.0).shape == (0, 3)


def test_track_ids_must_be_unique():
    with pytest.raises(ValueError, match=r"track ids must be unique, \[3, 3\] got"):
        Scene(seed=0, road_users=(user(3), user(3)))


def test_a_seed_makes_one_scene():
    assert make_scene(4) == make_scene(4)
    assert make_scene(4) != make_scene(5)


@pytest.mark.parametrize("seed", range(4))
def test_a_scene_holds_every_kind_of_road_user(seed):
    scene = make_scene(seed)
    ids = [one.track_id for one in scene.road_users]
    assert len(set(ids)) == len(ids)
    assert {one.kitti_type for one in scene.road_users} == {"Car", "Van", "Truck", "Pedestrian", "Cyclist"}


@pytest.mark.parametrize("seed", range(4))
def test_nobody_runs_into_anybody(seed):
    scene = make_scene(seed, seconds=10.0)
    size = scene.size_hwl_m()
    for time_s in np.arange(0, 10.01, 0.25):
        place = scene.location_m(time_s)
        for one, other in combinations(range(len(place)), 2):
            if np.hypot(*(place[one] - place[other])[[0, 2]]) < (size[one] + size[other])[2] / 2 + 1:
                corners = [
                    ((place[k, 0], place[k, 2]), (size[k, 2], size[k, 1]), -np.degrees(scene.rotation_y_rad()[k]))
                    for k in (one, other)
                ]
                kind, _ = cv2.rotatedRectangleIntersection(*corners)
                assert kind == cv2.INTERSECT_NONE, (time_s, scene.road_users[one], scene.road_users[other])


def test_a_longer_drive_passes_more_parked_cars():
    assert len(make_scene(0, seconds=20.0).road_users) > len(make_scene(0, seconds=5.0).road_users)
