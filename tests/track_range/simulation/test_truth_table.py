"""Tests of exact distances: rays and faces worked by hand, and truth.csv against the rendered
depth."""

import csv
from dataclasses import replace

import numpy as np
import pytest

from track_range.simulation.drive import write_drive
from track_range.simulation.render.renderer import Renderer, kitti_like_rig
from track_range.simulation.render.surface import Surface, centre_depth_m, first_depths_m
from track_range.simulation.world.bodies.faces import Face
from track_range.simulation.world.road_shape import slope_rotation, yaw_rotation
from track_range.simulation.world.scenarios import make_scenario
from track_range.stereo.geometry.camera import PinholeCamera

CAMERA = PinholeCamera(1000.0, 1000.0, 500.0, 200.0, 1000, 400)
RIG = kitti_like_rig()


def plate(z, *, x=(-1.0, 1.0), hole=False, two_sided=False, is_shadow=False, is_back=False):
    texture = np.full((8, 8, 4), 255, np.uint8)
    if hole:
        texture[2:6, 2:6, 3] = 0
    along, corner = np.array([x[1] - x[0], 0.0, 0.0]), np.array([x[0], -1.0, z])
    if is_back:
        along, corner = -along, corner + along
    return Face(corner, along, np.array([0.0, 2.0, 0.0]), texture, two_sided, is_shadow)


def first_depth_m(faces, ray=(0.0, 0.0, 1.0)):
    return first_depths_m(Surface.of(faces), np.array([ray]))[0]


def test_nearest_face_without_holes_shadows_and_backs():
    assert first_depth_m([plate(10.0), plate(7.0)]) == pytest.approx(7.0)
    assert first_depth_m([plate(10.0), plate(7.0, hole=True)]) == pytest.approx(10.0)
    assert first_depth_m([plate(10.0), plate(7.0, is_shadow=True)]) == pytest.approx(10.0)
    assert first_depth_m([plate(10.0), plate(7.0, is_back=True)]) == pytest.approx(10.0)
    assert first_depth_m([plate(10.0), plate(7.0, is_back=True, two_sided=True)]) == pytest.approx(
        7.0
    )
    assert np.isnan(first_depth_m([plate(10.0, x=(0.5, 1.0))]))


def test_depth_of_a_sloping_face():
    # From (-1, ., 8) to (1, ., 12): straight ahead at 10 m, at x = z / 20 where 10 + 2 x = z, z =
    # 10 / 0.9.
    face = Face(
        np.array([-1.0, -1.0, 8.0]),
        np.array([2.0, 0, 4.0]),
        np.array([0, 2.0, 0]),
        plate(1.0).texture,
    )
    depths = first_depths_m(Surface.of([face]), np.array([[0, 0, 1.0], [0.05, 0, 1.0]]))
    np.testing.assert_allclose(depths, [10.0, 10 / 0.9])


def test_transformed_surface_equals_transformed_faces():
    rotation, location_m = yaw_rotation(0.4) @ slope_rotation(-0.1), np.array([0.3, 0.2, 5.0])
    faces = [plate(6.0), plate(3.0, hole=True)]
    surface = Surface.of(faces).transformed(rotation, location_m)
    one_by_one = Surface.of(
        [
            replace(
                face,
                corner=rotation @ face.corner + location_m,
                along=rotation @ face.along,
                down=rotation @ face.down,
            )
            for face in faces
        ]
    )
    rays = np.stack(
        [*np.meshgrid(np.linspace(-0.3, 0.5, 9), np.linspace(-0.2, 0.2, 5)), np.ones((5, 9))],
        axis=2,
    )
    depths = first_depths_m(surface, rays.reshape(-1, 3))
    np.testing.assert_allclose(depths, first_depths_m(one_by_one, rays.reshape(-1, 3)))
    assert 0 < np.isfinite(depths).sum() < 45


def test_ray_through_a_hole_is_replaced_by_the_nearest():
    box = np.array([400.0, 100.0, 600.0, 300.0])  # the plate at 10 m
    assert centre_depth_m(Surface.of([plate(10.0, hole=True)]), CAMERA, box) == pytest.approx(10.0)
    assert np.isnan(centre_depth_m(Surface.of([plate(10.0, x=(5.0, 6.0))]), CAMERA, box))


@pytest.fixture(scope="module")
def city_drive(tmp_path_factory):
    return write_drive(
        tmp_path_factory.mktemp("table"), seed=2, seconds=0.3, rig=RIG, scenario="city"
    )


@pytest.fixture(scope="module")
def rows(city_drive):
    with city_drive.table.open(newline="") as file:
        return list(csv.DictReader(file))


@pytest.mark.slow
def test_distances_equal_the_rendered_depth(rows):
    renderer = Renderer(make_scenario("city", seed=2, seconds=0.3), RIG)
    depth_m = {frame: renderer.depth_m(frame / 10) for frame in range(3)}
    errors = []
    for row in rows:
        if float(row["visible_share"]) > 0.98:
            x, y = ((float(row[f"{axis}1"]) + float(row[f"{axis}2"])) / 2 for axis in "xy")
            errors.append(
                abs(depth_m[int(row["frame"])][round(y), round(x)] / float(row["distance_m"]) - 1)
            )
    assert len(errors) > 20
    # The others are rays between legs or wheels, and pixels on edges.
    assert np.median(errors) < 1e-3
    assert np.mean(np.array(errors) < 0.01) > 0.85


def test_closing_speed_is_the_derivative_of_distance(rows):
    scene = make_scenario("city", seed=2, seconds=0.3)
    ids = [user.track_id for user in scene.road_users]
    for row in rows:
        time_s, k = float(row["time_s"]), ids.index(int(row["id"]))
        before, after = (scene.location_m(time_s + step)[k, 2] for step in (-0.01, 0.01))
        assert float(row["closing_mps"]) == pytest.approx((before - after) / 0.02, abs=0.01)


def test_lanes_classes_and_ids(rows):
    scene = make_scenario("city", seed=2, seconds=0.3)
    by_id = {user.track_id: user for user in scene.road_users}
    lanes = {"": 0, "-1": 0, "0": 0, "1": 0}
    for row in rows:
        user = by_id[int(row["id"])]
        x = user.on_road_m(float(row["time_s"]))[0]
        lane = (
            ""
            if abs(x) > 5.25 or user.raised_m
            else ("0" if abs(x) < 1.75 else "1" if x > 0 else "-1")
        )
        assert row["lane"] == lane
        lanes[lane] += 1
    assert min(lanes.values()) > 0
    assert {row["class"] for row in rows} >= {"car", "bus", "person", "traffic sign"}
    assert len({(row["frame"], row["id"]) for row in rows}) == len(rows)


def test_boxes_equal_those_of_the_kitti_file(city_drive, rows):
    kitti = {
        tuple(line.split()[:2]): [float(word) for word in line.split()[6:10]]
        for line in city_drive.truth.read_text().splitlines()
        if "DontCare" not in line
    }
    assert len(kitti) == len(rows)
    for row in rows:
        box = [float(row[name]) for name in ("x1", "y1", "x2", "y2")]
        np.testing.assert_allclose(box, kitti[row["frame"], row["id"]], atol=1e-3)


def test_visible_shares(rows):
    fractions = np.array([float(row["visible_share"]) for row in rows])
    assert fractions.max() == 1.0
    assert 0 < fractions.min() < 0.6
