"""Lateral motion of objects that pass, cross or are hit: positions by hand, projected by an exact
camera."""

from __future__ import annotations

from dataclasses import replace
from typing import NamedTuple

import numpy as np
import pytest

from track_range.foundation.arrays import FloatArray
from track_range.foundation.constant_velocity import ConstantVelocity
from track_range.ranging.filtering.lateral_motion import LateralFilters
from track_range.stereo.geometry.camera import PinholeCamera
from track_range.stereo.geometry.mounting import Mounting
from track_range.tracking.tracks import Tracks

CAMERA = PinholeCamera(700.0, 700.0, 620.0, 187.0, 1241, 374)
STEP_S = 0.1


class Offsets(NamedTuple):
    """Where objects pass the camera at their lateral speeds, (N,) each."""

    lateral_offset_m: FloatArray
    sigma_m: FloatArray
    half_width_m: FloatArray


class Course:
    """Lateral filters with the offsets that follow from their states."""

    def __init__(self, camera: PinholeCamera) -> None:
        self._filters = LateralFilters(camera)

    def update(
        self, boxes: Tracks, distance_m: FloatArray, ttc_s: FloatArray, time_s: float
    ) -> Offsets:
        motion, T = self._filters.update(boxes, distance_m, time_s), ttc_s
        x = motion.state
        variance = x.P_xx + T * (2 * x.P_xv + T * x.P_vv)
        return Offsets(x.x + T * x.v, np.sqrt(variance), motion.half_width_m)


def box(x_m: float, z_m: float, width_m: float) -> list[float]:
    """Box of an object of 1.5 m height with its front at (x, z)."""
    left, right = (620.0 + 700.0 * (x_m + side * width_m / 2) / z_m for side in (-1, 1))
    return [left, 187.0, right, 187.0 + 700.0 * 1.5 / z_m]


def tracks(boxes: list[list[float]], *, observed: bool = True, first_id: int = 1) -> Tracks:
    n = len(boxes)
    ids = np.arange(first_id, first_id + n)
    return Tracks(
        ids, np.array(boxes).reshape(-1, 4), np.full(n, 2), np.ones(n), np.full(n, observed)
    )


def drive(
    course: Course,
    start_m: tuple[float, float],
    speed_mps: tuple[float, float],
    *,
    n: int = 10,
    width_m: float = 1.8,
    noise_px: float = 0.0,
) -> Offsets:
    """Offsets after n frames of one object with a start (x, z) and a velocity."""
    rng = np.random.default_rng(7)
    offsets = None
    for number in range(n):
        x_m, z_m = (
            start + number * STEP_S * rate for start, rate in zip(start_m, speed_mps, strict=True)
        )
        seen = (
            np.array([box(x_m, z_m, width_m)]) + rng.normal(0, noise_px, (1, 4))
            if noise_px
            else [box(x_m, z_m, width_m)]
        )
        offsets = course.update(
            tracks([list(seen[0])]),
            np.array([z_m]),
            np.array([-z_m / speed_mps[1]]),
            number * STEP_S,
        )
    assert offsets is not None
    return offsets


@pytest.mark.parametrize(
    ("start_m", "speed_mps", "offset_m"),
    [
        ((0.0, 40.0), (0.0, -20.0), 0.0),  # ahead in the ego lane
        ((-3.5, 40.0), (0.0, -20.0), -3.5),  # oncoming in the neighbouring lane
        ((3.0, 30.0), (-1.5, -15.0), 0.0),  # steps off the kerb: constant bearing
        ((-5.0, 30.0), (8.0, -10.0), 19.9),  # crosses before the ego vehicle arrives
        ((3.5, 25.0), (-1.4, -10.0), 0.0),  # cuts into the ego lane
    ],
)
def test_lateral_offset_of_moving_objects(
    start_m: tuple[float, float], speed_mps: tuple[float, float], offset_m: float
) -> None:
    offsets = drive(Course(CAMERA), start_m, speed_mps)
    assert offsets.lateral_offset_m[0] == pytest.approx(offset_m, abs=0.3)
    # a car beside the path may show its side
    assert 0.75 - 1e-9 <= offsets.half_width_m[0] <= 0.9 + 1e-9


