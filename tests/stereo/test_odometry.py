import math
from dataclasses import replace

import numpy as np
import pytest

from tests.stereo.static_scenes import CAMERA, NOISE, static_scene, yawed
from track_range.simulation.render.renderer import Renderer, kitti_like_rig
from track_range.simulation.world.scenarios import make_scenario
from track_range.simulation.world.truth import label_scene
from track_range.stereo.geometry.frames import Frame
from track_range.stereo.geometry.mounting import Mounting
from track_range.stereo.odometry.ground_odometry import (
    GroundOdometry,
    _interval_s,
    plane_error,
    slow_factor,
)
from track_range.stereo.odometry.image_motion import ImageMotionEstimator, fit_epipolar
from track_range.stereo.odometry.motion_fit import RigidMotion, fit_motion
from track_range.stereo.odometry.speed_filter import SpeedFilter
from track_range.stereo.odometry.stereo_odometry import StereoOdometry

NO_BOXES = np.zeros((0, 4))
AHEAD = Mounting()


def fitted(rays, rho, now, **given):
    return fit_motion(
        rays,
        rho,
        now,
        noise=NOISE,
        inverse_depth_noise=0.15 / (360 * 0.54),
        rng=np.random.default_rng(0),
        **given,
    )


def epipolar_fit(rays, now, mounting=AHEAD):
    travel_from_camera = mounting.travel_from_camera
    return fit_epipolar(
        rays,
        now,
        direction=-travel_from_camera[2],
        direction_variance=np.full(2, 0.05**2),
        travel_from_camera=travel_from_camera,
        focal_px=360.0,
    )


@pytest.mark.parametrize("speed_m", [-0.5, 0.0, 0.05, 1.0, 3.5])
def test_motion_of_static_scene(speed_m):
    true = RigidMotion(yawed(-0.02), np.array([0.0, 0.0, -speed_m]))
    fit = fitted(*static_scene(true))
    assert fit.motion.translation_m[2] == pytest.approx(-speed_m, abs=0.02 + 0.005 * abs(speed_m))
    assert np.abs(fit.motion.rotation - true.rotation).max() < 1e-3
    sigma_m = math.sqrt(fit.covariance[5, 5])
    assert 0.0003 < sigma_m < 0.05
    assert abs(fit.motion.translation_m[2] + speed_m) < 5 * sigma_m


def test_motion_beside_large_truck():
    """45 % of the corners are on a truck that is 3 m/s slower."""
    rays, rho, now = static_scene(RigidMotion(np.eye(3), np.array([0.0, 0.0, -1.0])))
    truck = slice(0, 90)
    rho[truck] = 1 / 9.0
    moved = RigidMotion(np.eye(3), np.array([0.0, 0.0, -0.3])).moved(rays[truck], rho[truck])
    now[truck] = moved / moved[:, 2:]
    fit = fitted(rays, rho, now)
    assert fit.motion.translation_m[2] == pytest.approx(-1.0, abs=0.02)
    assert fit.is_static[:90].mean() < 0.3
    assert fit.is_static[90:].mean() > 0.9


def test_expected_motion_does_not_change_the_fit():
    """Near it, no triples are needed; far from it, or among many moving points, they decide."""
    true = RigidMotion(yawed(0.01), np.array([0.05, 0.0, -1.0]))
    rays, rho, now = static_scene(true)
    by_triples = fitted(rays, rho, now).motion
    near = RigidMotion(yawed(0.02), np.array([0.0, 0.0, -1.2]))
    far = RigidMotion(yawed(-0.3), np.array([0.0, 0.0, 3.0]))
    for start in (near, far):
        motion = fitted(rays, rho, now, start=start).motion
        np.testing.assert_allclose(motion.rotation, by_triples.rotation, atol=1e-5)
        np.testing.assert_allclose(motion.translation_m, by_triples.translation_m, atol=2e-3)
    truck = slice(0, 90)
    rho[truck] = 1 / 9.0
    slow = RigidMotion(np.eye(3), np.array([0.0, 0.0, -0.3]))
    moved = slow.moved(rays[truck], rho[truck])
    now[truck] = moved / moved[:, 2:]
    assert fitted(rays, rho, now, start=slow).motion.translation_m[2] == pytest.approx(
        -1.0, abs=0.02
    )


