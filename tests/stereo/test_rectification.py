"""Rectification of a distorted, rotated synthetic pair: equal rows, correct disparities."""

from __future__ import annotations

from dataclasses import replace

import cv2
import numpy as np
import pytest

from track_range.foundation.arrays import FloatArray, Image
from track_range.stereo.geometry.camera import PinholeCamera
from track_range.stereo.geometry.frames import whole_image
from track_range.stereo.geometry.rectification import Rectifier, Undistorter
from track_range.stereo.geometry.rig import RigAccuracy, RigError, StereoRig
from track_range.stereo.geometry.rig_checks import shared_view, shared_view_notes

LEFT = PinholeCamera(700.0, 705.0, 315.0, 245.0, 640, 480, (-0.25, 0.08, 0.001, -0.0005, 0.0))
RIGHT = PinholeCamera(710.0, 708.0, 330.0, 236.0, 640, 480, (-0.22, 0.06, -0.0008, 0.0007, 0.0))


def motion(
    rotation_rad: tuple[float, float, float], translation_m: tuple[float, float, float]
) -> FloatArray:
    matrix = np.eye(4)
    matrix[:3, :3], matrix[:3, 3] = (
        cv2.Rodrigues(np.array(rotation_rad, np.float64))[0],
        translation_m,
    )
    return matrix


RIG = StereoRig(LEFT, RIGHT, motion((0.02, -0.03, 0.015), (-0.4, 0.01, 0.02)))


def projected(points_m: FloatArray, camera: PinholeCamera, from_left: FloatArray) -> FloatArray:
    """(N, 2) distorted pixels of points in the left camera's frame."""
    rotation, _ = cv2.Rodrigues(from_left[:3, :3])
    pixels, _ = cv2.projectPoints(
        points_m, rotation, from_left[:3, 3], camera.matrix, np.array(camera.distortion)
    )
    return np.asarray(pixels, np.float64).reshape(-1, 2)


def dots(pixels: FloatArray, camera: PinholeCamera) -> Image:
    """Bright blurred spots at subpixel positions on black."""
    image = np.zeros((camera.height_px, camera.width_px))
    y, x = np.mgrid[: camera.height_px, : camera.width_px]
    for u, v in pixels:
        image += 250 * np.exp(-((x - u) ** 2 + (y - v) ** 2) / (2 * 2.5**2))
    return np.clip(image, 0, 255).astype(np.uint8)


def centroids(image: Image) -> FloatArray:
    """(N, 2) centres of bright spots, from left to right."""
    _, label = cv2.connectedComponents((image > 20).astype(np.uint8))
    y, x = np.mgrid[: image.shape[0], : image.shape[1]]
    weight = image.astype(np.float64)
    total = np.bincount(label.ravel(), weight.ravel())[1:]
    centre_x = np.bincount(label.ravel(), (weight * x).ravel())[1:] / total
    centre_y = np.bincount(label.ravel(), (weight * y).ravel())[1:] / total
    return np.stack([centre_x, centre_y], axis=1)[np.argsort(centre_x)]


def test_synthetic_points_have_equal_rows_and_depths() -> None:
    points_m = np.array(
        [
            [x, y, 6.0 + 2 * i]
            for i, (x, y) in enumerate([(-1.2, 0.4), (-0.3, -0.9), (1.0, 0.8), (2.2, -0.2)])
        ]
    )
    left = dots(projected(points_m, LEFT, np.eye(4)), LEFT)
    right = dots(projected(points_m, RIGHT, RIG.right_from_left), RIGHT)
    assert np.abs(centroids(left) - centroids(right))[:, 1].max() > 5  # not rectified yet
    rectifier = Rectifier(RIG)
    left_px, right_px = (centroids(whole_image(image)) for image in rectifier.rectify(left, right))
    assert len(left_px) == len(right_px) == 4
    assert np.abs(left_px[:, 1] - right_px[:, 1]).max() < 0.15
    rotated_m = (
        rectifier.rig.left.rays(left_px)
        * rectifier.rig.distance_m(left_px[:, 0] - right_px[:, 0])[:, None]
    )
    # Rectification rotates the left camera about its centre, so distances to points do not change.
    assert np.allclose(
        np.linalg.norm(rotated_m, axis=1), np.linalg.norm(points_m, axis=1), rtol=0.01
    )
    assert rectifier.rig.is_rectified
    assert rectifier.rig.baseline_m == pytest.approx(
        np.linalg.norm(RIG.right_from_left[:3, 3]), rel=1e-6
    )


