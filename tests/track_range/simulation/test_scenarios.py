"""Tests of all scenarios: rendering, reproducibility, no collisions."""

from itertools import combinations

import cv2
import numpy as np
import pytest

from track_range.simulation.render.renderer import Renderer, kitti_like_rig
from track_range.simulation.settings import SCENARIO_NAMES
from track_range.simulation.world.scenarios import SCENARIOS, make_scenario
from track_range.simulation.world.surroundings import PERIOD_M, SURROUNDINGS
from track_range.simulation.world.truth import visible_objects

SMALL = kitti_like_rig(width_px=310, height_px=94)
EGO_HW_M = (4.2, 1.8)
"""Length and width of the ego car; the camera is 1.5 m behind its front."""


def test_help_lists_all_scenarios(cli):
    assert tuple(SCENARIOS) == SCENARIO_NAMES
    status, printed, _ = cli("simulate", "--help")
    assert status == 0
    assert all(name in printed for name in SCENARIO_NAMES)


@pytest.mark.slow
@pytest.mark.parametrize("name", SCENARIOS)
def test_scenario_is_rendered_and_labelled(name):
    scene = make_scenario(name, seed=2, seconds=3.0)
    renderer = Renderer(scene, SMALL)
    visible_types = []
    assert renderer.render(0.0, side="right").shape == (94, 310, 3)
    for time_s in (0.0, 2.8):
        image, inverse_depth = renderer.render_with_depth(time_s)
        assert image.shape == (94, 310, 3)
        assert image.std() > 8
        visible_types += visible_objects(
            scene, time_s, frame=0, camera=SMALL.left, inverse_depth=inverse_depth
        ).labels.kitti_type.tolist()
    assert visible_types


@pytest.mark.parametrize("name", SCENARIOS)
def test_same_seed_gives_the_same_scene(name):
    assert make_scenario(name, seed=4) == make_scenario(name, seed=4)
    assert make_scenario(name, seed=4) != make_scenario(name, seed=5)


def footprint(location, size, yaw):
    """Rotated rectangle (centre, size, angle in degrees) of a 3-D box seen from above."""
    return (
        (float(location[0]), float(location[2])),
        (float(size[2]), float(size[1])),
        float(-np.degrees(yaw)),
    )


# vehicles before a fixed camera keep apart where they are seen (test_fixed_scenario)
@pytest.mark.parametrize("name", [name for name in SCENARIOS if name != "fixed"])
@pytest.mark.parametrize("seed", range(3))
def test_no_collisions(name, seed):
    scene = make_scenario(name, seed=seed, seconds=10.0)
    on_road = np.array([user.raised_m == 0 for user in scene.road_users], bool)
    size = scene.size_hwl_m()[on_road]
    # the first road user, which the ego car hits
    struck = 0 if name.startswith(("rear-", "crossing-")) else None
    ego = ((0.0, 1.5 - EGO_HW_M[0] / 2), EGO_HW_M, 90.0)
    for time_s in np.arange(0, 10.01, 0.25):
        location, yaw = scene.location_m(time_s)[on_road], scene.rotation_y_rad(time_s)[on_road]
        footprints = [footprint(*row) for row in zip(location, size, yaw, strict=True)]
        for k, rectangle in enumerate(footprints):
            if k != struck and np.hypot(*location[k][[0, 2]]) < 12:
                kind, _ = cv2.rotatedRectangleIntersection(ego, rectangle)
                assert kind == cv2.INTERSECT_NONE, (time_s, k)
        gaps = np.hypot(*(location[:, None] - location[None])[:, :, [0, 2]].transpose(2, 0, 1))
        near = gaps < (size[:, None, 2] + size[None, :, 2]) / 2 + 1
        for k, other in combinations(range(len(location)), 2):
            if near[k, other]:
                kind, _ = cv2.rotatedRectangleIntersection(footprints[k], footprints[other])
                assert kind == cv2.INTERSECT_NONE, (time_s, k, other)


def test_contents_of_scenarios():
    cut_in, queue, empty, highway = (
        make_scenario(name, seed=1) for name in ("cut-in", "queue", "empty", "highway")
    )
    cutter = cut_in.road_users[0]
    assert [round(cutter.on_road_m(t)[0], 1) for t in (0.0, 6.0)] == [3.6, 0.0]
    assert 6 < cut_in.location_m(4.5)[0, 2] < 25
    assert sum(0 < z < 60 for z in queue.location_m(0.0)[:, 2]) > 12
    assert {user.kitti_type for user in empty.road_users} == {"TrafficSign"}
    assert highway.speed_mps(3.0) > 27
    crossing = make_scenario("crossing", seed=1)
    assert crossing.speed_mps(6.0) == 0.0
    ahead = [
        crossing.location_m(6.0)[k]
        for k, user in enumerate(crossing.road_users)
        if user.kitti_type == "Pedestrian" and abs(user.rotation_y_rad) not in (np.pi / 2,)
    ]
    assert sum(abs(x) < 4 and 3 < z < 15 for x, _, z in ahead) >= 3
    kinds = {user.kitti_type for user in make_scenario("city", seed=1).road_users}
    assert kinds >= {
        "Car",
        "Bus",
        "Motorcycle",
        "Cyclist",
        "Pedestrian",
        "TrafficSign",
        "TrafficLight",
    }


def test_winding_street_turns_to_either_side_within_the_drive():
    turns_deg, speeds_mps = [], []
    for seed in range(12):
        scene = make_scenario("winding", seed=seed, seconds=20.0)
        times_s = np.arange(0, 20, 0.5)
        yaw_deg = np.degrees(scene.road.yaw_rad(scene.ego_z_m(times_s)))
        turns_deg.append(yaw_deg[-1] - yaw_deg[0])
        speeds_mps += [scene.speed_mps(time_s) for time_s in times_s.tolist()]
    assert np.abs(turns_deg).min() > 14
    assert np.abs(turns_deg).max() < 65
    assert min(turns_deg) < 0 < max(turns_deg)
    assert min(speeds_mps) > 4
    assert max(speeds_mps) < 17


@pytest.mark.slow
def test_night_is_dark_with_bright_lamps():
    day, night = (
        Renderer(make_scenario(name, seed=1), SMALL, noise_grey=0).render(1.0)
        for name in ("city", "night")
    )
    assert night.mean() < 0.4 * day.mean()
    assert night.max() > 220


def test_unknown_scenario():
    with pytest.raises(ValueError, match="suburb: expected one of town"):
        make_scenario("suburb")


@pytest.mark.parametrize("kind", SURROUNDINGS.values(), ids=list(SURROUNDINGS))
def test_lengths_divide_the_period(kind):
    assert PERIOD_M % kind.dash_m[1] == 0
    assert all(PERIOD_M % row.every_m == 0 for row in kind.rows)
    assert kind.lane_of(0.0) == 0
    assert kind.lane_of(kind.half_width_m - 0.1) is None
