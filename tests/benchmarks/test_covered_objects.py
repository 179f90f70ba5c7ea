"""Tests of occlusion: drawn owners, covered shares and true disparities, and the scenario
`occlusion`."""

from __future__ import annotations

import cv2
import numpy as np
import pytest

from benchmarks.inputs.occlusion_pairs import covered_objects
from track_range.simulation.render.renderer import Renderer, kitti_like_rig
from track_range.simulation.world.bodies.obstacles import BUILDERS
from track_range.simulation.world.scenarios import make_scenario
from track_range.simulation.world.scenarios.occlusion import reference_times_s
from track_range.simulation.world.scene import AWAY_RAD, SIZE_HWL_M, Obstacle, RoadUser, Scene

RIG = kitti_like_rig(width_px=620, height_px=188)
FOCAL_BASELINE = RIG.left.fx_px * RIG.baseline_m
CARS = {1: (-2.0, 14.0), 2: (3.0, 20.0), 3: (3.0, 12.0), 4: (-7.0, 20.0)}
"""x and z of the cars by id: behind the pole, behind a car, in front of it, and free."""

POLE_WIDTH_M, POLE_Z_M = 0.3, 7.0


@pytest.fixture(scope="module")
def renderer():
    """A renderer of four cars and a pole."""
    users = tuple(
        RoadUser(
            track_id=number,
            kitti_type="Car",
            size_hwl_m=SIZE_HWL_M["Car"],
            start_xz_m=place,
            rotation_y_rad=AWAY_RAD,
        )
        for number, place in CARS.items()
    )
    # in front of the middle of the back
    aside_m = CARS[1][0] * POLE_Z_M / (CARS[1][1] - SIZE_HWL_M["Car"][2] / 2)
    size = (3.0, POLE_WIDTH_M, POLE_WIDTH_M)
    pole = Obstacle(number=0, kind="pole", size_hwl_m=size, at_xz_m=(aside_m, POLE_Z_M))
    return Renderer(
        Scene(seed=1, road_users=users, ego_speed_mps=0.0, obstacles=(pole,)), RIG, noise_grey=0
    )


@pytest.fixture(scope="module")
def by_id(renderer):
    """Row of each car in the covered objects, by id, and the objects with boxes of the whole
    car."""
    objects = covered_objects(renderer, 0.0, modal_fraction=0.0)
    return {number: row for row, number in enumerate(objects.track_id.tolist())}, objects


def test_depth_of_owners(renderer):
    inverse_depth, owner = renderer.drawn_owners(0.0)
    assert set(np.unique(owner)) == {0, 1, 2, 3, 4, 5}
    assert 1 / inverse_depth[owner == 5].max() == pytest.approx(
        POLE_Z_M - POLE_WIDTH_M / 2, abs=0.02
    )
    assert 1 / inverse_depth[owner == 1].max() == pytest.approx(
        CARS[1][1] - SIZE_HWL_M["Car"][2] / 2, abs=0.02
    )


def test_silhouette_contains_the_visible_part(renderer):
    inverse_depth, owner = renderer.drawn_owners(0.0)
    alone = renderer.silhouette(0.0, 0)
    is_shown = owner == 1
    assert (alone[is_shown] > 0).all()
    assert alone[is_shown] == pytest.approx(inverse_depth[is_shown], rel=1e-5)
    hidden = (alone > 0) & ~is_shown
    assert set(np.unique(owner[hidden])) == {5}


def test_true_disparity_is_that_of_the_object(by_id):
    rows, objects = by_id
    for number, (_, z_m) in CARS.items():
        back_m = z_m - SIZE_HWL_M["Car"][2] / 2
        assert FOCAL_BASELINE / objects.true_px[rows[number]] == pytest.approx(back_m, rel=0.01)


def test_kinds_and_covered_shares(by_id):
    rows, objects = by_id
    assert [str(objects.kind[rows[number]]) for number in (1, 2, 3, 4)] == [
        "pole",
        "road user",
        "none",
        "none",
    ]
    assert [int(objects.occluder_id[rows[number]]) for number in (1, 2, 3)] == [-1, 3, -1]
    pole_m = POLE_Z_M - POLE_WIDTH_M / 2
    assert FOCAL_BASELINE / objects.occluder_px[rows[1]] == pytest.approx(pole_m, rel=0.03)
    hidden_m = POLE_WIDTH_M * (CARS[1][1] - SIZE_HWL_M["Car"][2] / 2) / POLE_Z_M
    assert objects.covered_fraction[rows[1]] == pytest.approx(hidden_m / 1.9, rel=0.35)
    assert objects.covered_inner[rows[1]] > 1.5 * objects.covered_fraction[rows[1]]
    assert objects.covered_fraction[rows[4]] == objects.covered_inner[rows[4]] == 0


def test_boxes_of_visible_parts(renderer, by_id):
    rows, whole = by_id
    objects = covered_objects(renderer, 0.0, modal_fraction=1.0)
    assert objects.is_modal.all()
    assert not whole.is_modal.any()
    width_px = objects.xyxy_px[:, 2] - objects.xyxy_px[:, 0]
    whole_px = whole.xyxy_px[:, 2] - whole.xyxy_px[:, 0]
    assert width_px[rows[2]] < 0.9 * whole_px[rows[2]]
    assert (objects.xyxy_px[:, :2] > whole.xyxy_px[:, :2] - 1).all()
    assert (objects.xyxy_px[:, 2:] < whole.xyxy_px[:, 2:] + 1).all()


@pytest.mark.parametrize("kind", BUILDERS)
def test_bodies_are_inside_their_boxes(kind):
    height, width, length = size = (1.2, 0.4, 2.0) if kind != "pole" else (3.0, 0.2, 0.2)
    corners = np.concatenate(
        [
            face.corner + np.outer([0, 1, 0, 1], face.along) + np.outer([0, 0, 1, 1], face.down)
            for face in BUILDERS[kind](np.random.default_rng(0), size)
        ]
    )
    # the corners of a prism are outside its sides
    reach = np.array([length / 2, np.inf, width / 2]) * 1.09
    assert (np.abs(corners) <= reach).all()
    assert corners[:, 1].min() == pytest.approx(-height)
    assert corners[:, 1].max() <= 1e-9


def test_fences_have_gaps():
    panel = BUILDERS["fence"](np.random.default_rng(3), (1.2, 0.08, 3.0))[0].texture
    assert 0.2 < (panel[:, :, 3] > 0).mean() < 0.9


def footprint(at_xz_m, size_hwl_m, heading_rad):
    return at_xz_m, (size_hwl_m[2], size_hwl_m[1]), float(-np.degrees(heading_rad))


def test_scenario_has_all_occluders():
    scenes = [make_scenario("occlusion", seed=seed, seconds=7.0) for seed in range(3)]
    kinds = {obstacle.kind for scene in scenes for obstacle in scene.obstacles}
    types = {user.kitti_type for scene in scenes for user in scene.road_users}
    assert kinds == {"pole", "fence", "bush"}
    assert types >= {"Car", "Van", "Pedestrian", "Cyclist", "TrafficSign"}
    for scene in scenes:
        for time_s in reference_times_s(7.0):
            for user in scene.road_users:
                place = footprint(user.on_road_m(time_s), user.size_hwl_m, user.heading_rad(time_s))
                for obstacle in scene.obstacles:
                    other = footprint(
                        obstacle.at_xz_m, obstacle.size_hwl_m, obstacle.rotation_y_rad
                    )
                    assert cv2.rotatedRectangleIntersection(place, other)[0] == cv2.INTERSECT_NONE
