"""Tests of rendered pairs against the geometry of their scenes."""

from dataclasses import replace

import cv2
import numpy as np
import pytest

from track_range.ranging.truth.reference_distance import surface_distance_m
from track_range.simulation.render.renderer import Renderer, kitti_like_rig
from track_range.simulation.render.street import FAR_M, stretches
from track_range.simulation.world.scene import AWAY_RAD, RoadUser, Scene, make_scene
from track_range.simulation.world.truth import label_scene
from track_range.stereo.geometry.rig import StereoRig

RIG = kitti_like_rig()
F, CX, CY = RIG.left.fx_px, RIG.left.cx_px, RIG.left.cy_px


def road_user(track_id, kitti_type="Car", *, x=0.0, back_z=15.0, size=(1.6, 1.8, 4.0)):
    return RoadUser(
        track_id=track_id,
        kitti_type=kitti_type,
        size_hwl_m=size,
        start_xz_m=(x, back_z + size[2] / 2),
        rotation_y_rad=AWAY_RAD,
    )


def disparity_px(left, right, xyxy, *, near_px):
    """Disparity of minimum squared difference, from steps of 0.1 px and a parabola through the best
    three."""
    x1, y1, x2, y2 = xyxy
    x, y = np.meshgrid(np.arange(x1, x2, dtype=np.float32), np.arange(y1, y2, dtype=np.float32))
    patch = left[y1:y2, x1:x2].astype(np.float32)
    candidates_px = near_px + np.arange(-2.0, 2.01, 0.1)
    shifted = [
        cv2.remap(right, x - np.float32(d), y, cv2.INTER_CUBIC).astype(np.float32)
        for d in candidates_px
    ]
    cost = [float(np.square(patch - image).mean()) for image in shifted]
    k = int(np.clip(np.argmin(cost), 1, len(cost) - 2))
    before, best, after = cost[k - 1 : k + 2]
    return candidates_px[k] + 0.05 * (before - after) / (before - 2 * best + after)


@pytest.fixture(scope="module")
def backs():
    """Three vehicles with backs at known depths that do not hide each other, and their left and
    right image."""
    users = (
        road_user(0, x=-3.0, back_z=10.0),
        road_user(1, x=0.3, back_z=20.0),
        road_user(2, "Truck", x=9.0, back_z=50.0, size=(3.3, 2.5, 9.0)),
    )
    renderer = Renderer(Scene(seed=3, road_users=users), RIG)
    return users, renderer.render(0.0, side="left"), renderer.render(0.0, side="right")


@pytest.mark.parametrize("index", [0, 1, 2])
def test_disparity_of_a_face(backs, index):
    users, left, right = backs
    user = users[index]
    height, width, length = user.size_hwl_m
    x, z = user.start_xz_m[0], user.start_xz_m[1] - length / 2
    low, high = (0.2, 0.55) if user.kitti_type == "Car" else (0.35, 0.95)
    box = [CX + F * (x - 0.4 * width) / z, CY + F * (1.65 - high * height) / z]
    box += [CX + F * (x + 0.4 * width) / z, CY + F * (1.65 - low * height) / z]
    expected = F * 0.54 / z
    measured = disparity_px(left, right, np.rint(box).astype(int), near_px=round(expected) + 0.3)
    assert measured == pytest.approx(expected, abs=0.1)


def test_disparity_is_sensitive_to_depth(backs):
    _, left, right = backs
    box = np.rint(
        [CX + F * -0.4 / 20, CY + F * 0.8 / 20, CX + F * 1.0 / 20, CY + F * 1.3 / 20]
    ).astype(int)
    measured = disparity_px(left, right, box, near_px=F * 0.54 / 20)
    assert abs(measured - F * 0.54 / 20.3) > 0.15


def test_disparity_of_the_road():
    # Row by row, since depth depends on the row; without noise, since a single row has little
    # texture.
    renderer = Renderer(Scene(seed=3, road_users=()), RIG, noise_grey=0)
    left, right = renderer.render(0.0, side="left"), renderer.render(0.0, side="right")
    for row in range(200, 360, 16):  # 43 m to 6.4 m
        expected = F * 0.54 / (F * 1.65 / (row - CY))
        measured = disparity_px(
            left, right, (500, row, 800, row + 1), near_px=round(expected) + 0.3
        )
        assert measured == pytest.approx(expected, abs=0.15)


def test_object_is_drawn_in_its_box():
    users = (road_user(0, "Truck", x=-1.0, back_z=14.0, size=(3.0, 2.5, 8.0)),)
    scene = Scene(seed=5, road_users=users)
    empty = replace(scene, road_users=())
    image, background = (Renderer(value, RIG, noise_grey=0).render(0.0) for value in (scene, empty))
    changed = np.abs(image.astype(int) - background).max(axis=2) > 12
    rows, columns = np.flatnonzero(changed.any(axis=1)), np.flatnonzero(changed.any(axis=0))
    x1, y1, x2, y2 = label_scene(scene, [0.0], camera=RIG.left).xyxy_px[0]
    # The shadow on the road extends 0.6 m beyond the right side and the back, and to the left by
    # 0.45 of the height: only the upper edge is that of the body.
    assert rows[0] == pytest.approx(y1, abs=1.0)
    soft_px, cast_px = F * 0.6 / 14.0, F * 0.45 * 3.0 / 14.0
    assert x1 - soft_px - cast_px - 1 <= columns[0] <= x1 - 0.5 * cast_px
    assert x2 - 1 <= columns[-1] <= x2 + soft_px + 1
    body = changed[int(y1) : int((y1 + y2) / 2)]
    across = np.flatnonzero(body.any(axis=0))
    assert across[0] == pytest.approx(x1, abs=1.5)
    assert across[-1] == pytest.approx(x2, abs=1.5)
    assert y2 - 1 <= rows[-1] <= y2 + 6


