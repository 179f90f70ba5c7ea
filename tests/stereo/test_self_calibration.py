"""Focal length and lens from the motion of synthetic points, whose scene and camera are known."""

from dataclasses import replace

import cv2
import numpy as np
import pytest

from track_range.foundation.arrays import BoolArray, FloatArray
from track_range.stereo.geometry.camera import PinholeCamera
from track_range.stereo.lenses.pinhole import first_radial
from track_range.stereo.self_calibration.corner_tracks import KeyPoints
from track_range.stereo.self_calibration.radial_lens import K1, READOUT, Family, RadialLens
from track_range.stereo.self_calibration.scene_bundle import Observed, SceneBundle
from track_range.stereo.self_calibration.scene_motion import MotionEstimate, SceneMotion

SIZE_PX = (1200, 400)
FOCAL_PX = 800.0
LENS = RadialLens.of_focal_length(FOCAL_PX, SIZE_PX)


def keyframes(
    lens: RadialLens = LENS,
    *,
    yaw_rate_deg_s: float = 8.0,
    n_keyframes: int = 12,
    n_points: int = 250,
    noise_px: float = 0.0,
    fraction_moving: float = 0.0,
    readout_s: float = 0.0,
) -> list[KeyPoints]:
    """A drive of 10 m/s through a street of random points; moving points drive ahead at 5 m/s. Rows
    are read out from top to bottom, the middle one at the time of the keyframe.
    """
    rng = np.random.default_rng(3)
    seen = []
    world_m = np.column_stack(
        [
            rng.uniform(3.0, 25.0, n_points) * rng.choice([-1.0, 1.0], n_points),
            rng.uniform(-8.0, 1.5, n_points),
            rng.uniform(5.0, 120.0, n_points),
        ]
    )
    is_moving = rng.random(n_points) < fraction_moving
    for number in range(n_keyframes):
        time_s = np.full(n_points, 0.2 * number)
        for _ in range(4 if readout_s else 1):
            camera_m = in_camera(world_m, time_s, yaw_rate_deg_s, is_moving)
            xy_px = lens.project(camera_m)[0]
            row = np.nan_to_num(np.clip(xy_px[:, 1] / (SIZE_PX[1] - 1), 0.0, 1.0), nan=0.5)
            time_s = 0.2 * number + readout_s * (row - 0.5)
        xy_px = xy_px + rng.normal(0.0, noise_px, (n_points, 2))
        with np.errstate(invalid="ignore"):
            is_seen = ((xy_px > 0) & (xy_px < SIZE_PX)).all(axis=1) & (camera_m[:, 2] > 2.0)
        rows = np.flatnonzero(is_seen)
        seen.append(KeyPoints(0.2 * number, rows, xy_px[rows]))
    return seen


def in_camera(
    world_m: FloatArray, time_s: FloatArray, yaw_rate_deg_s: float, is_moving: BoolArray
) -> FloatArray:
    """Points in the camera at their times on an arc."""
    yaw_rad = np.radians(yaw_rate_deg_s) * time_s
    chord_m = 10.0 * time_s * np.sinc(yaw_rad / 2 / np.pi)
    x_m, y_m, z_m = (world_m + (is_moving * time_s)[:, None] * np.array([2.0, 0.0, 5.0])).T
    x_m, z_m = x_m - chord_m * np.sin(yaw_rad / 2), z_m - chord_m * np.cos(yaw_rad / 2)
    sin, cos = np.sin(yaw_rad), np.cos(yaw_rad)
    return np.column_stack([cos * x_m - sin * z_m, y_m, sin * x_m + cos * z_m])


def estimate(drive: list[KeyPoints], start_px: float = 1000.0) -> MotionEstimate:
    motion = SceneMotion(SIZE_PX, start_px=start_px)
    for key_points in drive:
        motion.add_points(key_points)
    found = motion.estimate()
    assert found is not None
    return found


def changed(lens: RadialLens, parameter: int, value: float) -> RadialLens:
    step = np.zeros(6)
    step[parameter] = value
    return lens.moved(step)


