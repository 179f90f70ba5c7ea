"""Tests of labels against numbers worked by hand."""

import itertools

import numpy as np
import pytest
from scipy.spatial import ConvexHull

from track_range.ranging.truth.reference_distance import surface_distance_m
from track_range.simulation.render.renderer import kitti_like_rig
from track_range.simulation.world.road_shape import yaw_rotation
from track_range.simulation.world.scene import AWAY_RAD, RoadUser, Scene, make_scene
from track_range.simulation.world.truth import (
    boxes_in_image,
    corners_m,
    label_scene,
    visible_fractions,
)

CAMERA = kitti_like_rig().left


def car(track_id, *, x, z, size=(1.5, 2.0, 4.0), heading=AWAY_RAD, kitti_type="Car"):
    return RoadUser(
        track_id=track_id,
        kitti_type=kitti_type,
        size_hwl_m=size,
        start_xz_m=(x, z),
        rotation_y_rad=heading,
    )


def labels_of(*users):
    return label_scene(Scene(seed=0, road_users=users), [0.0], camera=CAMERA)


def test_box_of_a_car_straight_ahead():
    labels = labels_of(car(7, x=0.0, z=12.0))
    # Its back, 2 m wide and 1.5 m high, is at 12 - 4/2 = 10 m, and the road 1.65 m below the
    # camera. Its front, at 14 m, gives the upper edge of the box.
    f, cx, cy = CAMERA.fx_px, CAMERA.cx_px, CAMERA.cy_px
    expected = [cx - f * 1.0 / 10, cy + f * 0.15 / 14, cx + f * 1.0 / 10, cy + f * 1.65 / 10]
    np.testing.assert_allclose(labels.xyxy_px, [expected])
    np.testing.assert_allclose(labels.location_m, [[0.0, 1.65, 12.0]])
    assert (labels.track_id[0], labels.kitti_type[0], labels.occluded[0], labels.truncated[0]) == (
        7,
        "Car",
        0,
        0,
    )


def test_box_of_a_car_across_the_road():
    labels = labels_of(car(0, x=0.0, z=21.0, heading=0.0))
    width_px = labels.xyxy_px[0, 2] - labels.xyxy_px[0, 0]
    assert width_px == pytest.approx(CAMERA.fx_px * 4.0 / 20)


def test_corners_are_on_the_road_and_span_the_size():
    rotation = yaw_rotation(np.array([np.pi / 2]))
    corners = corners_m(np.array([[1.0, 1.65, 9.0]]), np.array([[1.5, 2.0, 4.0]]), rotation)[0]
    np.testing.assert_allclose(np.ptp(corners, axis=0), [2.0, 1.5, 4.0])
    np.testing.assert_allclose(corners[:4, 1], 1.65)


def test_box_that_extends_behind_the_camera():
    size, yaw = np.array([[1.5, 2.0, 10.0]]), np.array([AWAY_RAD])
    corners = corners_m(np.array([[3.0, 1.65, 3.0]]), size, yaw_rotation(yaw))
    boxes, outside = boxes_in_image(corners, CAMERA)
    # Its left edge is at its far end, z = 8, x = 2; the right one at the near plane, z = 0.1, x =
    # 4.
    left_px, right_px = CAMERA.cx_px + CAMERA.fx_px * 2 / 8, CAMERA.cx_px + CAMERA.fx_px * 4 / 0.1
    top_px, bottom_px = (CAMERA.cy_px + CAMERA.fy_px * y / 0.1 for y in (0.15, 1.65))
    assert boxes[0, 0] == pytest.approx(left_px)
    assert boxes[0, 2] == CAMERA.width_px - 1
    assert top_px > CAMERA.height_px  # at the near plane the box is below the image
    top_px = CAMERA.cy_px + CAMERA.fy_px * 0.15 / 8
    seen = (CAMERA.width_px - 1 - left_px) * (CAMERA.height_px - 1 - top_px)
    assert 1 - outside[0] == pytest.approx(seen / ((right_px - left_px) * (bottom_px - top_px)))
    assert np.isnan(boxes_in_image(corners - (0, 0, 20), CAMERA)[0]).all()


def test_box_of_a_car_beside_the_camera_ends_where_it_leaves_the_image():
    # Its side is at x = 2, from z = 1 to 9; in the image, which ends at x / z = tan, from z = 2 /
    # tan.
    labels = labels_of(car(0, x=3.0, z=5.0, size=(1.5, 2.0, 8.0)))
    tan = (CAMERA.width_px - 1 - CAMERA.cx_px) / CAMERA.fx_px
    low_m, high_m = 1.65 - 1.5, 1.65
    left, top, right, bottom = labels.xyxy_px[0]
    assert left == pytest.approx(CAMERA.cx_px + CAMERA.fx_px * 2 / 9)
    assert right == CAMERA.width_px - 1
    assert top == pytest.approx(CAMERA.cy_px + CAMERA.fy_px * low_m / 9)
    assert bottom == pytest.approx(
        min(CAMERA.cy_px + CAMERA.fy_px * high_m * tan / 2, CAMERA.height_px - 1)
    )