@pytest.mark.parametrize("seed", [0, pytest.param(1, marks=pytest.mark.slow)])
def test_box_centre_shows_the_surface_of_the_3d_box(seed):
    scene = make_scene(seed)
    renderer = Renderer(scene, RIG)
    labels = label_scene(scene, [0.0, 2.5], camera=RIG.left)
    labels = labels.select(
        (labels.occluded == 0) & (labels.truncated == 0) & (labels.track_id >= 0)
    )
    middle = (labels.xyxy_px[:, :2] + labels.xyxy_px[:, 2:]) / 2
    size, yaw = labels.size_hwl_m, labels.rotation_y_rad
    expected_m = surface_distance_m(
        RIG.left.rays(middle), labels.location_m, size_hwl_m=size, rotation_y_rad=yaw
    )
    column, row = np.rint(middle).astype(int).T
    drawn_m = np.stack([renderer.depth_m(0.0), renderer.depth_m(2.5)])[
        np.where(labels.frame == 0, 0, 1), row, column
    ]
    error = np.abs(drawn_m / expected_m - 1)
    assert len(error) > 10
    # A few rays pass a rider's back and meet a deeper part of the 3-D box, or a neighbour's corner.
    assert np.median(error) < 1e-3
    assert (error < 0.01).mean() > 0.85


def test_depth_of_road_and_sky():
    depth_m = Renderer(Scene(seed=0, road_users=()), RIG).depth_m(0.0)
    row = 300
    assert depth_m[row, 620] == pytest.approx(F * 1.65 / (row - CY), rel=1e-4)
    assert np.isnan(depth_m[60, 620])


@pytest.mark.slow
def test_nearer_objects_hide_farther_ones():
    near, far = road_user(0, back_z=10.0, size=(1.6, 2.4, 4.0)), road_user(1, back_z=30.0)
    both = Renderer(Scene(seed=1, road_users=(far, near)), RIG, noise_grey=0).render(0.0)
    alone = Renderer(Scene(seed=1, road_users=(near,)), RIG, noise_grey=0).render(0.0)
    face = np.s_[
        int(CY + F * 0.75 / 10) : int(CY + F * 1.5 / 10),
        int(CX - F * 1.0 / 10) : int(CX + F * 1.0 / 10),
    ]
    np.testing.assert_array_equal(both[face], alone[face])
    assert not np.array_equal(both, alone)


@pytest.mark.slow
def test_vehicle_next_to_the_camera():
    # from 3 m behind to 9 m ahead
    users = (road_user(0, "Truck", x=-3.5, back_z=-3.0, size=(3.3, 2.5, 12.0)),)
    image, background = (
        Renderer(Scene(seed=5, road_users=road_users), RIG, noise_grey=0).render(0.0)
        for road_users in (users, ())
    )
    changed = np.abs(image.astype(int) - background).max(axis=2) > 12
    assert changed[100:300, :20].mean() > 0.8


@pytest.mark.slow
def test_rendering_is_deterministic_with_the_given_noise():
    small = kitti_like_rig(width_px=310, height_px=94)
    scene = Scene(seed=2, road_users=(road_user(0),))
    clean = Renderer(scene, small, noise_grey=0).render(0.3)
    noisy = Renderer(scene, small).render(0.3)
    assert noisy.shape == (94, 310, 3)
    assert noisy.dtype == np.uint8
    np.testing.assert_array_equal(noisy, Renderer(scene, small).render(0.3))
    error = noisy.astype(float) - clean
    inside = (clean > 10) & (clean < 245)
    # 2 grey levels, and 0.29 from rounding
    assert error[inside].std() == pytest.approx(2.02, abs=0.05)
    assert abs(error[inside].mean()) < 0.05


@pytest.mark.slow
def test_noise_of_left_and_right_is_independent():
    small = kitti_like_rig(width_px=310, height_px=94)
    scene = Scene(seed=2, road_users=())
    clean, noisy = Renderer(scene, small, noise_grey=0), Renderer(scene, small)
    left, right = (
        noisy.render(0.0, side=side).astype(float) - clean.render(0.0, side=side)
        for side in ("left", "right")
    )
    assert abs(np.corrcoef(left.ravel(), right.ravel())[0, 1]) < 0.03


def test_rig_must_be_rectified():
    right_from_left = np.eye(4)
    right_from_left[:3, 3] = -0.5, 0.1, 0.0
    with pytest.raises(ValueError, match="rectified"):
        Renderer(Scene(seed=0, road_users=()), StereoRig(RIG.left, RIG.left, right_from_left))


@pytest.mark.parametrize("ego_m", [0.0, 1.7, 35.9, 48.0, 100.3])
def test_stretches_are_adjacent_within_a_period(ego_m):
    pieces = list(stretches(ego_m))
    starts = np.array([start for start, _ in pieces])
    ends = starts + [length for _, length in pieces]
    np.testing.assert_array_equal(starts[1:], ends[:-1])
    assert starts[0] <= ego_m
    assert ends[-1] >= ego_m + FAR_M
    assert (np.floor(starts / 48.0) == np.ceil(ends / 48.0) - 1).all()
