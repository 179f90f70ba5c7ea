"""Alarms of the collision warning on closed-form drives: collisions, and their harmless twins."""

from __future__ import annotations

import math
from collections.abc import Callable

import numpy as np
import pytest

from track_range.foundation.arrays import FloatArray
from track_range.ranging.filtering.distance_filter import DistanceFilters
from track_range.ranging.filtering.lateral_motion import LateralFilters
from track_range.ranging.measurement.ranges import Ranges
from track_range.ranging.warning.collision_warning import CollisionWarning
from track_range.ranging.warning.settings import WarningSettings
from track_range.ranging.warning.warnings import Warnings
from track_range.stereo.geometry.camera import PinholeCamera
from track_range.stereo.odometry.ego_motion import EgoMotion
from track_range.tracking.tracks import Tracks

CAMERA = PinholeCamera(700.0, 700.0, 620.0, 187.0, 1241, 374)
STEP_S = 0.1
PERSON, CAR, SIGN = 0, 2, 7
Path = Callable[[float], tuple[float, float]]
"""x and z of the object relative to the camera at a time, m."""


def drive(
    path: Path,
    *,
    seconds: float,
    ego_mps: float | Callable[[float], float] = math.nan,
    yaw_rad_s: float | Callable[[float], float] = math.nan,
    class_id: int = CAR,
    width_m: float = 1.8,
    settings: WarningSettings | None = None,
    measured_m: Callable[[float], float] | None = None,
    size_error: float = 0.0,
    size_sigma: float = 0.0,
) -> list[Warnings]:
    """Warnings of all frames with one object, measured with 1 % of noise in distance and 0.5 px in
    the box.

    `measured_m` replaces the distances that confirm the filtered ones. With one camera, all
    distances are wrong by the relative `size_error`, with the standard deviation `size_sigma`.
    """
    rng = np.random.default_rng(3)
    filters, lateral = DistanceFilters({"fused": 0.9}), LateralFilters(CAMERA)
    warning, ids = CollisionWarning(settings), np.array([1])
    results = []
    for time_s in np.arange(0, seconds, STEP_S).tolist():
        x_m, z_m = path(time_s)
        yaw = yaw_rad_s(time_s) if callable(yaw_rad_s) else yaw_rad_s
        V = ego_mps(time_s) if callable(ego_mps) else ego_mps
        middle, half = 620.0 + 700.0 * x_m / z_m, 350.0 * width_m / z_m
        box: FloatArray = np.array([[middle - half, 187.0, middle + half, 187.0 + 1000.0 / z_m]])
        tracks = Tracks(
            ids,
            box + rng.normal(0, 0.5, (1, 4)),
            np.array([class_id]),
            np.ones(1),
            np.ones(1, bool),
        )
        distance_m = z_m * (1 + size_error) * (1 + 0.01 * rng.normal())
        sigma_m = math.hypot(0.01, size_sigma) * z_m
        systematic_m = np.array([size_sigma * z_m]) if size_sigma else None
        measured = {"fused": Ranges(ids, np.array([distance_m]), np.array([sigma_m]), systematic_m)}
        motion = filters.update(measured, time_s, ego=EgoMotion(V))["fused"]
        own_mps = motion.state.v + V if math.isfinite(V) else 0.0
        side = lateral.update(
            tracks, motion.ranges.distance_m, time_s, yaw_rad_s=yaw, own_mps=own_mps
        )
        ranges = measured["fused"]
        if measured_m is not None:
            ranges = Ranges(ids, np.array([measured_m(time_s)]), ranges.sigma_m)
        results.append(
            warning.update(tracks, motion, side, time_s, ego_mps=V, yaw_rad_s=yaw, ranges=ranges)
        )
    return results


def first_alarm_s(results: list[Warnings]) -> float:
    return next(
        (STEP_S * number for number, result in enumerate(results) if result.active[0]), math.inf
    )


def standing_in_a_bend(ego_mps: float, curvature: float, *, z_m: float, x_m: float) -> Path:
    """A static object at (x, z) as seen from a camera that drives along an arc."""

    def path(time_s: float) -> tuple[float, float]:
        turned = curvature * ego_mps * time_s
        ego_x, ego_z = (1 - math.cos(turned)) / curvature, math.sin(turned) / curvature
        dx, dz = x_m - ego_x, z_m - ego_z
        return dx * math.cos(turned) - dz * math.sin(turned), dx * math.sin(turned) + dz * math.cos(
            turned
        )

    return path


@pytest.mark.parametrize("ego_mps", [12.0, math.nan])
def test_standing_car_ahead(ego_mps: float) -> None:
    """The contact is when the front of the ego vehicle, 1.5 m before the camera, arrives: after
    (61.5 - 1.5) / 12 s."""
    results = drive(lambda t: (0.2, 61.5 - 12 * t), seconds=4.9, ego_mps=ego_mps, yaw_rad_s=0.0)
    assert 2.0 < 5.0 - first_alarm_s(results) < 3.6
    assert results[-1].active[0]
    assert results[-1].probability[0] > 0.95