def test_common_disparity_error():
    """`by_offset` predicts the effect of a common error of the inverse depths."""
    rays, rho, now = static_scene(RigidMotion(np.eye(3), np.array([0.0, 0.0, -1.0])), noise=0.0)
    fit, shifted = fitted(rays, rho, now), fitted(rays, rho + 1e-4, now)
    change_m = shifted.motion.translation_m[2] - fit.motion.translation_m[2]
    assert change_m == pytest.approx(1e-4 * fit.by_offset[5], rel=0.2)
    assert change_m > 0


@pytest.mark.parametrize("yaw_rad", [-0.03, 0.0, 0.03])
def test_yaw_of_epipolar_fit(yaw_rad):
    true = RigidMotion(yawed(-yaw_rad), np.array([0.0, 0.0, -1.0]))
    rays, _, now = static_scene(true)
    fit = epipolar_fit(rays, now)
    assert -fit.rotation[1] == pytest.approx(yaw_rad, abs=2e-3)
    assert fit.direction[2] < -0.99
    assert fit.is_static.mean() > 0.9


def test_reversing_has_opposite_direction():
    rays, _, now = static_scene(RigidMotion(np.eye(3), np.array([0.0, 0.0, 1.0])))
    fit = epipolar_fit(rays, now)
    assert fit.direction[2] > 0.99


def test_filter_follows_braking():
    """Mean speeds of intervals: the filter states the speed at their ends."""
    speeds, kalman = SpeedFilter(), []
    for k in range(1, 31):
        mean_mps = 20.0 - 5.0 * (k - 0.5) * 0.1
        kalman.append(speeds.update(0.1 * k, 0.1, mean_mps, 0.05, 0.0)[0])
    assert kalman[-1] == pytest.approx(5.0, abs=0.05)


def test_filter_ignores_one_outlier_and_bridges_gaps():
    speeds = SpeedFilter()
    for k in range(10):
        speeds.update(0.1 * k, 0.1, 10.0, 0.05, 0.0)
    assert speeds.update(1.0, 0.1, 30.0, 0.05, 0.0)[0] == pytest.approx(10.0, abs=0.1)
    assert speeds.update(1.1, 0.1, math.nan, math.nan, math.nan)[0] == pytest.approx(10.0, abs=0.1)
    assert not speeds.is_measured
    assert math.isnan(speeds.update(2.0, 0.1, math.nan, math.nan, math.nan)[0])
    assert speeds.update(2.1, 0.1, 12.0, 0.05, 0.0)[0] == pytest.approx(12.0, abs=0.1)
    assert speeds.is_measured


def filtered(speeds_mps, dt_s, sigma_mps=0.2):
    """(N, 2) speeds and standard deviations of a filter at the ends of frames with mean speeds."""
    speeds = SpeedFilter()
    return np.array(
        [speeds.update(k * dt_s, dt_s, v, sigma_mps, 0.0) for k, v in enumerate(speeds_mps)]
    )


@pytest.mark.parametrize("wrong_mps", [0.0, 0.7, 40.0])
def test_filter_uses_no_speed_that_a_car_does_not_reach(wrong_mps):
    """At 15 m/s, something else shows another speed for a second: predicted, then unknown."""
    speeds_mps, sigmas_mps = filtered([15.0] * 20 + [wrong_mps] * 50 + [15.0] * 10, 1 / 30).T
    during = speeds_mps[20:70]
    assert np.abs(during[np.isfinite(during)] - 15.0).max() < 0.5
    assert np.isfinite(during[:29]).all()
    assert np.isnan(during[-10:]).all()
    assert (np.diff(sigmas_mps[20:48]) > 0).all()
    assert np.abs(speeds_mps[71:] - 15.0).max() < 0.3  # known again at once


@pytest.mark.parametrize("dt_s", [1 / 30, 0.1])
def test_filter_follows_a_car_that_brakes_fully_to_rest_and_starts_again(dt_s):
    times_s = np.arange(0.0, 8.0, dt_s)
    true_mps = np.interp(times_s, [1.0, 3.0, 4.0, 6.0], [20.0, 0.0, 0.0, 6.0])
    means_mps = np.interp(times_s - dt_s / 2, times_s, true_mps)
    speeds_mps, sigmas_mps = filtered(means_mps, dt_s).T
    error = np.abs(speeds_mps - true_mps)
    assert np.isfinite(speeds_mps).all()
    assert error.max() < 1.0
    assert (error < 2 * sigmas_mps).mean() > 0.9
    assert np.abs(speeds_mps[(times_s > 3.7) & (times_s < 4.0)]).max() < 0.1


