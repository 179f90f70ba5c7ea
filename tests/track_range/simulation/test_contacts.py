"""Tests of contact times: boxes in the simplest positions, hand-worked times, scenarios."""

from dataclasses import replace

import numpy as np
import pytest

from track_range.simulation.tables import contacts_text
from track_range.simulation.world.contacts import (
    CAMERA_TO_FRONT_M,
    EGO_HWL_M,
    boxes_touch,
    find_contacts,
)
from track_range.simulation.world.motion import travelled_m
from track_range.simulation.world.road_shape import yaw_rotation
from track_range.simulation.world.scenarios import make_scenario
from track_range.simulation.world.scene import AWAY_RAD, RoadUser, Scene

CAR = RoadUser(
    track_id=3,
    kitti_type="Car",
    size_hwl_m=(1.5, 1.8, 4.0),
    start_xz_m=(0.0, 42.0 + CAMERA_TO_FRONT_M),
    rotation_y_rad=AWAY_RAD,
)
COLLISIONS = (
    "rear-stationary",
    "rear-slower",
    "rear-braking",
    "crossing-adult",
    "crossing-child",
    "crossing-car",
    "cut-in",
)
HARMLESS = (
    "yielding",
    "curve-parked",
    "oncoming",
    "overhead-sign",
    "following",
    "queue",
    "city",
    "highway",
    "town",
    "winding",
)


def times(scene, seconds=10.0):
    return [
        (contact.track_id, round(contact.contact_s, 4), contact.is_real)
        for contact in find_contacts(scene, seconds)
    ]


def test_standing_car_is_hit_after_40_m():
    scene = Scene(seed=0, road_users=(CAR,), ego_speed_mps=10.0)
    assert times(scene) == [(3, 4.0, True)]
    assert times(scene, 3.9) == []


@pytest.mark.parametrize(
    ("x_m", "hits"), [(1.79, True), (1.81, False), (-1.79, True), (-1.81, False)]
)
def test_overlap_of_the_widths_decides(x_m, hits):
    user = replace(CAR, start_xz_m=(x_m, CAR.start_xz_m[1]))
    assert bool(times(Scene(seed=0, road_users=(user,), ego_speed_mps=10.0))) == hits


@pytest.mark.parametrize(
    ("raised_m", "hits"), [(EGO_HWL_M[0] - 0.01, True), (EGO_HWL_M[0] + 0.01, False)]
)
def test_ego_passes_below_raised_objects(raised_m, hits):
    user = replace(CAR, raised_m=raised_m)
    assert bool(times(Scene(seed=0, road_users=(user,), ego_speed_mps=10.0))) == hits


def test_late_braking_leaves_a_hypothetical_contact():
    # at 35 m, stops at 38.5
    scene = Scene(seed=0, road_users=(CAR,), ego_speed_changes=((0, 10), (3.5, 10), (4.2, 0)))
    assert times(scene) == [(3, 4.0, False)]


def test_followed_vehicle_that_brakes_is_no_contact():
    lead = replace(
        CAR,
        start_xz_m=(0.0, 20.0 + 2.0 + CAMERA_TO_FRONT_M),
        speed_changes=((0, 10), (2, 10), (5, 0)),
    )
    ego = ((0.0, 10.0), (3.0, 10.0), (6.0, 0.0))
    assert times(Scene(seed=0, road_users=(lead,), ego_speed_changes=ego)) == []
    near = replace(lead, start_xz_m=(0.0, 8.0 + 2.0 + CAMERA_TO_FRONT_M))  # 0.8 s
    assert [
        real for _, _, real in times(Scene(seed=0, road_users=(near,), ego_speed_changes=ego))
    ] == [True]


@pytest.mark.parametrize("name", COLLISIONS)
def test_collision_scenarios_have_one_contact(name):
    for seed in range(4):
        ((track_id, contact_s, is_real),) = times(make_scenario(name, seed=seed))
        assert track_id == 0
        assert 5 < contact_s < 8
        assert is_real == (name != "cut-in")


@pytest.mark.parametrize("name", HARMLESS)
def test_harmless_scenarios_have_no_contact(name):
    assert [times(make_scenario(name, seed=seed)) for seed in range(3)] == [[], [], []]


def test_table_has_a_header_without_contacts():
    assert contacts_text([]) == "object_id,class,contact_s\n"
    scene = make_scenario("crossing-child", seed=3)
    assert contacts_text(find_contacts(scene, 10.0)).splitlines()[1].startswith("0,person,6.")


@pytest.mark.parametrize(("yaw_deg", "touch"), [(0.0, False), (45.0, True)])
def test_corner_of_a_rotated_box_touches(yaw_deg, touch):
    def box(x_m, yaw_rad):
        return np.array([[x_m, 0.0, 0.0]]), yaw_rotation(np.array([yaw_rad])), (1.0, 2.0, 2.0)

    assert boxes_touch(box(0.0, 0.0), box(2.3, np.radians(yaw_deg))).tolist() == [touch]


def test_positions_at_many_times_agree_with_those_at_one():
    scene, at_s = make_scenario("cut-in", seed=1), np.linspace(-1, 12, 27)
    for user in scene.road_users[:4]:
        positions_m, heading_rad = (
            np.transpose(user.on_road_m(at_s)),
            np.broadcast_to(user.heading_rad(at_s), 27),
        )
        for k, time_s in enumerate(at_s.tolist()):
            assert positions_m[k] == pytest.approx(user.on_road_m(time_s), abs=1e-9)
            assert heading_rad[k] == pytest.approx(user.heading_rad(time_s), abs=1e-6)
    changes = scene.ego_speed_changes
    assert travelled_m(changes, at_s) == pytest.approx(
        [travelled_m(changes, t) for t in at_s.tolist()], abs=1e-9
    )