@pytest.mark.parametrize("gap_s", [0.3, 1.5])
def test_gap_in_the_ego_speed_keeps_the_evidence(gap_s: float) -> None:
    """The speed of the ego vehicle is unknown for a while before an alarm; the relative motion is
    measured all the time, so that the test goes on."""
    path: Path = lambda t: (0.2, 61.5 - 12 * t)  # noqa: E731
    known = drive(path, seconds=4.9, ego_mps=12.0, yaw_rad_s=0.0)
    start_s = first_alarm_s(known)
    results = drive(
        path,
        seconds=4.9,
        ego_mps=lambda t: math.nan if start_s - gap_s < t < start_s - 0.1 else 12.0,
        yaw_rad_s=0.0,
    )
    assert first_alarm_s(results) < start_s + 0.25
    before = round((start_s - gap_s) / STEP_S)
    least = min(float(result.probability[0]) for result in results[before:])
    assert least > float(known[before].probability[0]) - 0.1


@pytest.mark.parametrize(
    ("slope_mps", "starts"), [(-12.0, True), (-11.0, True), (0.0, False), (2.0, False)]
)
def test_measured_distances_confirm_the_closing_speed(slope_mps: float, starts: bool) -> None:
    """The filtered distance falls by 12 m/s; an alarm starts only if the measured ones fall as
    well."""
    path: Path = lambda t: (0.2, 61.5 - 12 * t)  # noqa: E731
    results = drive(
        path, seconds=4.0, ego_mps=12.0, yaw_rad_s=0.0, measured_m=lambda t: 61.5 + slope_mps * t
    )
    assert (first_alarm_s(results) < 3.0) == starts


def test_crossing_person() -> None:
    """Walks from the right at 1.5 m/s and is in the middle of the path when the ego vehicle arrives
    after 4 s."""
    path: Path = lambda t: (6.0 - 1.5 * t, 41.5 - 10 * t)  # noqa: E731
    results = drive(path, seconds=3.9, ego_mps=10.0, yaw_rad_s=0.0, class_id=PERSON, width_m=0.5)
    assert 4.0 - first_alarm_s(results) > 2.0


@pytest.mark.parametrize("size_error", [-0.1, 0.0, 0.1])
def test_unknown_size_does_not_delay_the_alarm(size_error: float) -> None:
    """One camera: the size of the car is known within 10 %, and all its distances are wrong by one
    factor, which is no speed. The alarm comes as early as with two cameras."""
    path: Path = lambda t: (0.2, 61.5 - 12 * t)  # noqa: E731
    results = drive(
        path,
        seconds=4.9,
        ego_mps=12.0,
        yaw_rad_s=0.0,
        size_error=size_error,
        size_sigma=0.1,
    )
    assert 2.1 < 5.0 - first_alarm_s(results) < 3.9


@pytest.mark.parametrize("size_error", [-0.1, 0.0, 0.1])
def test_crossing_person_of_unknown_size(size_error: float) -> None:
    path: Path = lambda t: (6.0 - 1.5 * t, 41.5 - 10 * t)  # noqa: E731
    results = drive(
        path,
        seconds=3.9,
        ego_mps=10.0,
        yaw_rad_s=0.0,
        class_id=PERSON,
        width_m=0.5,
        size_error=size_error,
        size_sigma=0.1,
    )
    assert 4.0 - first_alarm_s(results) > 1.9


@pytest.mark.parametrize("size_sigma", [0.0, 0.12])
def test_car_that_turns_in(size_sigma: float) -> None:
    """A car comes from the right at 6 m/s and is in the path when the ego vehicle arrives after
    4 s; it would have to brake with more than 3 m/s2 to stop beside it in the last 1.5 s."""
    path: Path = lambda t: (24.0 - 6.0 * t, 49.5 - 12 * t)  # noqa: E731
    results = drive(path, seconds=3.9, ego_mps=12.0, yaw_rad_s=0.0, size_sigma=size_sigma)
    assert 0.8 < 4.0 - first_alarm_s(results) < 2.5


def test_car_that_gives_way() -> None:
    """The same car brakes with 2 m/s2 and stops 1.5 m beside the ego vehicle."""

    def path(time_s: float) -> tuple[float, float]:
        left_s = max(3.5 - time_s, 0.0)
        return 4.2 + min(left_s, 3.0) ** 2 + 6.0 * max(left_s - 3.0, 0.0), 49.5 - 12 * time_s

    results = drive(path, seconds=3.9, ego_mps=12.0, yaw_rad_s=0.0)
    assert first_alarm_s(results) == math.inf