def test_filter_takes_another_speed_when_a_car_has_had_the_time_for_it():
    """15 m/s, predicted, unknown, then rest: when two standard deviations of what drivers do,
    2.5 m/s per root of a second, are 15 m/s."""
    speeds = SpeedFilter()
    for k in range(10):
        speeds.update(0.1 * k, 0.1, 15.0, 0.1, 0.0)
    late = np.array([speeds.update(1.0 + 0.1 * k, 0.1, 0.0, 0.1, 0.0)[0] for k in range(110)])
    unknown = np.flatnonzero(np.isnan(late))
    assert 8 <= unknown[0] <= 11
    assert 75 <= unknown[-1] <= 95
    assert np.abs(late[unknown[-1] + 1 :]).max() < 0.3


def test_speeds_of_a_source_with_a_larger_error_give_way_to_better_ones():
    """10 m/s by a source that may be 2 m/s wrong, and 14 m/s by one that is right within 0.1."""
    speeds, other = SpeedFilter(), SpeedFilter()
    for k in range(30):
        rough = speeds.update(k / 30, 1 / 30, 10.0, 0.5, 2.0)
        other.update(k / 30, 1 / 30, 10.0, 0.5, 0.1)
    assert rough[1] == pytest.approx(math.hypot(2.0, speeds.noise_mps))
    better = speeds.update(1.0, 1 / 30, 14.0, 0.2, 0.1)
    assert better[0] == pytest.approx(14.0, abs=0.3)
    assert better[1] < 0.5
    assert other.update(1.0, 1 / 30, 14.0, 0.2, 0.1)[0] == pytest.approx(10.0, abs=0.1)
    # the rough source cannot correct the better one
    assert speeds.update(31 / 30, 1 / 30, 12.0, 0.5, 2.0)[0] == pytest.approx(14.0, abs=0.4)


def test_first_speed_that_others_contradict_was_wrong():
    """40 m/s once, then 10 m/s: more measurements contradict the first one than agree with it."""
    late_mps = filtered([40.0, *[10.0] * 5], 1 / 30)[:, 0]
    assert np.abs(late_mps[3:] - 10.0).max() < 0.01


def in_camera(share_of_clouds, moved_m, seed=0):
    """`ImageMotion` of a scene in which a share of the points is too far to move."""
    rng = np.random.default_rng(seed)
    pixels = np.stack([rng.uniform(0, 620, 200), rng.uniform(0, 188, 200)], axis=1)
    rho = np.where(rng.uniform(size=200) < share_of_clouds, 1e-5, 1 / rng.uniform(5, 40, 200))
    rays = CAMERA.rays(pixels)
    now = rays + rho[:, None] * [0.0, 0.0, -moved_m]
    now = now / now[:, 2:] + 0.03 / 360 * rng.normal(size=(200, 3)) * [1.0, 1.0, 0.0]
    return ImageMotionEstimator(CAMERA)._motion(rays, now, 360.0, 0.1, 0.1)


def test_clouds_that_stay_in_place_are_no_rest():
    assert in_camera(0.7, 0.0).is_near_still
    moving = in_camera(0.7, 1.0)
    assert not moving.is_still
    assert np.isnan(moving.travel).all()  # the direction of few points is unsure
    assert np.isfinite(in_camera(0.2, 1.0).travel).all()
    distant = in_camera(1.0, 1.0)
    assert distant.is_still
    assert in_camera(1.0, 0.0).is_still