UNEQUAL = [
    PinholeCamera(450.0, 450.0, 215.0, 150.0, 420, 300, (-0.2, 0.05, 0.0, 0.0, 0.0)),
    PinholeCamera(1300.0, 1310.0, 640.0, 360.0, 1280, 720),
    PinholeCamera(
        500.0, 500.0, 330.0, 236.0, 640, 480, (-0.1, 0.03, 0.001, 0.0005, 0.01, 0.05, 0.01, 0.0)
    ),
]


@pytest.mark.parametrize("camera", UNEQUAL)
def test_unequal_cameras_get_the_left_geometry(camera: PinholeCamera) -> None:
    rig = StereoRig(LEFT, camera, RIG.right_from_left)
    points_m = np.array([[-0.8, 0.4, 6.0], [0.3, -0.5, 8.0], [1.5, 0.6, 10.0]])
    left = dots(projected(points_m, LEFT, np.eye(4)), LEFT)
    right = dots(projected(points_m, camera, rig.right_from_left), camera)
    rectifier = Rectifier(rig)
    assert rectifier.rig.left.fx_px == pytest.approx(Rectifier(RIG).rig.left.fx_px, rel=0.1)
    left_px, right_px = (centroids(whole_image(image)) for image in rectifier.rectify(left, right))
    assert np.abs(left_px[:, 1] - right_px[:, 1]).max() < 0.2
    rotated_m = (
        rectifier.rig.left.rays(left_px)
        * rectifier.rig.distance_m(left_px[:, 0] - right_px[:, 0])[:, None]
    )
    assert np.allclose(
        np.linalg.norm(rotated_m, axis=1), np.linalg.norm(points_m, axis=1), rtol=0.01
    )


def test_views_with_little_in_common() -> None:
    assert shared_view_notes(RIG, "rig.yaml") == ()
    notes = shared_view_notes(StereoRig(LEFT, RIGHT, motion((0, 0.5, 0), (-0.4, 0, 0))), "rig.yaml")
    assert len(notes) == 1
    assert 0 < shared_view(StereoRig(LEFT, UNEQUAL[1], RIG.right_from_left)) < 1
    with pytest.raises(RigError, match=r"rig\.yaml.*same scene"):
        shared_view_notes(StereoRig(LEFT, RIGHT, motion((0, 0.82, 0), (-0.4, 0, 0))), "rig.yaml")


def test_boxes_move_like_points_on_their_edges() -> None:
    rectifier, undistorter = Rectifier(RIG), Undistorter(LEFT)
    r1 = cv2.stereoRectify(
        *(
            LEFT.matrix,
            np.array(LEFT.distortion),
            RIGHT.matrix,
            np.array(RIGHT.distortion),
            (640, 480),
        ),
        *(RIG.right_from_left[:3, :3].copy(), RIG.right_from_left[:3, 3:].copy()),
        alpha=0,
    )[0]
    corners_m = np.array([[-3.2, -0.5, 8.0], [-1.8, 0.6, 8.0]])
    midpoints_m = np.array(
        [[-3.2, 0.05, 8.0], [-2.5, -0.5, 8.0], [-1.8, 0.05, 8.0], [-2.5, 0.6, 8.0]]
    )
    raw = projected(midpoints_m, LEFT, np.eye(4))
    box = np.array([[raw[0, 0], raw[1, 1], raw[2, 0], raw[3, 1]]])
    rectified = rectifier.rig.left.project(corners_m @ r1.T).reshape(1, 4)
    # the rotation tilts the edges slightly
    np.testing.assert_allclose(rectifier.left_boxes(box), rectified, atol=6.0)
    straight = LEFT.without_distortion().project(corners_m).reshape(1, 4)
    np.testing.assert_allclose(undistorter.left_boxes(box), straight, atol=1.0)
    assert np.abs(box - straight).max() > 2.0  # the distortion exceeds the tolerance
    ideal = Undistorter(LEFT.without_distortion())
    assert ideal.left_boxes(box) is box
    assert undistorter.left_boxes(np.zeros((0, 4))).shape == (0, 4)


