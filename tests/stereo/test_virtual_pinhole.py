"""Virtual pinholes of wide lenses: field of view, resolution, rectified pairs and points mapped
back."""

from __future__ import annotations

import cv2
import numpy as np
import pytest

from track_range.stereo.geometry.camera import PinholeCamera
from track_range.stereo.geometry.frames import whole_image
from track_range.stereo.geometry.rectification import Rectifier, Undistorter
from track_range.stereo.geometry.rig import RigError, StereoRig
from track_range.stereo.geometry.rig_checks import check_rig, shared_view
from track_range.stereo.geometry.virtual_pinhole import (
    axial_focal_px,
    field_of_view,
    view_from_camera,
    virtual_pinhole,
)

FISHEYE = PinholeCamera(
    300.0, 300.0, 399.5, 249.5, 800, 500, (0.01, 0.002, -0.001, 0.0), "kannala-brandt"
)
WIDE = [
    FISHEYE,
    PinholeCamera(240.0, 240.0, 399.5, 249.5, 800, 500, (-0.2, 0.6), "double-sphere"),
    PinholeCamera(800.0, 800.0, 399.5, 249.5, 800, 500, (1.7, -0.05, 0.01, 0.0, 0.0), "omni"),
]


def equidistant(degrees: float, *, width_px: int = 800) -> PinholeCamera:
    """An ideal equidistant lens with this horizontal field of view."""
    focal_px = width_px / np.radians(degrees)
    return PinholeCamera(
        focal_px, focal_px, (width_px - 1) / 2, 249.5, width_px, 500, (0.0,) * 4, "kannala-brandt"
    )


def test_field_of_view():
    assert field_of_view(equidistant(150.0)).horizontal_deg == pytest.approx(150.0, abs=0.01)
    pinhole = PinholeCamera(400.0, 400.0, 399.5, 249.5, 800, 500)
    assert field_of_view(pinhole).horizontal_deg == pytest.approx(90.0)


@pytest.mark.parametrize(
    ("lens_deg", "fov_deg", "expected_deg"),
    [(100, None, 100), (190, None, 120), (190, 80, 80), (100, 120, 100)],
)
def test_width_of_the_virtual_pinhole(lens_deg, fov_deg, expected_deg):
    camera = equidistant(lens_deg)
    virtual = virtual_pinhole(camera, fov_deg)
    assert field_of_view(virtual).horizontal_deg == pytest.approx(expected_deg, abs=0.2)
    assert virtual.fx_px == pytest.approx(camera.fx_px, rel=1e-5)
    assert virtual.width_px % 2 == virtual.height_px % 2 == 0


@pytest.mark.parametrize("camera", WIDE)
def test_resolution_on_the_axis_is_kept(camera):
    virtual = virtual_pinhole(camera)
    rays = np.array([[0.0, 0.0, 1.0], [0.01, 0.0, 1.0]])
    step_px = np.diff(camera.recorded_px(rays), axis=0)[0, 0]
    assert np.diff(virtual.project(rays), axis=0)[0, 0] == pytest.approx(step_px, rel=1e-3)
    assert axial_focal_px(camera) == pytest.approx(step_px / 0.01, rel=1e-3)