@pytest.mark.parametrize("yaw_deg", [-30.0, -58.0, 90.0, 120.0, 180.0])
@pytest.mark.parametrize("turn_rad", [-0.02, 0.0, 0.02])
def test_yaw_and_direction_of_a_camera_that_looks_aside(yaw_deg, turn_rad):
    """The car drives along its own axis and 0.03 rad to its right, which the fit shows."""
    mounting = Mounting(yaw_deg=yaw_deg)
    travel = np.array([math.sin(0.03), 0.0, math.cos(0.03)]) @ mounting.travel_from_camera
    rays, _, now = static_scene(RigidMotion(yawed(-turn_rad), -0.7 * travel))
    fit = epipolar_fit(rays, now, mounting)
    sigma = math.sqrt(fit.rotation_covariance[1, 1])
    assert sigma < 2e-3
    assert abs(-fit.rotation[1] - turn_rad) < 4 * sigma
    assert -fit.direction @ travel > math.cos(0.02)
    assert fit.is_static.mean() > 0.9


def test_springs_turn_the_path_of_a_slow_car():
    """0.04 m/s up is 0.004 rad at 10 m/s, and ten times as much at 1 m/s."""
    assert 0.004 * slow_factor(10.0) == pytest.approx(0.04 / 10.0)
    assert 0.004 * slow_factor(-1.0) == pytest.approx(0.04 / 1.0)
    assert slow_factor(30.0) == 1.0
    assert np.isfinite(slow_factor(0.0))


@pytest.mark.parametrize("offset_rad", [-0.008, 0.0, 0.008])
@pytest.mark.parametrize("speed_mps", [10.0, 30.0])
def test_horizon_error_from_strips(offset_rad, speed_mps):
    """A horizon that is too low lengthens the shifts of distant strips: s (1 + 2 Z d / h)."""
    height_m, shift_m = 1.65, speed_mps / 10
    z_m = np.arange(6.0, 14.0)
    shifts_m = shift_m * (1 + 2 * z_m * offset_rad / height_m)
    shifts_m[3] = math.nan
    error = plane_error(shift_m, np.zeros(8), z_m, shifts_m, height_m)
    assert error is not None
    assert error.horizon == pytest.approx(offset_rad, abs=1e-6)
    assert error.z_m == pytest.approx(np.delete(z_m, 3).mean())
    assert 0.001 < math.sqrt(error.variance) < 0.005
    assert math.isinf(error.roll_variance)


def test_horizon_and_roll_errors_from_two_lanes():
    """s (1 + (2 Z d - X r) / h), for strips of both signs of Z beside the car."""
    x_m, z_m = np.repeat([3.0, 4.5], 5), np.tile(np.arange(-3.0, 7.0, 2.0), 2)
    horizon, roll = 0.01, -0.02
    shifts_m = 1.2 * (1 + (2 * z_m * horizon - x_m * roll) / 2.0)
    error = plane_error(1.2, x_m, z_m, shifts_m, 2.0)
    assert error is not None
    assert error.roll == pytest.approx(roll, abs=1e-6)
    assert error.horizon - error.by_roll * error.roll == pytest.approx(horizon, abs=1e-6)
    assert error.x_m == pytest.approx(3.75)
    assert 0.005 < math.sqrt(error.roll_variance) < 0.02


def test_horizon_error_of_few_strips_is_unknown():
    shifts_m = np.array([1.0, 1.1, math.nan])
    assert plane_error(1.0, np.zeros(3), np.array([6.0, 8.0, 9.0]), shifts_m, 1.65) is None


def textured_pair(seed=0):
    rng = np.random.default_rng(seed)
    return rng.integers(0, 255, (188, 620, 3), np.uint8)


def test_pair_at_rest_is_still():
    rig = kitti_like_rig(width_px=620, height_px=188)
    odometry, motion = StereoOdometry(rig), None
    image = np.kron(textured_pair()[:47, :155], np.ones((4, 4, 1), np.uint8))
    right = np.roll(image, -12, axis=1)
    for k in range(4):
        motion = odometry.update(Frame(k, 0.1 * k, image, right), NO_BOXES)
    assert motion is not None
    assert motion.is_still
    assert abs(motion.speed_mps) < 0.05
    still = ImageMotionEstimator(rig.left)
    still.update(image, 0.0)
    assert still.update(image, 0.1).is_still


@pytest.mark.parametrize("content", ["black", "one colour", "noise"])
def test_damaged_frames_are_unknown(content):
    rig = kitti_like_rig(width_px=620, height_px=188)
    stereo, ground = StereoOdometry(rig), GroundOdometry(rig.left, 1.65)
    for k in range(4):
        images = [textured_pair(10 * k + side) for side in (0, 1)]
        if content != "noise":
            images = [np.full_like(image, 0 if content == "black" else 90) for image in images]
        frame = Frame(k, 0.1 * k, *images)
        for odometry in (stereo, ground):
            assert math.isnan(odometry.update(frame, NO_BOXES).speed_mps)