def part_in_image(corners_m):
    """Corners of the part inside the image of a projected 3-D box: its hull, cut by Sutherland and
    Hodgman's method."""
    in_front = [corner for corner in corners_m if corner[2] >= 0.1]
    for start, end in itertools.combinations(corners_m, 2):
        if (start[2] - 0.1) * (end[2] - 0.1) < 0:
            in_front.append(start + (end - start) * (0.1 - start[2]) / (end[2] - start[2]))
    if not in_front:
        return np.zeros((0, 2))
    xy_px = CAMERA.project(np.array(in_front))
    polygon = list(xy_px[ConvexHull(xy_px).vertices])
    for axis, sign, limit in (
        (0, 1, 0),
        (1, 1, 0),
        (0, -1, CAMERA.width_px - 1),
        (1, -1, CAMERA.height_px - 1),
    ):
        kept = []
        for start, end in zip(polygon, polygon[1:] + polygon[:1], strict=True):
            inside = [sign * (point[axis] - limit) >= 0 for point in (start, end)]
            if inside[0]:
                kept.append(start)
            if inside[0] != inside[1]:
                kept.append(
                    start + (end - start) * (limit - start[axis]) / (end[axis] - start[axis])
                )
        polygon = kept
    return np.array(polygon).reshape(-1, 2)


def test_visible_boxes_are_those_of_the_points_in_the_image():
    rng = np.random.default_rng(0)
    n = 300
    location = np.stack(
        [rng.uniform(-6, 6, n), rng.uniform(0, 3, n), rng.uniform(-2, 9, n)], axis=1
    )
    size, yaw = rng.uniform(0.5, 6, (n, 3)), rng.uniform(-np.pi, np.pi, n)
    corners = corners_m(location, size, yaw_rotation(yaw))
    boxes, _ = boxes_in_image(corners, CAMERA)
    n_visible = 0
    for box, corners_of_one in zip(boxes, corners, strict=True):
        polygon = part_in_image(corners_of_one)
        n_visible += len(polygon) > 0
        if len(polygon):
            np.testing.assert_allclose(box, [*polygon.min(axis=0), *polygon.max(axis=0)], atol=1e-6)
        else:
            assert np.isnan(box).any()
    assert 100 < n_visible < 280


def test_truncated():
    # At 10 m the image ends 629 px = 8.7 m to the right of the camera's axis.
    whole, cut, mostly_cut = (
        labels_of(car(0, x=x, z=12.0, size=(1.5, 2.0, 4.0))) for x in (7.0, 8.2, 11.0)
    )
    assert [labels.truncated[0] for labels in (whole, cut, mostly_cut)] == [0, 1, 2]
    assert cut.xyxy_px[0, 2] == CAMERA.width_px - 1


@pytest.mark.parametrize(("x", "z"), [(0.0, -5.0), (0.0, 101.0), (40.0, 12.0)])
def test_objects_behind_far_or_outside_are_omitted(x, z):
    assert len(labels_of(car(0, x=x, z=z))) == 0


def test_low_boxes_are_dont_care_regions():
    labels = labels_of(car(0, x=0.0, z=99.0, size=(1.3, 1.6, 4.0)))  # 721.5 * 1.3 / 97 = 9.7 px
    assert (labels.kitti_type[0], labels.track_id[0], labels.location_m[0, 2]) == (
        "DontCare",
        -1,
        -1000,
    )


def test_truck_hides_a_car():
    truck = car(0, x=0.0, z=12.0, size=(4.0, 3.0, 4.0), kitti_type="Truck")
    assert labels_of(truck, car(1, x=0.0, z=40.0)).track_id.tolist() == [0]


def test_visible_share_of_a_half_hidden_car():
    # The near car's right edge, x = 0 at 10 m, is in the centre of the far one.
    near, far = (
        car(0, x=-1.5, z=12.0, size=(2.5, 3.0, 4.0)),
        car(1, x=0.0, z=30.1, size=(1.5, 2.0, 0.2)),
    )
    location = np.array([[-1.5, 1.65, 12.0], [0.0, 1.65, 30.1]])
    size, yaw = np.array([near.size_hwl_m, far.size_hwl_m]), np.array([AWAY_RAD, AWAY_RAD])
    boxes, _ = boxes_in_image(corners_m(location, size, yaw_rotation(yaw)), CAMERA)
    fractions = visible_fractions(
        boxes, location, size_hwl_m=size, rotation_y_rad=yaw, camera=CAMERA
    )
    np.testing.assert_allclose(fractions, [1.0, 0.5])
    assert labels_of(near, far).occluded.tolist() == [0, 1]


def test_no_road_users():
    assert len(labels_of()) == 0


def test_ray_through_a_box_centre_meets_the_3d_box():
    labels = label_scene(make_scene(1), [0.0, 2.5, 5.0], camera=CAMERA)
    labels = labels.select(labels.has_3d_box & (labels.truncated == 0))
    assert len(labels) > 20
    middle = (labels.xyxy_px[:, :2] + labels.xyxy_px[:, 2:]) / 2
    distance_m = surface_distance_m(
        CAMERA.rays(middle),
        labels.location_m,
        size_hwl_m=labels.size_hwl_m,
        rotation_y_rad=labels.rotation_y_rad,
    )
    assert (
        np.abs(distance_m - labels.location_m[:, 2]) <= np.hypot(*labels.size_hwl_m[:, 1:].T) / 2
    ).all()


def test_ids_are_unique_within_a_frame():
    labels = label_scene(make_scene(0), [0.0, 1.0], camera=CAMERA)
    tracked = labels.select(labels.track_id >= 0)
    pairs = np.stack([tracked.frame, tracked.track_id], axis=1)
    assert len(np.unique(pairs, axis=0)) == len(pairs) > 20
