"""How the right camera moves: the filter of changes, the measurements of points, and odometry over
rendered drives whose right camera moves.
"""

import math
from dataclasses import replace

import cv2
import numpy as np
import pytest

from tests.stereo.static_scenes import static_scene, yawed
from track_range.simulation.render.renderer import Renderer, kitti_like_rig
from track_range.simulation.world.scenarios import make_scenario
from track_range.simulation.world.truth import label_scene
from track_range.stereo.geometry.alignment import Alignment
from track_range.stereo.geometry.frames import Frame
from track_range.stereo.odometry.common_zoom import common_zoom
from track_range.stereo.odometry.motion_fit import RigidMotion, fit_motion
from track_range.stereo.odometry.stereo_odometry import StereoOdometry
from track_range.stereo.right_camera.change_filter import ChangeFilter
from track_range.stereo.right_camera.correction import (
    BOW,
    OFFSET,
    PITCH,
    ROLL,
    ZOOM,
    RightCamera,
    changes_of,
)
from track_range.stereo.right_camera.monitor import RightCameraMonitor
from track_range.stereo.right_camera.realignment import Realignment

RIG = kitti_like_rig()
UNKNOWN = math.nan, math.nan


def filtered(values, *, sigma=0.1, lasting=0.1):
    """The change after values at 10 Hz, without steps."""
    changes = ChangeFilter(np.array([lasting]))
    for value in values:
        changes.advance(0.1, np.array([math.nan]), np.array([math.nan]))
        changes.measure(np.array([value]), np.array([sigma]))
    return changes.changes


def test_constant_value_is_no_change():
    rng = np.random.default_rng(0)
    change = filtered(0.7 + 0.1 * rng.normal(size=100))
    assert abs(change.mean[0]) < 0.03
    assert change.sigma[0] < 0.06


@pytest.mark.parametrize("seed", range(5))
def test_change_is_within_its_sigma_soon_after_it(seed):
    rng = np.random.default_rng(seed)
    truth = np.concatenate([np.zeros(30), np.full(10, 2.0)])
    change = filtered(0.4 + truth + 0.1 * rng.normal(size=40))
    assert abs(change.mean[0] - 2.0) < 2.5 * change.sigma[0]
    assert change.sigma[0] < 0.3


def test_slow_drift_is_followed():
    rng = np.random.default_rng(1)
    truth = np.concatenate([np.zeros(30), np.linspace(0, 3, 60)])
    change = filtered(truth + 0.1 * rng.normal(size=90))
    assert abs(change.mean[0] - 3.0) < 2.5 * change.sigma[0]
    assert change.sigma[0] < 0.4


def test_change_that_is_not_clear_yet_widens_sigma():
    still, moving = filtered(np.zeros(20)), filtered(np.append(np.zeros(19), 0.8))
    assert moving.sigma[0] > 3 * still.sigma[0]


def test_step_is_known_at_once_and_small_steps_are_ignored():
    changes = ChangeFilter(np.array([0.1, 0.1]))
    for _ in range(20):
        changes.advance(0.1, np.zeros(2), np.full(2, 0.07))
        changes.measure(np.full(2, 0.5), np.full(2, 0.1))
    changes.advance(0.1, np.array([3.8, 0.2]), np.full(2, 0.07))
    mean, sigma, hit = changes.changes
    assert mean[0] == pytest.approx(3.8, abs=0.02)
    assert sigma[0] == pytest.approx(0.07, abs=0.03)
    assert hit[0] > 0.99
    assert abs(mean[1]) < 0.01


def camera_with(**px):
    change = np.zeros(5)
    for name, value in px.items():
        change[{"pitch": PITCH, "roll": ROLL, "zoom": ZOOM, "offset": OFFSET, "bow": BOW}[name]] = (
            value
        )
    return RightCamera(RIG.left, change=changes_of(change))


def test_small_offset_is_added_to_the_disparities():
    half = RIG.left.width_px / 2 / RIG.left.fx_px
    alignment = camera_with(offset=0.5).alignment
    assert not camera_with(offset=0.5).is_warped
    assert alignment.offset_px == pytest.approx(0.5)
    assert alignment.curvature_px == pytest.approx(0.5 * half**2)


def test_large_offset_moves_the_right_image_to_the_left():
    moved = camera_with(offset=4.0)
    axis = np.array([[RIG.left.cx_px, RIG.left.cy_px]])
    (x_px, y_px), *_ = moved.moved_from(RightCamera(RIG.left), axis)
    assert moved.is_warped
    assert (x_px - axis[0, 0], y_px - axis[0, 1]) == pytest.approx((-4.0, 0.0), abs=1e-6)
    assert moved.alignment.offset_px == 0.0


