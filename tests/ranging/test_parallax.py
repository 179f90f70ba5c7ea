"""Parallax on pictures of textured boards that stand at known distances while the camera drives
past them."""

import numpy as np
import pytest

from track_range.detection.classes import ROAD_CLASSES
from track_range.foundation.sparse_flow import BackgroundFlow
from track_range.ranging.measurement.ranges import Ranges
from track_range.ranging.methods.size_regression import SizeRanger
from track_range.ranging.size_models.drive_scale import DriveScale
from track_range.ranging.world.parallax import Parallax
from track_range.stereo.geometry.camera import PinholeCamera
from track_range.stereo.geometry.frames import Frame
from track_range.stereo.geometry.mounting import Mounting
from track_range.stereo.odometry.ego_motion import CameraStep
from track_range.tracking.tracks import Tracks

CAMERA = PinholeCamera(500.0, 500.0, 320.0, 120.0, 640, 240)
CAR, PERSON = (ROAD_CLASSES.index(name) for name in ("car", "person"))
WAY_M, DT_S, N_FRAMES = 1.0, 0.1, 8
FACES = np.random.default_rng(5).uniform(30, 220, (2, 12, 20))
"""Grey levels of the patches of each board."""


SIDES_M = np.array([-5.0, 6.0])


def boards_at(distances_m, sides_m=SIDES_M, half_m=(1.9, 0.75)):
    """(N, 4) boxes of boards 3.8 x 1.5 m."""
    boxes = []
    for distance_m, side_m in zip(distances_m, sides_m, strict=True):
        x = 320 + 500 * (side_m + np.array([-1, 1]) * half_m[0]) / distance_m
        y = 120 + 500 * (0.9 + np.array([-1, 1]) * half_m[1]) / distance_m
        boxes.append([x[0], y[0], x[1], y[1]])
    return np.array(boxes)


def picture(distances_m, sides_m=SIDES_M):
    image = np.full((240, 640), 128.0)
    column, row = np.meshgrid(np.arange(640), np.arange(240))
    for face, (x1, y1, x2, y2) in zip(FACES, boards_at(distances_m, sides_m), strict=True):
        u, v = (column - x1) / (x2 - x1) * 19, (row - y1) / (y2 - y1) * 11
        inside = (u >= 0) & (u <= 19) & (v >= 0) & (v <= 11)
        u0, v0 = (
            np.clip(np.floor(part).astype(int), 0, size - 2) for part, size in ((u, 20), (v, 12))
        )
        a, b = u - u0, v - v0
        smooth = (face[v0, u0] * (1 - a) + face[v0, u0 + 1] * a) * (1 - b)
        smooth += (face[v0 + 1, u0] * (1 - a) + face[v0 + 1, u0 + 1] * a) * b
        image = np.where(inside, smooth, image)
    return image.astype(np.uint8)


def driven(
    speeds_mps=(0.0, 0.0),
    *,
    class_id=CAR,
    size_error=0.0,
    sigma=0.08,
    travelled_m=WAY_M,
    starts_m=(32.0, 28.0),
    travel=(0.0, 0.0, 1.0),
    n_repeated=0,
):
    """Ranges after some frames, and the true distances; the objects move with `speeds_mps` away
    from the camera, which drives in the direction `travel`."""
    parallax, flow = Parallax(CAMERA), BackgroundFlow()
    distances_m, ids = np.array(starts_m), np.array([1, 2])
    sides_m, travel = SIDES_M, np.array(travel)
    for k in range(N_FRAMES):
        boxes = boards_at(distances_m, sides_m)
        flow.add(picture(distances_m, sides_m), boxes, DT_S * k)
        tracks = Tracks(ids, boxes, np.full(2, class_id), np.ones(2), np.ones(2, bool))
        step = CameraStep(
            time_s=DT_S * k,
            dt_s=DT_S,
            rotation=np.eye(3),
            rotation_sigma_rad=1e-4,
            travel=travel,
            travelled_m=travelled_m,
            travelled_sigma=0.02,
            now=flow.now,
        )
        other_m = distances_m * (1 + size_error)
        other = Ranges(ids, other_m, sigma * other_m)
        ranges = parallax.measure(tracks, step if k else None, other)
        for _ in range(n_repeated if k else 0):
            assert np.isnan(parallax.measure(tracks, step, other).distance_m).all()
        true_m = distances_m
        distances_m = distances_m - WAY_M * travel[2] + DT_S * np.array(speeds_mps)
        sides_m = sides_m - WAY_M * travel[0]
    return ranges, true_m