def test_what_is_known_of_the_lengths_of_a_rig_holds_after_rectification() -> None:
    accuracy = RigAccuracy(focal_sigma=0.01, scale_sigma=0.02)
    rig = replace(RIG, accuracy=accuracy, baseline_sigma=0.6)
    rectified = Rectifier(rig).rig
    assert rectified.is_rectified
    assert (rectified.accuracy, rectified.baseline_sigma) == (accuracy, 0.6)


def test_rectified_pair_is_not_copied() -> None:
    rig = StereoRig.rectified(LEFT.without_distortion(), 0.5)
    left, right = np.zeros((2, 480, 640, 3), np.uint8)
    rectifier = Rectifier(rig)
    assert rectifier.rig is rig
    out_left, out_right = rectifier.rectify(left, right)
    assert out_left is left
    assert out_right is right


def test_windows_equal_the_whole_right_image() -> None:
    image = np.random.default_rng(1).integers(0, 256, (480, 640, 3), dtype=np.uint8)
    rectifier = Rectifier(RIG)
    whole = whole_image(rectifier.rectify(image, image)[1])
    assert whole.shape == (480, 640)
    assert whole.std() > 10
    for window in (
        (slice(0, 30), slice(0, 50)),
        (slice(470, 480), slice(600, 640)),
        (slice(101, 333), slice(57, 90)),
    ):
        cut = rectifier.rectify(image, image)[1][window]
        assert np.array_equal(cut, whole[window])
    assert np.array_equal(whole_image(whole), whole)


def test_whole_image_is_cached() -> None:
    image = np.zeros((480, 640), np.uint8)
    view = Rectifier(RIG).rectify(image, image)[1]
    assert view.shape == (480, 640)
    assert np.shares_memory(whole_image(view), whole_image(view))
    assert np.shares_memory(view[10:20, 5:6], whole_image(view))


@pytest.mark.parametrize("rig", [RIG, StereoRig.rectified(LEFT.without_distortion(), 0.5)])
def test_row_offset_is_removed(rig: StereoRig) -> None:
    """The right image moves up by 1.4 px, and not sideways."""
    image = dots(np.array([[150.0, 120.0], [320.0, 240.0], [480.0, 330.0]]), LEFT)
    before = centroids(whole_image(Rectifier(rig).rectify(image, image)[1]))
    rectifier = Rectifier(rig, row_offset_px=1.4)
    left, right = rectifier.rectify(image, image)
    assert np.abs(centroids(whole_image(right)) - before - (0, -1.4)).max() < 0.05
    assert rectifier.rig.left == Rectifier(rig).rig.left
    assert (left is image) == rig.is_rectified


def test_colour_is_rectified_as_grey_is() -> None:
    image = np.random.default_rng(0).integers(0, 256, (480, 640), dtype=np.uint8)
    rectifier = Rectifier(RIG)
    grey, _ = rectifier.rectify(image, image)
    colour, _ = rectifier.rectify(np.dstack([image] * 3), np.dstack([image] * 3))
    assert grey.shape == (480, 640)
    assert np.array_equal(colour[..., 1], grey)


def test_undistorted_points_match_the_ideal_camera() -> None:
    points_m = np.array([[-2.0, -1.2, 6.0], [-0.5, 1.0, 6.0], [0.6, -0.4, 6.0], [1.8, 1.1, 6.0]])
    undistorter = Undistorter(LEFT)
    distorted = dots(projected(points_m, LEFT, np.eye(4)), LEFT)
    ideal_px = undistorter.camera.project(points_m)
    assert np.abs(centroids(distorted) - ideal_px).max() > 3
    assert np.abs(centroids(undistorter.undistort(distorted)) - ideal_px).max() < 0.15
    assert not undistorter.camera.is_distorted