@pytest.mark.parametrize("camera", WIDE)
def test_every_pixel_of_the_undistorted_image_is_imaged(camera):
    undistorter = Undistorter(camera)
    image = np.full((camera.height_px, camera.width_px), 200, np.uint8)
    undistorted = undistorter.undistort(image)
    assert undistorted.shape == (undistorter.camera.height_px, undistorter.camera.width_px)
    assert (undistorted[undistorted.shape[0] // 2] == 200).all()
    assert (undistorted[:, undistorted.shape[1] // 2] == 200).all()


@pytest.mark.parametrize("camera", WIDE)
def test_points_and_boxes_there_and_back(camera):
    undistorter = Undistorter(camera, fov_deg=90)
    xy_px = np.array([[450.0, 300.0], [200.0, 100.0], [399.5, 249.5]])
    rays = camera.recorded_rays(xy_px)
    undistorted_px = undistorter.camera.project(rays)
    assert np.allclose(undistorter.recorded_points(undistorted_px), xy_px, atol=1e-6)
    boxes = undistorter.left_boxes(np.concatenate([xy_px - 1, xy_px + 1], axis=1))
    assert np.allclose((boxes[:, :2] + boxes[:, 2:]) / 2, undistorted_px, atol=0.05)


@pytest.mark.parametrize("yaw_deg", [-60, 45])
def test_view_to_the_side(yaw_deg):
    camera = equidistant(190.0)
    undistorter = Undistorter(camera, fov_deg=60, yaw_deg=yaw_deg)
    shown = undistorter.camera
    assert field_of_view(shown).horizontal_deg == pytest.approx(60, abs=0.2)
    middle = np.array([[np.sin(np.radians(yaw_deg)), 0.0, np.cos(np.radians(yaw_deg))]])
    middle_px = undistorter.recorded_points(np.array([[shown.cx_px, shown.cy_px]]))
    assert np.allclose(middle_px, camera.recorded_px(middle), atol=1e-6)
    points_m = middle * 5 + np.array([[0.3, 0.4, 0.2], [-0.5, -0.2, 0.1]])
    in_view_m = points_m @ view_from_camera(yaw_deg).T
    assert np.allclose(
        undistorter.recorded_points(shown.project(in_view_m)),
        camera.recorded_px(points_m),
        atol=1e-6,
    )
    image = np.full((camera.height_px, camera.width_px), 200, np.uint8)
    assert (undistorter.undistort(image)[shown.height_px // 2] == 200).all()


def test_direction_that_the_lens_does_not_see():
    with pytest.raises(RigError, match="--yaw-deg 80"):
        Undistorter(equidistant(100.0), yaw_deg=80)


@pytest.mark.parametrize("camera", WIDE)
def test_recorded_boxes_invert_the_undistortion_of_boxes(camera):
    undistorter = Undistorter(camera, fov_deg=110)
    rng = np.random.default_rng(0)
    corner, size = rng.uniform((50, 50), (600, 350), (40, 2)), rng.uniform(5, 160, (40, 2))
    recorded = np.concatenate([corner, corner + size], axis=1)
    boxes = undistorter.left_boxes(recorded)
    assert np.allclose(undistorter.left_boxes(undistorter.recorded_boxes(boxes)), boxes, atol=0.1)
    assert undistorter.recorded_boxes(np.zeros((0, 4))).shape == (0, 4)


def test_undistorted_spots_lie_where_the_pinhole_projects_them():
    points_m = np.array([[-2.0, 0.5, 4.0], [0.5, -0.8, 5.0], [3.0, 1.0, 4.0]])
    undistorter = Undistorter(FISHEYE)
    undistorted = undistorter.undistort(spots(FISHEYE.recorded_px(points_m), (800, 500)))
    assert np.allclose(centroids(undistorted), undistorter.camera.project(points_m), atol=0.3)


def motion(rotation_rad, translation_m):
    matrix = np.eye(4)
    matrix[:3, :3], matrix[:3, 3] = (
        cv2.Rodrigues(np.array(rotation_rad, np.float64))[0],
        translation_m,
    )
    return matrix


@pytest.mark.parametrize("right", WIDE)
def test_rectified_pair(right):
    rig = StereoRig(FISHEYE, right, motion((0.01, -0.02, 0.015), (-0.3, 0.004, 0.006)))
    check_rig(rig, "rig")
    assert shared_view(rig) > 0.85
    rectifier = Rectifier(rig, fov_deg=100)
    assert rectifier.rig.is_rectified
    assert field_of_view(rectifier.rig.left).horizontal_deg == pytest.approx(100, abs=0.1)
    points_m = np.array([[-2.0, 0.5, 4.0], [0.5, -0.8, 5.0], [2.5, 1.0, 4.5]])
    in_right_m = points_m @ rig.right_from_left[:3, :3].T + rig.right_from_left[:3, 3]
    left_px, right_px = rectifier.points(
        FISHEYE.recorded_px(points_m), right.recorded_px(in_right_m)
    )
    assert np.allclose(left_px[:, 1], right_px[:, 1], atol=1e-4)
    xyz_m = (
        rectifier.rig.left.rays(left_px)
        * rectifier.rig.distance_m(left_px[:, 0] - right_px[:, 0])[:, None]
    )
    assert np.allclose(np.linalg.norm(xyz_m, axis=1), np.linalg.norm(points_m, axis=1), rtol=1e-5)
    assert np.allclose(rectifier.recorded_points(left_px), FISHEYE.recorded_px(points_m), atol=1e-5)
    images = [
        spots(camera.recorded_px(p), (800, 500))
        for camera, p in ((FISHEYE, points_m), (right, in_right_m))
    ]
    shown = [centroids(whole_image(image)) for image in rectifier.rectify(*images)]
    assert np.allclose(shown[0], left_px, atol=0.3)
    assert np.allclose(shown[1], right_px, atol=0.3)


def spots(xy_px, size_px):
    """Bright blurred spots on black."""
    y, x = np.mgrid[: size_px[1], : size_px[0]]
    image = sum(250 * np.exp(-((x - u) ** 2 + (y - v) ** 2) / (2 * 2.0**2)) for u, v in xy_px)
    return np.clip(image, 0, 255).astype(np.uint8)


def centroids(image):
    """(N, 2) centres of bright spots, from left to right."""
    _, _, _, centres = cv2.connectedComponentsWithStats((image > 20).astype(np.uint8))
    _, label = cv2.connectedComponents((image > 20).astype(np.uint8))
    y, x = np.mgrid[: image.shape[0], : image.shape[1]]
    weight = [np.where(label == i, image, 0).astype(float) for i in range(1, len(centres))]
    found = np.array([[(w * x).sum() / w.sum(), (w * y).sum() / w.sum()] for w in weight])
    return found[np.argsort(found[:, 0])]