def test_insignificant_change_is_part_of_sigma():
    own = Alignment(residual_px=0.05)
    change = replace(camera_with(), own=own).change._replace(
        mean=np.array([0, 0, 0, 0.2, 0]), sigma=np.array([0, 0, 0, 0.1, 0])
    )
    alignment = RightCamera(RIG.left, own, change).alignment
    assert alignment.offset_px == 0.0
    assert alignment.residual_px == pytest.approx(math.hypot(0.05, 0.2, 0.1))


def points(n=150, seed=0, *, matrix=None, shift_px=0.0):
    """Points of the left and the right image, and their disparities before the right camera moved."""
    rng = np.random.default_rng(seed)
    left_px = rng.uniform((60, 10), (RIG.left.width_px, RIG.left.height_px), (n, 2))
    disparity_px = rng.uniform(3, 40, n)
    right_px = left_px - np.stack([disparity_px, np.zeros(n)], axis=1)
    if matrix is not None:
        right_px = RIG.left.project(RIG.left.rays(right_px) @ matrix.T)
    right_px = right_px + (shift_px, 0.0) + 0.15 * rng.normal(size=(n, 2))
    return left_px, right_px, disparity_px


def monitored(*, matrix=None, shift_px=0.0):
    """A monitor after a second without movement and two frames with one."""
    monitor = RightCameraMonitor(RIG)
    for k in range(10):
        monitor.update(0.1 * k, 0.1, *points(seed=k), UNKNOWN)
    left_px, right_px, expected_px = points(seed=10, matrix=matrix, shift_px=shift_px)
    monitor.update(1.0, 0.1, left_px, right_px, expected_px, UNKNOWN)
    return monitor


def rotation(*degrees):
    return cv2.Rodrigues(np.radians(np.array(degrees, np.float64)))[0]


def test_turned_right_camera_is_corrected_in_the_first_frame():
    monitor = monitored(matrix=rotation(0.15, 0.3, 0.1))
    left_px, right_px, disparity_px = points(seed=11, matrix=rotation(0.15, 0.3, 0.1))
    corrected_px = monitor.now.moved_from(RightCamera(RIG.left), right_px)
    error_px = disparity_px - (left_px - corrected_px)[:, 0]
    assert abs(np.median(error_px)) < 0.15
    assert abs(np.median(left_px[:, 1] - corrected_px[:, 1])) < 0.15
    (note,) = monitor.notes
    assert "the right camera moved at about 1.0 s" in note


def test_shifted_right_image_bends_no_disparities():
    mean = monitored(shift_px=1.5).now.change.mean
    half = RIG.left.width_px / 2 / RIG.left.fx_px
    assert mean[OFFSET] == pytest.approx(1.5, abs=0.25)
    assert monitored(shift_px=1.5).move == pytest.approx((1.0, mean[OFFSET], 0.1), abs=0.05)
    assert monitored().move is None
    assert mean[OFFSET] * half**2 + mean[BOW] == pytest.approx(0.0, abs=0.5)


def test_zoom_of_one_camera_is_corrected():
    monitor = monitored(matrix=np.diag([1.01, 1.01, 1.0]))
    half_px = RIG.left.width_px / 2
    assert monitor.now.applied_px[ZOOM] / half_px == pytest.approx(0.01, abs=0.001)
    assert "focal length by +1.0 %" in monitor.notes[0]


def test_firm_camera_has_no_note():
    assert monitored().notes == ()
    assert not monitored().now.applied_px.any()


def test_alignment_that_contains_the_change_replaces_it():
    monitor = monitored(shift_px=1.5)
    monitor.follow(Alignment(offset_px=0.0))
    monitor.follow(Alignment(offset_px=1.5))
    assert abs(monitor.now.change.mean[OFFSET]) < 0.25


def test_flow_shows_the_offset_of_the_disparities():
    motion = RigidMotion(yawed(0.004), np.array([0.01, 0.0, -1.0]))
    rays, rho, now = static_scene(motion, n=400)
    offset = 0.005  # 1/m: 1 px with 360 px and 0.54 m
    fit = fit_motion(
        rays,
        rho - offset,
        now,
        noise=0.15 / 360,
        inverse_depth_noise=1e-4,
        rng=np.random.default_rng(0),
    )
    value, sigma = fit.offset
    assert value == pytest.approx(offset, abs=3 * sigma)
    assert sigma < 0.2 * offset