def test_time_gap_is_unknown():
    image, motion = textured_pair(), ImageMotionEstimator(CAMERA)
    motion.update(image, 0.0)
    assert not motion.update(image, 5.0).is_known


def test_frame_without_right_image_is_unknown():
    """So is the one after it, since a motion needs two pairs; the third one is measured again."""
    odometry = StereoOdometry(kitti_like_rig(width_px=620, height_px=188))
    left = textured_pair()
    right = np.roll(left, -12, axis=1)
    rights = [right, right, None, right, right]
    speeds_mps = [
        odometry.update(Frame(i, i / 10, left, image), NO_BOXES).speed_mps
        for i, image in enumerate(rights)
    ]
    assert np.isfinite(speeds_mps[1])
    assert np.isnan([speeds_mps[0], *speeds_mps[2:4]]).all()
    assert np.isfinite(speeds_mps[4])


@pytest.mark.slow
@pytest.mark.parametrize("scenario", ["town", "night", "crossing"])
def test_speed_of_rendered_drive(scenario):
    """Stereo within 3 % and 0.15 m/s, and neither worse nor better than its sigma."""
    scene, rig = make_scenario(scenario, seed=8, seconds=2.0), kitti_like_rig()
    renderer, stereo = Renderer(scene, rig), StereoOdometry(rig)
    errors = []
    for k in range(6):
        boxes = label_scene(scene, [k / 10], camera=rig.left).xyxy_px
        left, right = (renderer.render(k / 10, side=side) for side in ("left", "right"))
        motion = stereo.update(Frame(k, k / 10, left, right), boxes)
        if k > 0:
            error_mps, true_mps = (
                motion.speed_mps - scene.speed_mps(k / 10),
                scene.speed_mps(k / 10),
            )
            assert abs(error_mps) < 0.15 + 0.03 * true_mps
            errors.append(error_mps / motion.speed_sigma_mps)
    assert 0.001 < float(np.median(np.abs(errors))) < 2.5


@pytest.mark.slow
def test_yaw_rate_in_curve_with_lane_lines():
    """Corners on the lane lines of a curve stay in place in the image, which would hide a quarter
    of the yaw rate."""
    scene = make_scenario("city", seed=1, seconds=6)
    renderer = Renderer(scene, kitti_like_rig(width_px=620, height_px=188))
    motion, errors, yaw_rad_s = ImageMotionEstimator(renderer.rig.left), [], []
    for k in range(25, 55):
        boxes = label_scene(scene, [k / 10], camera=renderer.rig.left).xyxy_px
        measured = motion.update(renderer.render(k / 10), k / 10, boxes)
        if k > 30:
            yaw_rad_s.append((scene.pose(k / 10).yaw_rad - scene.pose((k - 1) / 10).yaw_rad) / 0.1)
            errors.append(measured.yaw_rad_s - yaw_rad_s[-1])
    assert np.mean(yaw_rad_s) > 0.01
    assert abs(np.mean(errors)) < 0.1 * np.mean(yaw_rad_s)
    assert np.percentile(np.abs(errors), 90) < 0.005


def test_expected_travel_moves_the_direction():
    motion = ImageMotionEstimator(CAMERA)
    motion.expect_travel(0.02, 0.05**2)
    row = motion._direction[1] / motion._direction[2]
    assert row == pytest.approx(0.01)  # equal variances: half-way
    assert motion._direction_variance == pytest.approx([0.05**2, 0.05**2 / 2])


