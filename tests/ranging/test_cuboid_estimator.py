"""Sizes and headings of made-up cuboids on the road, whose boxes are projected exactly."""

import math

import numpy as np
import pytest

import track_range as tr
from track_range.detection.classes import ROAD_CLASSES
from track_range.ranging.measurement.ranges import Ranges
from track_range.ranging.size_models.class_sizes import ClassSizes
from track_range.ranging.size_models.curve import load_curves
from track_range.ranging.size_models.size_model import BoxTraits
from track_range.ranging.world.cuboid_estimator import CuboidEstimator
from track_range.ranging.world.ego_path import EgoPose
from track_range.ranging.world.object_motion import GroundVelocity

CAMERA = tr.PinholeCamera(700.0, 700.0, 640.0, 200.0, 1280, 400)
HEIGHT_M, STEP_S, REST = 1.5, 0.1, (0.0, 0.0)
CAR, PERSON = ROAD_CLASSES.index("car"), ROAD_CLASSES.index("person")


def corners_m(xz_m, yaw_deg, lw_m):
    """(N, 4, 2) right and forward of the corners of footprints; `xz_m` (N, 2), `yaw_deg` (N,)."""
    yaw, (length, width) = np.radians(yaw_deg)[:, None], np.transpose(lw_m)[:, :, None]
    along = length / 2 * np.array([1, 1, -1, -1])
    left = width / 2 * np.array([1, -1, -1, 1])
    right = -along * np.sin(yaw) - left * np.cos(yaw)
    return xz_m[:, None] + np.stack([right, along * np.cos(yaw) - left * np.sin(yaw)], axis=2)


def seen(xz_m, yaw_deg, lwh_m):
    """Boxes (N, 4) in px of cuboids, and the distances (N,) that their visible middles show."""
    corners = corners_m(xz_m, yaw_deg, lwh_m[:, :2])
    column = corners[..., 0] / corners[..., 1]
    ends = np.array([-640.0, 639.0]) / 700.0  # of the image
    low, high = (np.clip(edge(axis=1), *ends) for edge in (column.min, column.max))
    near = corners[..., 1].min(axis=1)
    top = (HEIGHT_M - lwh_m[:, 2]) / near
    box = np.column_stack([low, top, high, HEIGHT_M / near])
    middle = (low + high) / 2
    a, b = corners, np.roll(corners, -1, axis=1)
    d = b - a
    along = d[..., 0] - middle[:, None] * d[..., 1]
    along = np.where(np.abs(along) < 1e-9, 1e-9, along)
    t = (middle[:, None] * a[..., 1] - a[..., 0]) / along
    z = np.where((t >= 0) & (t <= 1), a[..., 1] + t * d[..., 1], np.inf).min(axis=1)
    return 700.0 * box + np.array([640.0, 200.0, 640.0, 200.0]), z


class Scene:
    """N objects of one class before a camera that drives, and their estimated cuboids."""

    def __init__(self, lwh_m, *, class_id=CAR, seed=0, noise_px=0.5, scale_sigma=0.02):
        self.lwh_m = np.atleast_2d(np.asarray(lwh_m, np.float64))
        self.n = len(self.lwh_m)
        self.class_id, self.noise_px, self.scale_sigma = class_id, noise_px, scale_sigma
        self.random = np.random.default_rng(seed)
        self.scale = np.exp(scale_sigma * self.random.standard_normal(self.n))
        self.estimator = CuboidEstimator(
            tr.Mounting(z_m=HEIGHT_M), ClassSizes.of(load_curves()), BoxTraits.of(1280)
        )
        self.time_s = 0.0

    def step(self, xz_m, yaw_deg, velocity=REST, heading_deg=0.0, observed=True):
        """The cuboids after the next frame; positions, yaws and velocities (along, right) are in
        the camera's axes."""
        xz_m = np.broadcast_to(np.asarray(xz_m, np.float64), (self.n, 2))
        box, z = seen(xz_m, np.broadcast_to(yaw_deg, self.n), self.lwh_m)
        box = box + self.noise_px * self.random.standard_normal(box.shape)
        box = np.clip(box, 0.0, [1279.0, 399.0, 1279.0, 399.0])
        ids = np.arange(self.n)
        tracks = tr.Tracks(
            ids, box, np.full(self.n, self.class_id), np.ones(self.n), np.full(self.n, observed)
        )
        along, right = (np.broadcast_to(np.float64(part), self.n) for part in velocity)
        variance = np.full(self.n, 0.09)
        pose = EgoPose(0.0, 0.0, math.radians(heading_deg), 1e-4 * np.eye(3))
        self.time_s += STEP_S
        return self.estimator.update(
            tracks,
            CAMERA,
            Ranges(ids, self.scale * z, self.scale_sigma * z),
            GroundVelocity(along, right, variance, variance),
            pose,
            self.time_s,
        )