def odometry_of(right_rotation, *, n_frames=30):
    """Odometry and last motion of a drive whose right camera is turned after 1.5 s."""
    rig = kitti_like_rig(width_px=620, height_px=188)
    scene = make_scenario("town", seed=31, seconds=n_frames / 10)
    renderer, odometry, motion = Renderer(scene, rig), StereoOdometry(rig), None
    H = rig.left.matrix @ right_rotation @ np.linalg.inv(rig.left.matrix)
    for k in range(n_frames):
        left, right = (renderer.render(k / 10, side=side) for side in ("left", "right"))
        if k >= 15:
            right = cv2.warpPerspective(right, H, right.shape[1::-1])
        boxes = label_scene(scene, [k / 10], camera=rig.left).xyxy_px
        motion = odometry.update(Frame(k, k / 10, left, right), boxes.reshape(-1, 4))
    assert motion is not None
    return odometry, motion


@pytest.mark.slow
def test_odometry_corrects_a_right_camera_that_is_hit():
    firm, before = odometry_of(np.eye(3))
    hit, after = odometry_of(rotation(0.0, 0.3, 0.0))
    expected_px = firm.right_camera.camera.fx_px * math.radians(0.3)
    assert not firm.right_camera.applied_px.any()
    assert firm.notes == ()
    assert hit.right_camera.applied_px[OFFSET] == pytest.approx(expected_px, abs=0.2)
    assert after.speed_mps == pytest.approx(before.speed_mps, rel=0.02)


@pytest.mark.slow
@pytest.mark.parametrize("yaw_deg", [2.0, -4.0, 4.0])
def test_pair_is_aligned_anew_after_a_far_movement(yaw_deg):
    turned = rotation(0.0, yaw_deg, 0.0)
    odometry, motion = odometry_of(turned, n_frames=50)
    right = odometry.right_camera
    rays = right.camera.rays(np.array([[150.0, 60.0], [310.0, 120.0], [470.0, 90.0]]))
    points_px = right.camera.project(rays)
    corrected_px = right.moved_from(
        RightCamera(right.camera), right.camera.project(rays @ turned.T)
    )
    error_px = corrected_px - points_px
    u = (points_px[:, 0] - right.camera.cx_px) / (right.camera.width_px / 2)
    error_px[:, 0] -= right.alignment.error_px(u)
    assert not right.is_lost
    assert np.abs(error_px).max() < 3 * right.alignment.residual_px < 0.9
    assert motion.speed_mps == pytest.approx(10.0, rel=0.03)
    assert "another alignment" in " ".join(odometry.notes)


def test_right_image_that_shows_few_static_points_is_lost_unless_a_hit_is_known():
    firm = RightCamera(RIG.left)
    hit = replace(firm, change=firm.change._replace(hit=np.array([0.0, 0.0, 0.0, 0.9])))
    for n_static, n_shown, right, is_lost in [
        (100, 90, firm, False),
        (20, 1, firm, False),
        (100, 20, hit, False),
        (100, 20, firm, True),
    ]:
        realignment = Realignment(RIG)
        realignment.check(4.0, n_static, n_shown, right)
        assert realignment.is_lost == is_lost
    assert "4.0 s" in realignment.notes[0]
    image = np.zeros((RIG.left.height_px, RIG.left.width_px), np.uint8)
    frame = Frame(0, 0.0, image, image)
    assert replace(firm, is_lost=True).corrected(frame).right is None
    assert firm.corrected(frame).right is image


def zoomed_points(zoom, *, zooms_disparity=True):
    """Places from the centre of the image and disparities of static points, expected and seen after
    a zoom.
    """
    rng = np.random.default_rng(0)
    expected_px = rng.uniform((-300, -90), (300, 90), (120, 2))
    disparity_px = rng.uniform(2, 20, 120)
    grown = 1 + zoom
    seen_px = expected_px * grown + 0.1 * rng.normal(size=(120, 2))
    seen_disparity_px = disparity_px * (grown if zooms_disparity else 1.0)
    return expected_px, seen_px, disparity_px, seen_disparity_px + 0.1 * rng.normal(size=120)


@pytest.mark.parametrize("zoom", [0.01, 0.03, -0.03])
def test_zoom_of_both_cameras_is_measured(zoom):
    assert common_zoom(*zoomed_points(zoom)) == pytest.approx(zoom, abs=0.001)


def test_growth_without_disparities_is_no_zoom():
    assert common_zoom(*zoomed_points(0.03, zooms_disparity=False)) == 0.0
    assert common_zoom(*zoomed_points(0.0)) == 0.0