def test_first_frame_by_hand() -> None:
    """After one frame the rate is 0 +- 5 m/s: 2 s ahead that is 10 m.

    The inner edge may be at the far end of a car, so the car may be as narrow as 1.5 m, its centre
    0.15 m farther out.
    """
    offsets = Course(CAMERA).update(
        tracks([box(3.5, 20.0, 1.8)]), np.array([20.0]), np.array([2.0]), 0.0
    )
    assert offsets.lateral_offset_m[0] == pytest.approx(3.65)
    edge_m = (1.0 + 0.02 * 700 * 1.8 / 20) * 20 / 700
    assert offsets.sigma_m[0] == pytest.approx(np.sqrt(edge_m**2 + (2.0 * 5.0) ** 2))


def test_offset_error_within_sigma() -> None:
    offsets = drive(Course(CAMERA), (-3.5, 45.0), (0.0, -20.0), n=14, noise_px=1.0)
    assert abs(offsets.lateral_offset_m[0] + 3.5) < 2 * offsets.sigma_m[0]
    assert 0.3 < offsets.sigma_m[0] < 2.0


def test_unknown_without_ttc_or_distance() -> None:
    course = Course(CAMERA)
    boxes = [box(-3.5, 20.0, 1.8), box(3.5, 20.0, 1.8)]
    offsets = course.update(
        tracks(boxes), np.array([20.0, np.nan]), np.array([np.nan, np.nan]), 0.0
    )
    assert np.isnan(offsets.lateral_offset_m).all()


def test_box_cut_by_the_border_is_not_a_measurement() -> None:
    """The visible centre of a passing car stays at the border: only measurements before it was cut
    are used."""
    course, n = Course(CAMERA), 0
    offsets = drive(course, (-4.0, 14.0), (0.0, -8.0), n=12)
    for number in range(12, 16):
        z_m = 14.0 - 8.0 * STEP_S * number
        cut = np.maximum(box(-4.0, z_m, 1.8), 0.0)
        n += int(cut[0] == 0.0)
        offsets = course.update(
            tracks([cut.tolist()]), np.array([z_m]), np.array([z_m / 8.0]), number * STEP_S
        )
        assert offsets.lateral_offset_m[0] == pytest.approx(-4.0, abs=0.3)
    assert n == 4


def test_a_box_that_stays_cut_is_not_current() -> None:
    """Its lateral speed is that from before; 0.3 s after the last whole box it no longer counts."""
    filters, current = LateralFilters(CAMERA), []
    for number in range(16):
        z_m = 14.0 - 8.0 * STEP_S * number
        cut = np.maximum(box(-4.0, z_m, 1.8), 0.0)
        motion = filters.update(tracks([cut.tolist()]), np.array([z_m]), number * STEP_S)
        current.append(bool(motion.is_current[0]))
        assert motion.state.x[0] == pytest.approx(-4.0, abs=0.3)
    n_whole = sum(current) - 3
    assert 8 <= n_whole <= 12
    assert current == [True] * (n_whole + 3) + [False] * (13 - n_whole)


def test_a_box_that_was_cut_stays_cut_until_it_ends_well_inside() -> None:
    """A truck beside us: the detector ends its box, 300 px high, up to 100 px before the border, as
    if it came towards our path; a box 130 px from it is whole."""
    filters, found = LateralFilters(CAMERA), []
    for number, right_px in enumerate([1100.0] * 3 + [1240.0] * 3 + [1140.0] * 3 + [1110.0] * 2):
        boxes = tracks([[740.0, 20.0, right_px, 320.0]])
        motion = filters.update(boxes, np.array([6.0]), number * STEP_S)
        found.append((bool(motion.is_cut[0]), round(float(motion.state.x[0]), 1)))
    is_cut, x_m = zip(*found, strict=True)
    assert is_cut == (False,) * 3 + (True,) * 6 + (False,) * 2
    assert len(set(x_m[2:9])) == 1


def test_jump_restarts_the_filter() -> None:
    course = Course(CAMERA)
    drive(course, (-6.0, 40.0), (0.0, -10.0))
    seen = [
        course.update(
            tracks([box(0.5, 30.0, 1.8)]), np.array([30.0]), np.array([3.0]), 1.0 + STEP_S * number
        )
        for number in range(3)
    ]
    assert seen[0].lateral_offset_m[0] == pytest.approx(-6.0, abs=0.5)  # one outlier is ignored
    assert seen[2].lateral_offset_m[0] == pytest.approx(0.5)
    assert seen[2].sigma_m[0] > 10.0