def apart_deg(a, b, period=180.0):
    return np.abs((np.asarray(a) - b + period / 2) % period - period / 2)


def test_a_parked_car_shows_its_yaw_and_length_while_the_camera_passes():
    for yaw_deg in (0.0, 90.0, 30.0, -60.0):
        scene = Scene([4.6, 1.75, 1.5])
        for z in np.arange(35.0, 9.0, -1.0):
            cuboids = scene.step([4.0, z], yaw_deg)
        off_deg = apart_deg(cuboids.yaw_deg[0], yaw_deg)
        assert off_deg < min(9.0, 2.5 * cuboids.yaw_sigma_deg[0]), yaw_deg
        assert not cuboids.front_known[0]
        np.testing.assert_allclose(cuboids.lwh_m[0], scene.lwh_m[0], rtol=0.1)
        error_m = cuboids.centre_m[0, ::2] - [4.0, 10.0]
        assert np.hypot(*error_m) < 0.4
        assert (np.abs(error_m) < 3 * cuboids.centre_sigma_m[0, ::2]).all()


def test_the_course_tells_the_front_and_an_object_that_stops_keeps_it():
    scene = Scene([4.2, 1.7, 1.5])
    for _ in range(20):  # crossing to the left, 20 m ahead
        cuboids = scene.step([0.0, 20.0], 90.0, velocity=(0.0, -6.0))
    assert cuboids.front_known[0]
    assert cuboids.yaw_deg[0] == pytest.approx(90.0, abs=3.0)
    moving_sigma_deg = cuboids.yaw_sigma_deg[0]
    for turn_deg in np.linspace(0.0, 40.0, 20):  # it stops, and the camera turns to the left
        cuboids = scene.step([0.0, 20.0], 90.0 - turn_deg, heading_deg=turn_deg)
    assert cuboids.front_known[0]
    assert cuboids.yaw_deg[0] == pytest.approx(50.0, abs=5.0)
    assert moving_sigma_deg < 6.0


def test_an_oncoming_car_has_its_front_towards_the_camera():
    scene = Scene([4.2, 1.7, 1.5])
    for z in np.arange(50.0, 20.0, -1.5):
        cuboids = scene.step([-3.0, z], 180.0, velocity=(-8.0, 0.0))
    assert cuboids.front_known[0]
    assert apart_deg(cuboids.yaw_deg[0], 180.0, 360.0) < 3.0


def test_a_person_has_the_direction_of_the_walk_only():
    scene = Scene([0.7, 0.6, 1.7], class_id=PERSON)
    first = scene.step([2.0, 12.0], 90.0)
    assert first.yaw_sigma_deg[0] > 40.0
    for _ in range(15):
        cuboids = scene.step([2.0, 12.0], 90.0, velocity=(0.0, -1.4))
    assert cuboids.yaw_deg[0] == pytest.approx(90.0, abs=12.0)