@pytest.mark.parametrize("family", ["pinhole", "equidistant"])
def test_derivatives_of_the_lens_equal_finite_differences(family: Family) -> None:
    lens = RadialLens(np.array([6.5, -0.1, 0.02, 3.0, -4.0, 0.0]), np.array([600.0, 200.0]), family)
    q = np.random.default_rng(1).uniform([-1.0, -0.5, 0.7], [1.0, 0.5, 1.5], (20, 3))
    _, by_q, by_parameters = lens.project(q)
    small = 1e-6

    def slope(upper: FloatArray, lower: FloatArray) -> FloatArray:
        return (upper - lower) / (2 * small)

    for axis in range(3):
        step = small * np.eye(3)[axis]
        assert slope(lens.project(q + step)[0], lens.project(q - step)[0]) == pytest.approx(
            by_q[:, :, axis], rel=1e-5, abs=1e-4
        )
    for number in range(5):
        upper, lower = changed(lens, number, small), changed(lens, number, -small)
        assert slope(upper.project(q)[0], lower.project(q)[0]) == pytest.approx(
            by_parameters[:, :, number], rel=1e-5, abs=1e-4
        )


@pytest.mark.parametrize("family", ["pinhole", "equidistant"])
def test_directions_invert_the_projection_without_distortion(family: Family) -> None:
    lens = RadialLens.of_focal_length(500.0, SIZE_PX, family)
    q = np.array([[0.0, 0.0, 1.0], [0.6, 0.0, 0.8], [-0.48, 0.36, 0.8]])
    assert lens.directions(lens.project(q)[0]) == pytest.approx(q, abs=1e-9)


@pytest.mark.parametrize(("k1", "k2"), [(-0.04, 0.0), (0.02, -0.005)])
def test_coefficients_of_a_wide_lens_hold_up_to_the_corners(k1: float, k2: float) -> None:
    """110 degrees across; k1 of the series of theta (1 + k1 theta^2) is that of tan(theta) - 1/3."""
    edge_rad = np.radians(55.0)
    focal_px = 639.5 / (edge_rad * (1 + k1 * edge_rad**2 + k2 * edge_rad**4))
    parameters = np.array([np.log(focal_px), k1, k2, 0.0, 0.0, 0.0])
    lens = RadialLens(parameters, np.array([639.5, 359.5]), "equidistant")
    camera = PinholeCamera.of_focal_length(focal_px, (1280, 720))
    camera = replace(camera, distortion=lens.opencv_distortion())
    q = np.random.default_rng(4).uniform([-1.0, -0.6, 0.5], [1.0, 0.6, 1.0], (500, 3))
    xy_px = lens.project(q)[0]
    is_seen = ((xy_px >= 0) & (xy_px < (1280, 720))).all(axis=1)
    assert camera.recorded_px(q)[is_seen] == pytest.approx(xy_px[is_seen], abs=0.1)
    assert first_radial(camera.distortion) == pytest.approx(k1 - 1 / 3, abs=0.01)


def test_derivatives_of_the_scene_equal_finite_differences() -> None:
    rng = np.random.default_rng(2)
    ray = rng.normal(size=(6, 3)) * [0.3, 0.2, 0.0] + [0.0, 0.0, 1.0]
    scene = SceneBundle(
        Observed(np.ones(6, np.int64), np.arange(6), *rng.normal(size=(2, 6, 2))),
        np.stack([np.eye(3), cv2.Rodrigues(np.array([0.02, -0.05, 0.01]))[0]]),
        np.array([[0.0, 0.0, 0.0], [0.1, -0.05, -0.99]]),
        ray / np.linalg.norm(ray, axis=1, keepdims=True),
        rng.uniform(0.0, 0.4, 6),
        1.0,
        (0.0, 0.2),
    )
    lens = changed(LENS, K1, -0.05)
    linear, small = scene.linearize(lens), 1e-6
    for axis in range(6):
        pose = small * np.eye(6)[axis]
        rotated = np.stack([np.eye(3), cv2.Rodrigues(pose[:3])[0] @ scene.rotation[1]])
        shifted = scene.translation + np.stack([np.zeros(3), pose[3:]])
        moved = replace(scene, rotation=rotated, translation=shifted).linearize(lens)
        assert (linear.residual - moved.residual) / small == pytest.approx(
            linear.by_pose[:, :, axis], rel=1e-3, abs=1e-2
        )
    later = scene.linearize(changed(lens, READOUT, small))
    assert (linear.residual - later.residual) / small == pytest.approx(
        linear.by_shared[:, :, READOUT], rel=1e-6, abs=1e-6
    )
    for axis in range(3):
        step = np.tile(small * np.eye(3)[axis], (6, 1))
        ray = scene.ray + (scene.tangents() @ step[:, :2, None])[:, :, 0]
        nearer = replace(scene, ray=ray, inverse_distance=scene.inverse_distance + step[:, 2])
        assert (linear.residual - nearer.linearize(lens).residual) / small == pytest.approx(
            linear.by_point[:, :, axis], rel=1e-3, abs=1e-2
        )