@pytest.mark.parametrize("size_error", [-0.12, 0.0, 0.12])
def test_distances_of_parked_cars(size_error):
    """Growth 1 m / Z: within 3 %, whatever the distances by size."""
    ranges, true_m = driven(size_error=size_error)
    assert ranges.distance_m == pytest.approx(true_m, rel=0.03)
    assert (ranges.sigma_m / ranges.distance_m < 0.06).all()


@pytest.mark.parametrize("yaw_deg", [-58.0, 90.0, 180.0])
def test_distances_from_a_camera_that_looks_aside(yaw_deg):
    travel = Mounting(yaw_deg=yaw_deg).travel_from_camera[2]
    ranges, true_m = driven(travel=travel)
    assert ranges.distance_m == pytest.approx(true_m, rel=0.03)


def test_frames_after_a_step_measure_nothing_and_lose_nothing():
    ranges, true_m = driven(n_repeated=2)
    np.testing.assert_array_equal(ranges.distance_m, driven()[0].distance_m)
    assert ranges.distance_m == pytest.approx(true_m, rel=0.03)


def test_error_of_the_way_is_an_error_of_the_distance():
    ranges, true_m = driven(travelled_m=1.1 * WAY_M)
    assert ranges.distance_m == pytest.approx(1.1 * true_m, rel=0.03)


@pytest.mark.parametrize("speed_mps", [-9.0, 5.0, 10.0])
def test_moving_cars_are_unknown(speed_mps):
    ranges, _ = driven((speed_mps, 0.0))
    assert np.isfinite(ranges.distance_m).tolist() == [False, True]


def test_people_are_unknown():
    ranges, _ = driven(class_id=PERSON)
    assert np.isnan(ranges.distance_m).all()


def test_without_motion_everything_is_unknown():
    parallax, flow = Parallax(CAMERA), BackgroundFlow()
    boxes, ids = boards_at((30.0, 25.0)), np.array([1, 2])
    flow.add(picture((30.0, 25.0)), boxes, 0.0)
    tracks = Tracks(ids, boxes, np.full(2, CAR), np.ones(2), np.ones(2, bool))
    assert np.isnan(parallax.measure(tracks, None, Ranges.unmeasured(ids)).distance_m).all()


def test_a_frame_between_two_that_are_compared_is_no_evidence():
    """Its step is that of an earlier frame, by which nothing is triangulated."""
    flow, boxes = BackgroundFlow(), boards_at(np.array([32.0, 28.0]), SIDES_M)
    flow.add(picture(np.array([32.0, 28.0]), SIDES_M), boxes, 0.0)
    step = CameraStep(
        time_s=0.0,
        dt_s=DT_S,
        rotation=np.eye(3),
        rotation_sigma_rad=1e-4,
        travel=np.array([0.0, 0.0, 1.0]),
        travelled_m=WAY_M,
        travelled_sigma=0.02,
        now=flow.now,
    )
    ranger = SizeRanger(CAMERA, parallax=Parallax(CAMERA))
    tracks = Tracks(np.array([1, 2]), boxes, np.full(2, CAR), np.ones(2), np.ones(2, bool))
    image = np.zeros((CAMERA.height_px, CAMERA.width_px, 3), np.uint8)
    references = []
    for time_s in (0.0, 0.04):
        ranger.update_motion(step)
        measured = ranger.measure_at_scale(tracks, Frame(0, time_s, image, None), {}, DriveScale())
        references.append(measured.evidence.reference is not None)
    assert references == [True, False]