def test_predicted_boxes_and_long_gaps() -> None:
    course = Course(CAMERA)
    sure = drive(course, (-3.5, 40.0), (0.0, -10.0))
    far: FloatArray = np.array([30.0])
    wrong = tracks([box(5.0, 30.0, 1.8)], observed=False)
    carried = course.update(wrong, far, far / 10, 1.0)
    assert carried.lateral_offset_m[0] == pytest.approx(sure.lateral_offset_m[0], abs=0.1)
    assert carried.sigma_m[0] > 0
    course.update(tracks([], first_id=2), np.zeros(0), np.zeros(0), 1.5)
    assert np.isnan(course.update(wrong, far, far / 10, 2.1).lateral_offset_m[0])


def test_no_tracks() -> None:
    offsets = Course(CAMERA).update(tracks([]), np.zeros(0), np.zeros(0), 0.0)
    assert len(offsets.lateral_offset_m) == 0


def test_object_at_rest_beside_a_camera_that_moves_across_its_axis() -> None:
    """The camera moves to its right by 8 m/s, so that the object moves to the left in its frame."""
    filters, over_ground, still = LateralFilters(CAMERA), [], LateralFilters(CAMERA)
    for number in range(8):
        seen = tracks([box(4.0 - 0.8 * number, 20.0, 1.8)])
        time_s, distance_m = number * STEP_S, np.array([20.0])
        motion = filters.update(seen, distance_m, time_s, right_mps=8.0)
        over_ground.append(motion.state.v[0])
        relative = still.update(seen, distance_m, time_s, right_mps=np.nan)
    assert np.abs(over_ground).max() < 0.5  # the inner edge may be at the far end of a car
    assert relative.state.v[0] == pytest.approx(-8.0, abs=1.5)


def parked_car(mounting: Mounting, centre_m: FloatArray) -> tuple[list[float], float]:
    """Box of a car of 4.2 x 1.8 m, parallel to the drive, with its centre at (x, z), in the image;
    and the depth at which the ray through its middle enters the car.
    """
    half_m = np.array([2.1, 0.9, 1.0])
    corners = half_m * [[1, 1, 0], [1, -1, 0], [-1, 1, 0], [-1, -1, 0]]
    x_m, _, z_m = (corners @ mounting.vehicle_from_camera).T
    x_px = 620.0 + 700.0 * (x_m + centre_m[0]) / (z_m + centre_m[1])
    left_px, right_px = np.clip([x_px.min(), x_px.max()], 0.0, 1240.0).tolist()
    depth_m = np.linspace(0.5, 30.0, 30_000)
    ray = np.array([((left_px + right_px) / 2 - 620.0) / 700.0, 0.0, 1.0])
    points = ray * depth_m[:, None] - [centre_m[0], 0.0, centre_m[1]]
    is_inside = (np.abs(points @ mounting.vehicle_from_camera.T) < half_m).all(axis=1)
    return [left_px, 187.0, right_px, 187.0 + 700.0 / centre_m[1]], float(depth_m[is_inside][0])


@pytest.mark.parametrize("yaw_deg", [-58.0, 90.0, 120.0])
def test_parked_car_beside_a_camera_that_looks_aside(yaw_deg: float) -> None:
    """A vehicle passes a parked car at 8 m/s: the car rests over ground, also where the border of
    the image cuts it.
    """
    mounting, n_cut = Mounting(yaw_deg=yaw_deg), 0
    velocity_mps = mounting.velocity_mps(8.0)
    filters = LateralFilters(CAMERA, mounting)
    for number in range(-9, 10):
        centre_m = np.array([1.0, 9.0]) - velocity_mps[[0, 2]] * number * STEP_S
        if centre_m[1] < 5.0 or abs(centre_m[0]) > 0.8 * centre_m[1]:
            continue
        seen, depth_m = parked_car(mounting, centre_m)
        motion = filters.update(
            tracks([seen]), np.array([depth_m]), number * STEP_S, right_mps=velocity_mps[0]
        )
        n_cut += seen[0] == 0.0 or seen[2] == 1240.0
        assert abs(motion.state.v[0]) < 0.7
        assert abs(motion.state.x[0] - centre_m[0]) < 0.3
    assert n_cut >= 2