def test_a_cut_box_shows_no_shorter_car():
    whole, cut = Scene([4.4, 1.7, 1.5], noise_px=0.0), Scene([4.4, 1.7, 1.5], noise_px=0.0)
    for scene in (whole, cut):
        for z in np.arange(25.0, 8.0, -1.0):
            cuboids = scene.step([4.0, z], 0.0)
    before_m = cuboids.lwh_m[0].copy()
    for z in (6.0, 5.0, 4.5, 4.5):  # the right and the bottom border cut it
        cuboids = cut.step([4.0, z], 0.0)
    np.testing.assert_allclose(cuboids.lwh_m[0], before_m, rtol=0.06)
    assert cuboids.centre_m[0, 0] == pytest.approx(4.0, abs=0.4)
    assert cuboids.centre_m[0, 1] == pytest.approx(HEIGHT_M - 0.75, abs=0.15)  # by the top edge


def test_a_cut_box_leaves_the_yaw_open():
    scene = Scene([4.4, 1.7, 1.5])
    for z in np.arange(4.5, 6.5, 0.1):  # overtakes, close to the camera; the right border cuts it
        cuboids = scene.step([3.3, z], 0.0)
    assert apart_deg(cuboids.yaw_deg[0], 0.0) < 5.0
    assert cuboids.yaw_sigma_deg[0] > 20.0


def test_a_predicted_box_teaches_nothing():
    scene = Scene([4.2, 1.7, 1.5])
    for _ in range(5):
        before = scene.step([0.0, 20.0], 0.0)
    after = scene.step([0.0, 20.0], 90.0, observed=False)
    np.testing.assert_allclose(after.lwh_m, before.lwh_m, rtol=0.01)
    assert apart_deg(after.yaw_deg[0], before.yaw_deg[0]) < 2.0


def test_sigmas_hold_over_draws_of_the_prior():
    random, n = np.random.default_rng(5), 150
    sizes = ClassSizes.of(load_curves())
    log_hwl = random.multivariate_normal(sizes.log_hwl[CAR], sizes.covariance[CAR], n)
    scene = Scene(np.exp(log_hwl)[:, ::-1], seed=6, noise_px=1.0, scale_sigma=0.03)
    yaw_deg = np.where(random.uniform(size=n) < 0.5, 5 * random.standard_normal(n), 90.0)
    x_m = random.uniform(3.0, 8.0, n)
    for z in np.arange(30.0, 14.0, -1.0):
        cuboids = scene.step(np.column_stack([x_m, np.full(n, z)]), yaw_deg)
    off = apart_deg(cuboids.yaw_deg, yaw_deg) / cuboids.yaw_sigma_deg
    assert 0.88 < np.mean(off < 2) <= 1.0
    assert np.median(apart_deg(cuboids.yaw_deg, yaw_deg)) < 6.0
    size = np.abs(cuboids.lwh_m - scene.lwh_m) / cuboids.lwh_sigma_m
    assert ((size < 2).mean(axis=0) > 0.88).all()
    assert ((size < 1).mean(axis=0) < 0.95).all()
    apart_m = cuboids.centre_m[:, ::2] - np.column_stack([x_m, np.full(n, 15.0)])
    C = cuboids.covariance_m2[:, ::2, ::2]
    chi2 = np.einsum("ni,nij,nj->n", apart_m, np.linalg.inv(C), apart_m)
    assert 0.9 < np.mean(chi2 < 6.0) <= 1.0


def test_tracks_without_a_distance_or_a_size_are_unknown():
    scene = Scene([[4.2, 1.7, 1.5]] * 2)
    scene.scale = np.array([1.0, np.nan])
    cuboids = scene.step([0.0, 20.0], 0.0)
    assert np.isfinite(cuboids.lwh_m[0]).all()
    assert np.isnan(cuboids.lwh_m[1]).all()
    assert np.isnan(cuboids.centre_m[1]).all()
    nothing = CuboidEstimator()
    nothing_seen = nothing.update(
        tr.Tracks.empty(),
        CAMERA,
        Ranges(*np.zeros((3, 0))),
        GroundVelocity(*np.zeros((4, 0))),
        EgoPose(),
        0.0,
    )
    assert nothing_seen.lwh_m.shape == (0, 3)