def test_exact_focal_length_from_a_turn() -> None:
    found = estimate(keyframes())
    assert found.focal_px == pytest.approx(FOCAL_PX, rel=1e-3)
    assert found.turn_deg == pytest.approx(11 * 0.2 * 8.0, abs=0.1)
    assert found.span_s == pytest.approx((0.0, 2.2))
    assert found.sigma < 0.02


@pytest.mark.slow
@pytest.mark.parametrize("readout_s", [0.0, 0.015, 0.03])
def test_rolling_shutter_is_found_in_a_turn(readout_s: float) -> None:
    """Taken for a global shutter, 30 ms would make the focal length too small."""
    drive = keyframes(yaw_rate_deg_s=12.0, n_points=400, noise_px=0.1, readout_s=readout_s)
    found = estimate(drive)
    assert found.readout_s == pytest.approx(readout_s, abs=0.005)
    assert found.focal_px == pytest.approx(FOCAL_PX, rel=0.008)
    assert abs(np.log(found.focal_px / FOCAL_PX)) < 2 * found.sigma


def test_straight_drive_is_unknown() -> None:
    found = estimate(keyframes(yaw_rate_deg_s=0.0, noise_px=0.15))
    assert found.sigma > 0.2
    assert found.turn_deg < 0.5


@pytest.mark.slow
def test_moving_points_are_rejected() -> None:
    found = estimate(keyframes(fraction_moving=0.2, n_points=400))
    assert found.focal_px == pytest.approx(FOCAL_PX, rel=5e-3)
    assert found.n_points < 0.95 * estimate(keyframes(n_points=400)).n_points


@pytest.mark.slow
@pytest.mark.parametrize(
    ("family", "focal_px", "k1", "k2"),
    [
        ("pinhole", 800.0, -0.1, 0.0),
        ("pinhole", 700.0, -0.3, 0.08),
        ("equidistant", 600.0 / np.radians(55.0), 0.02, -0.005),
    ],
)
def test_distorted_and_wide_lenses_are_recognised(
    family: Family, focal_px: float, k1: float, k2: float
) -> None:
    """The radial distortion is right to 2 px up to the edge, also of a lens of 110 degrees."""
    lens = RadialLens(np.array([np.log(focal_px), k1, k2, 0.0, 0.0, 0.0]), LENS.centre_px, family)
    found = estimate(keyframes(lens, n_points=500, noise_px=0.1))
    assert found.focal_px == pytest.approx(focal_px, rel=0.01)
    angle = np.linspace(0.0, 0.9, 50)
    direction = np.column_stack([np.sin(angle), np.zeros(50), np.cos(angle)])
    true_px = lens.project(direction)[0][:, 0] - lens.centre_px[0]
    camera = replace(
        PinholeCamera.of_focal_length(found.focal_px, SIZE_PX),
        distortion=found.coefficients,
    )
    found_px = camera.recorded_px(direction)[:, 0] - lens.centre_px[0]
    is_seen = true_px < 600.0
    assert np.abs(found_px - true_px)[is_seen].max() < 2.0


def test_nothing_without_images() -> None:
    assert SceneMotion(SIZE_PX, start_px=900.0).estimate() is None