def crossing(time_s: float) -> tuple[Tracks, float]:
    """Box and distance of a person who crosses at 1.5 m/s, 30 m ahead of a car at 10 m/s."""
    z_m = 30.0 - 10.0 * time_s
    seen = tracks([box(4.0 - 1.5 * time_s, z_m, 0.6)])
    return replace(seen, class_id=np.zeros(1, np.int64)), z_m


def distance_of(z_m: float, *, rate_sigma_mps: float = 0.5) -> ConstantVelocity:
    return ConstantVelocity(
        *(np.array([value]) for value in (z_m, -10.0, 0.01, 0.0, rate_sigma_mps**2))
    )


def confirmed_after(
    filters: LateralFilters, n: int, *, rate_sigma_mps: float = 0.5, gap_s: float = STEP_S
) -> ConstantVelocity:
    """State of the person when the track is confirmed, `gap_s` after n boxes without a distance."""
    for number in range(n):
        filters.remember(
            crossing(number * STEP_S)[0], number * STEP_S, yaw_rad_s=0.0, right_mps=0.0
        )
    time_s = (n - 1) * STEP_S + gap_s
    seen, z_m = crossing(time_s)
    filters.start(seen, distance_of(z_m, rate_sigma_mps=rate_sigma_mps), time_s)
    return filters.update(seen, np.array([z_m]), time_s).state


def test_boxes_before_the_confirmation_show_the_lateral_speed() -> None:
    """A box each 0.1 s with 1.3 px of noise, 0.055 m: after n boxes and a distance."""
    new = confirmed_after(LateralFilters(CAMERA), 0, gap_s=STEP_S)
    assert (new.v[0], new.P_vv[0]) == (0.0, 25.0)
    sigma_mps = []
    for n in (1, 3, 6):
        state = confirmed_after(LateralFilters(CAMERA), n, rate_sigma_mps=0.0)
        assert state.v[0] == pytest.approx(-1.5, abs=0.1)
        sigma_mps.append(np.sqrt(state.P_vv[0]))
    assert sigma_mps[0] == pytest.approx(0.055 * np.sqrt(2) / STEP_S, rel=0.2)
    assert sigma_mps[0] > 2 * sigma_mps[1] > 2 * sigma_mps[2]


def test_an_error_of_the_closing_speed_is_one_of_the_lateral_speed() -> None:
    """The bearing is 3.25 m / 25 m, and the distances before are wrong by the speed."""
    sure, unsure = (
        confirmed_after(LateralFilters(CAMERA), 5, rate_sigma_mps=sigma) for sigma in (0.0, 4.0)
    )
    assert unsure.P_vv[0] > sure.P_vv[0]
    assert unsure.P_vv[0] - sure.P_vv[0] < (4.0 * 3.25 / 25.0) ** 2


def test_boxes_long_before_the_confirmation_do_not_count() -> None:
    assert confirmed_after(LateralFilters(CAMERA), 5, gap_s=0.9).v[0] == pytest.approx(
        -1.5, abs=0.1
    )
    assert confirmed_after(LateralFilters(CAMERA), 5, gap_s=1.5).v[0] == 0.0


def test_boxes_of_other_tracks_and_unknown_rates_start_nothing() -> None:
    filters = LateralFilters(CAMERA)
    seen, z_m = crossing(0.0)
    filters.remember(replace(seen, track_id=seen.track_id + 1), 0.0, yaw_rad_s=0.0, right_mps=0.0)
    filters.start(seen, distance_of(z_m), STEP_S)
    assert np.isnan(filters.last(seen.track_id).x[0])
    filters.remember(seen, 0.0, yaw_rad_s=0.0, right_mps=0.0)
    unknown = replace(distance_of(z_m), v=np.array([np.nan]))
    filters.start(seen, unknown, STEP_S)
    assert np.isnan(filters.last(seen.track_id).x[0])
    filters.start(seen, distance_of(z_m), STEP_S)
    assert np.isfinite(filters.last(seen.track_id).x[0])