def test_undistorted_image_is_not_copied() -> None:
    image = np.zeros((480, 640), np.uint8)
    assert Undistorter(LEFT.without_distortion()).undistort(image) is image


@pytest.mark.parametrize(
    ("rig", "key_word"),
    [
        (StereoRig(LEFT, RIGHT, motion((0, 0, 0), (-0.05, 0.4, 0))), "side by side"),
        (StereoRig(LEFT, RIGHT, motion((0, 0, np.pi - 0.01), (-0.4, 0, 0))), "179 degrees"),
        (StereoRig(LEFT, RIGHT, motion((0, 2.0, 0), (-0.4, 0, 0))), "115 degrees"),
        (StereoRig(LEFT, RIGHT, motion((0, 0, 0), (-0.1, 0, 0.4))), "one behind the other"),
        (StereoRig(LEFT, RIGHT, motion((0, 0, 0), (0.4, 0, 0))), "swap"),
        (StereoRig(LEFT, RIGHT, motion((0, 0, 0), (-400.0, 0, 0))), "metres"),
    ],
)
def test_rigs_that_cannot_be_rectified(rig: StereoRig, key_word: str) -> None:
    with pytest.raises(RigError, match=key_word):
        Rectifier(rig)


def test_implausible_distortion_is_refused() -> None:
    wrong = PinholeCamera(700.0, 700.0, 320.0, 240.0, 640, 480, (100.0, 0.0, 0.0, 0.0, 0.0))
    with pytest.raises(RigError, match=r"rig\.yaml: .*focal length"):
        Rectifier(StereoRig(wrong, wrong, motion((0, 0, 0), (-0.4, 0, 0))), source="rig.yaml")


def test_wrong_image_size() -> None:
    small, good = np.zeros((240, 320), np.uint8), np.zeros((480, 640), np.uint8)
    with pytest.raises(ValueError, match=r"left: .*320x240"):
        Rectifier(RIG).rectify(small, good)
    with pytest.raises(ValueError, match=r"right: .*320x240"):
        Rectifier(RIG).rectify(good, small)
    with pytest.raises(ValueError, match=r"image: .*320x240"):
        Undistorter(LEFT).undistort(small)


def test_depth_of_a_wall_is_moved_as_the_image_and_measured_along_the_new_axis():
    """A wall at 10 m before a distorted camera that rectification turns by 6 degrees."""
    left = PinholeCamera(300.0, 300.0, 159.5, 119.5, 320, 240, distortion=(-0.2, 0.05, 0, 0, 0))
    rig = StereoRig(left, left, motion((0.0, 0.2, 0.0), (-0.5, 0.0, 0.0)))
    rectifier = Rectifier(rig)
    depth = np.full((120, 160), 10.0, np.float32)  # half of the resolution of the images
    depth[:, :40] = np.nan
    moved = rectifier.left_depth(depth, rectifier.rig.left.size_px)
    assert moved.shape == depth.shape
    assert moved is not depth
    rectified = rectifier.rig.left
    for row, column in ((60, 80), (30, 100), (90, 120)):
        x_px, y_px = 2 * column + 0.5, 2 * row + 0.5
        z = moved[row, column]
        seen = rectifier.recorded_points(np.array([[x_px, y_px]]))
        ray = undistorted_ray(left, seen)
        point = 10.0 * ray / ray[2]  # of the wall, in the recorded camera's frame
        x, y = (
            (x_px - rectified.cx_px) / rectified.fx_px,
            (y_px - rectified.cy_px) / rectified.fy_px,
        )
        in_view = z * np.array([x, y, 1.0])
        assert np.linalg.norm(in_view) == pytest.approx(np.linalg.norm(point), rel=2e-3)
    assert np.isnan(moved[60, :20]).all()
    again = rectifier.left_depth(2 * depth, rectified.size_px)
    np.testing.assert_allclose(again, 2 * moved)


def undistorted_ray(camera, xy_px):
    xy = cv2.undistortPoints(xy_px.reshape(-1, 1, 2), camera.matrix, np.array(camera.distortion))
    return np.append(xy[0, 0], 1.0)