@pytest.mark.slow
def test_horizon_of_a_rendered_drive_with_hills():
    """Within 2 px of the true horizon after 2 s, on average, with hills, pitch, and a camera that
    is pitched down."""
    scene = replace(make_scenario("highway", seed=40, seconds=4.0), camera_pitch_rad=-0.015)
    renderer = Renderer(scene, kitti_like_rig())
    camera, height_m = renderer.rig.left, scene.camera_height_m
    ground, errors_px, curvatures = GroundOdometry(camera, height_m), [], []
    for k in range(40):
        boxes = label_scene(scene, [0.1 * k], camera=camera).xyxy_px
        ground.update(Frame(k, 0.1 * k, renderer.render(0.1 * k), None), boxes)
        z = np.array(scene.ego_z_m(0.1 * k))
        climb_rad = float(scene.road.climb_rad(z))
        normal = scene.pose(0.1 * k).camera_from_world @ [
            0.0,
            math.cos(climb_rad),
            math.sin(climb_rad),
        ]
        errors_px.append(camera.fy_px * (ground.view.horizon + normal[2] / normal[1]))
        true = (scene.road.climb_rad(z + 1) - scene.road.climb_rad(z - 1)) / 2
        curvatures.append((ground.view.curvature_per_m, float(true)))
    assert ground.has_horizon
    assert np.abs(errors_px[20:]).mean() < 2.0
    measured, true = np.array(curvatures[30:]).T
    assert np.abs(measured - true).mean() < 2e-4


def test_points_that_the_camera_has_passed_are_not_static():
    """A step of 100 m takes all points, at up to 60 m, behind the camera, where their errors are
    limited."""
    rays, rho, _ = static_scene(RigidMotion(np.eye(3), np.array([0.0, 0.0, -1.0])))
    passed = RigidMotion(np.eye(3), np.array([0.0, 0.0, -100.0]))
    now = passed.moved(rays, rho)
    now[:, 2] = np.maximum(now[:, 2], 0.05)  # as the fit limits them
    assert fitted(rays, rho, now / now[:, 2:]).is_static.mean() < 0.1


def test_first_speed_of_a_large_step_needs_a_second_one():
    speeds = SpeedFilter()
    assert math.isnan(speeds.update(0.2, 0.2, 50.0, 0.5, 0.0)[0])  # 10 m between two frames
    assert speeds.update(0.4, 0.2, 50.0, 0.5, 0.0)[0] == pytest.approx(50.0)
    speeds = SpeedFilter()
    assert math.isnan(speeds.update(0.2, 0.2, 50.0, 0.5, 0.0)[0])
    assert math.isnan(speeds.update(0.4, 0.2, 20.0, 0.5, 0.0)[0])


def test_errors_that_many_points_share_widen_the_offset():
    """A shift of a part of the image, as by a rolling shutter, is no noise of single points."""
    motion = RigidMotion(yawed(0.004), np.array([0.01, 0.0, -1.0]))
    rays, rho, now = static_scene(motion)
    shifted = now.copy()
    shifted[:, 0] += 3 * NOISE * np.sign(np.sin(12 * rays[:, 1]) * rays[:, 0])
    assert fitted(rays, rho, shifted).offset[1] > 1.3 * fitted(rays, rho, now).offset[1]


def test_speeds_that_scatter_more_than_their_sigma_have_a_wider_one():
    rng = np.random.default_rng(0)
    errors_mps, calm, shaken = 0.2 * rng.normal(size=200), SpeedFilter(), SpeedFilter()
    speeds_mps = np.array(
        [shaken.update(k / 10, 0.1, 10 + error, 0.03, 0.0) for k, error in enumerate(errors_mps)]
    )
    calm_mps = np.array([calm.update(k / 10, 0.1, 10.0, 0.03, 0.0) for k in range(100)])
    late_mps, sigma_mps = speeds_mps[20:].T
    assert (np.abs(late_mps - 10) < 2 * sigma_mps).mean() > 0.8
    assert 0.12 < np.median(sigma_mps) < 0.3
    assert calm_mps[-1, 1] < 0.5 * np.median(sigma_mps)


@pytest.mark.parametrize(
    ("speed_mps", "frame_s", "interval_s"),
    [
        (18.0, 0.04, 0.06),  # 1.44 m between two of every second frame
        (18.0, 0.05, 0.0),  # 1.8 m
        (30.0, 0.04, 0.0),
        (30.0, 1 / 60, 0.0),
        (20.0, 1 / 60, 0.06),
        (math.nan, 0.04, 0.0),
        (5.0, math.nan, 0.0),
    ],
)
def test_frames_are_compared_less_often_while_the_road_between_them_is_short(
    speed_mps, frame_s, interval_s
):
    assert _interval_s(speed_mps, frame_s) == interval_s