@pytest.mark.parametrize("name", ["min_on_s", "uncertain_on_s"])
def test_given_time_delays_the_alarm(name: str) -> None:
    path: Path = lambda t: (0.2, 61.5 - 12 * t)  # noqa: E731
    start_s = first_alarm_s(drive(path, seconds=4.9, ego_mps=12.0, yaw_rad_s=0.0))
    settings = WarningSettings(**{name: 0.5})
    later = drive(path, seconds=4.9, ego_mps=12.0, yaw_rad_s=0.0, settings=settings)
    assert first_alarm_s(later) == pytest.approx(start_s + 0.5)


@pytest.mark.parametrize(
    "path",
    [
        lambda t: (-3.5, 90.0 - 24 * t),  # oncoming in the next lane
        lambda t: (3.4, 40.0 - 10 * t),  # parked beside the lane
        lambda t: (0.0, 24.0),  # the vehicle ahead at a headway of 2 s
        lambda t: (0.0, 14.0 + 3 * t),  # draws away
        lambda t: (5.0 - 0.2 * t, 40.0 - 10 * t),  # comes a little nearer while it is passed
    ],
)
def test_harmless_motion(path: Path) -> None:
    results = drive(path, seconds=3.5, ego_mps=12.0, yaw_rad_s=0.0)
    assert first_alarm_s(results) == math.inf
    assert max(float(np.nan_to_num(result.probability[0])) for result in results[10:]) < 0.5


def test_parked_car_straight_ahead_in_a_bend() -> None:
    """On an arc of 1 / 60 m, a car straight ahead at 25 m is 5.2 m beside the path; without the yaw
    rate it is not."""
    path = standing_in_a_bend(8.0, 1 / 60, z_m=40.0, x_m=8.0)
    known = drive(path, seconds=4.5, ego_mps=8.0, yaw_rad_s=8.0 / 60)
    assert first_alarm_s(known) == math.inf


def test_car_in_the_path_in_a_bend() -> None:
    """On the same arc, a car in the path is at x = z^2 / (2 R)."""
    path = standing_in_a_bend(8.0, 1 / 60, z_m=38.0, x_m=60 - math.sqrt(60**2 - 38**2))
    results = drive(path, seconds=5.0, ego_mps=8.0, yaw_rad_s=8.0 / 60)
    assert first_alarm_s(results) < math.inf


def test_path_at_the_entry_of_a_bend() -> None:
    """The yaw rate grows by 0.04 rad/s per second: a circle would miss a car in the path 25 m ahead
    by 1 m.

    The path itself is right within 0.2 m; the error of the closing speed adds to it, as far as the
    bend is uncertain.
    """
    step_s, V = 0.01, 10.0
    heading = 0.02 * np.arange(0, 6, step_s) ** 2
    x_m, z_m = np.cumsum(V * step_s * np.sin(heading)), np.cumsum(V * step_s * np.cos(heading))

    def path(time_s: float) -> tuple[float, float]:
        now = round(time_s / step_s)
        dx, dz, turned = x_m[500] - x_m[now], z_m[500] - z_m[now], heading[now]
        return dx * math.cos(turned) - dz * math.sin(turned), dx * math.sin(turned) + dz * math.cos(
            turned
        )

    results = drive(path, seconds=3.0, ego_mps=V, yaw_rad_s=lambda time_s: 0.04 * time_s)
    assert abs(results[25].path_offset_m[0]) < 0.6
    assert abs(results[25].path_offset_m[0]) < results[25].path_offset_sigma_m[0]


def test_path_is_as_uncertain_as_drivers_steer() -> None:
    """2 s ahead at 8 m/s, drivers who go straight stay within 0.2 m on KITTI (660 frames); in turns,
    half of them leave a circle by 0.9 m (240 frames). With 1 m/s^2, the random walk of the yaw
    acceleration alone gives V T^3.5 (q / 252)^0.5 = 0.7 m."""
    straight = drive(lambda t: (3.0, 32.0 - 8 * t), seconds=2.1, ego_mps=8.0, yaw_rad_s=0.0)
    turning = drive(
        standing_in_a_bend(8.0, 1 / 60, z_m=31.0, x_m=9.0),
        seconds=2.1,
        ego_mps=8.0,
        yaw_rad_s=8.0 / 60,
    )
    straight_m, turning_m = (
        float(results[20].path_offset_sigma_m[0]) for results in (straight, turning)
    )
    assert straight_m < 0.4
    assert 0.7 < turning_m < 1.5


def test_person_who_appears_late() -> None:
    """First seen 1.6 s before the contact; people hardly walk along the road, so the closing speed
    is known at once."""
    results = drive(
        lambda t: (2.5 - 1.5 * t, 17.5 - 10 * t),
        seconds=1.5,
        ego_mps=10.0,
        yaw_rad_s=0.0,
        class_id=PERSON,
        width_m=0.5,
    )
    assert first_alarm_s(results) <= 0.6


@pytest.mark.parametrize(("width_m", "starts"), [(0.9, True), (2.0, False)])
def test_rider_whose_box_is_called_person(width_m: float, starts: bool) -> None:
    """Comes from the right at 3 m/s and could stop beside the path with less than 3 m/s2 until
    1.1 s before the contact; people do not give way, riders do."""
    path: Path = lambda t: (12.0 - 3 * t, 41.5 - 10 * t)  # noqa: E731
    results = drive(
        path, seconds=2.9, ego_mps=10.0, yaw_rad_s=0.0, class_id=PERSON, width_m=width_m
    )
    assert (first_alarm_s(results) < math.inf) == starts


def test_vehicle_that_passes_obliquely() -> None:
    """A parked car whose box holds its side is 2.6 m wide; its inner edge is 0.7 m beside the ego
    vehicle, that of the box in its middle's depth only 0.3 m."""
    results = drive(
        lambda t: (2.4, 41.5 - 10 * t), seconds=3.5, ego_mps=10.0, yaw_rad_s=0.0, width_m=2.6
    )
    assert first_alarm_s(results) == math.inf
    assert float(results[30].probability[0]) < 0.3


def test_vehicle_that_stops_in_a_queue() -> None:
    """At 4.5 m/s, the vehicle 12 m ahead brakes with 2 m/s2 after 2 s; the ego vehicle can still
    brake gently."""

    def path(time_s: float) -> tuple[float, float]:
        return 0.0, 13.5 - max(time_s - 2.0, 0.0) ** 2

    assert first_alarm_s(drive(path, seconds=3.6, ego_mps=4.5, yaw_rad_s=0.0)) == math.inf


def test_track_that_changes_to_another_vehicle() -> None:
    """In a queue, a track jumps from one vehicle to the next nearer one."""

    def path(time_s: float) -> tuple[float, float]:
        return 0.0, 38.0 if time_s < 2.0 else 28.0 if time_s < 2.6 else 20.0

    assert first_alarm_s(drive(path, seconds=4.0, ego_mps=4.5, yaw_rad_s=0.0)) == math.inf


def test_cut_in_at_a_short_headway() -> None:
    """A car of the same speed, 9 m ahead at 25 m/s, changes into the ego lane within 2.5 s."""
    path: Path = lambda t: (3.6 * (1 - min(max(t - 1.0, 0.0) / 2.5, 1.0)), 9.0)  # noqa: E731
    results = drive(path, seconds=4.5, ego_mps=25.0, yaw_rad_s=0.0)
    assert 1.0 < first_alarm_s(results) < 3.0
    assert first_alarm_s(drive(path, seconds=4.5)) == math.inf  # not without the ego speed
    far: Path = lambda t: (path(t)[0], 25.0)  # noqa: E731
    assert first_alarm_s(drive(far, seconds=4.5, ego_mps=25.0, yaw_rad_s=0.0)) == math.inf


def test_signs_have_no_probability() -> None:
    results = drive(lambda t: (0.0, 40.0 - 10 * t), seconds=3.5, ego_mps=10.0, class_id=SIGN)
    assert all(np.isnan(result.probability[0]) and not result.active[0] for result in results)


def test_alarm_has_hysteresis() -> None:
    """An alarm starts only while the probability is above the threshold; it ends only 0.5 s after
    the probability has fallen."""
    path: Path = lambda t: (0.0, 41.5 - 10 * min(t, 2.5))  # noqa: E731 - the ego vehicle stops at once after 2.5 s
    results = drive(path, seconds=6.0)
    active = [bool(result.active[0]) for result in results]
    starts, ends = active.index(True), len(active) - 1 - active[::-1].index(True)
    assert all(active[starts : ends + 1])
    above = [
        i
        for i, result in enumerate(results)
        if result.probability[0] >= WarningSettings().on_probability
    ]
    assert starts >= above[0]
    assert ends >= above[-1] + 4


def test_no_tracks_and_unknown_distances() -> None:
    filters, lateral, warning = (
        DistanceFilters({"fused": 0.9}),
        LateralFilters(CAMERA),
        CollisionWarning(),
    )
    for tracks in (
        Tracks.empty(),
        Tracks(np.array([4]), np.ones((1, 4)), np.array([2]), np.ones(1), np.ones(1, bool)),
    ):
        motion = filters.update({"fused": Ranges.unmeasured(tracks.track_id)}, 0.0)["fused"]
        result = warning.update(
            tracks, motion, lateral.update(tracks, motion.ranges.distance_m, 0.0), 0.0
        )
        assert len(result.probability) == len(tracks)
        assert not result.active.any()
        assert np.isnan(result.probability).all()
