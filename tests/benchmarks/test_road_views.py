"""Boxes of real drives as cameras at any place of the vehicle see them: geometry by hand."""

import math

import numpy as np
import pytest

from benchmarks.boxes.cuboid_drive import CuboidDrive, Cuboids
from benchmarks.boxes.road_view import RoadView, road_view
from benchmarks.boxes.view_run import run_view
from benchmarks.boxes.view_scores import RunScores, ScoredRows
from track_range.ranging.world.object_motion import MOTION_STATES
from track_range.stereo.geometry.camera import PinholeCamera
from track_range.stereo.geometry.mounting import Mounting

CAMERA = PinholeCamera.of_focal_length(500.0, (1001, 801))  # principal point 500, 400
CAR_LWH_M = (4.0, 2.0, 1.5)
N_FRAMES = 12
SPEED_MPS = 5.0


def drive(*bottom_m: tuple[float, float, float], yaw_rad: float = 0.0) -> CuboidDrive:
    """Cars that rest in the axes of the map, which are those of the vehicle in the first frame; the
    vehicle drives along x.
    """
    n = len(bottom_m)
    times_s = np.arange(N_FRAMES) / 10
    position_m = np.stack([SPEED_MPS * times_s, 0 * times_s, 0 * times_s], axis=1)
    frame = np.repeat(np.arange(N_FRAMES), n)
    cuboids = Cuboids(
        frame,
        np.tile(np.arange(n), N_FRAMES),
        np.full(n * N_FRAMES, "REGULAR_VEHICLE"),
        np.tile(bottom_m, (N_FRAMES, 1)) - position_m[frame],
        np.tile(CAR_LWH_M, (n * N_FRAMES, 1)),
        np.full(n * N_FRAMES, yaw_rad),
        np.full(n * N_FRAMES, 100),
    )
    rotation = np.tile(np.eye(3), (N_FRAMES, 1, 1))
    return CuboidDrive("by hand", times_s, cuboids, position_m, rotation)


def view_of(recorded: CuboidDrive, mounting: Mounting) -> RoadView:
    return road_view(recorded, CAMERA, mounting, z_m=1.2)


@pytest.mark.parametrize(
    ("yaw_deg", "bottom_m", "depth_m"),
    [
        # its rear is 20 - 2 m ahead; seen from the left it is 20 - 1 m away
        (0.0, (20.0, 0.0, -0.3), 18.0),
        (90.0, (0.0, 20.0, -0.3), 19.0),
        (-90.0, (0.0, -20.0, -0.3), 19.0),
        (180.0, (-20.0, 0.0, -0.3), 18.0),
    ],
)
def test_a_car_is_as_far_and_as_high_in_any_direction(
    yaw_deg: float, bottom_m: tuple[float, float, float], depth_m: float
) -> None:
    view = view_of(drive(bottom_m), Mounting(yaw_deg=yaw_deg))
    first = view.rows.frame == 0
    assert view.rows.true_m[first] == pytest.approx([depth_m], abs=1e-6)
    x1, y1, x2, y2 = view.rows.xyxy_px[first][0]
    assert (x1 + x2) / 2 == pytest.approx(500.0, abs=1.0)
    # at most the whole height at the nearest side, and a width of the side that is seen
    side_m = CAR_LWH_M[0] if abs(yaw_deg) == 90 else CAR_LWH_M[1]
    assert 0.88 * 500 * 1.5 / depth_m < y2 - y1 <= 500 * 1.5 / depth_m
    assert 0.88 * 500 * side_m / depth_m < x2 - x1 <= 1.01 * 500 * side_m / depth_m


def test_height_is_above_the_plane_of_the_cars_around() -> None:
    # the road falls by 0.02 per metre ahead and by 0.01 to the left
    around = [(x, y, -0.3 - 0.02 * x - 0.01 * y) for x, y in ((6, 3), (9, -4), (-5, 3), (14, 6))]
    assert drive(*around).road_z_m(1.5, 0.0) == pytest.approx(-0.33, abs=0.06)
    # without motion, the plane is exact
    level = drive(*((x, y, -0.3) for x, y, _ in around))
    assert level.road_z_m(1.5, 0.0) == pytest.approx(-0.3, abs=1e-6)


def test_a_hidden_car_has_the_share_that_is_seen_beside_the_car_in_front() -> None:
    beside = drive((12.0, 0.0, -0.3), (24.0, -2.0, -0.3))
    rows = view_of(beside, Mounting()).rows
    first = rows.frame == 0
    assert rows.track_id[first].tolist() == [0, 1]
    near, far = rows.visible_share[first]
    assert near == 1.0
    # the near car covers -1 to 1 m at 10 m, which is to 2.2 m at 22 m; the far one is 1 to 3 m to
    # the right
    assert far == pytest.approx(0.4, abs=0.13)


def test_objects_at_rest_have_no_velocity_and_the_vehicle_its_speed() -> None:
    recorded = drive((30.0, 3.0, -0.3))
    assert recorded.speed_mps == pytest.approx(np.full(N_FRAMES, SPEED_MPS))
    assert recorded.ground_velocity_mps() == pytest.approx(np.zeros((N_FRAMES, 3)), abs=1e-9)
    assert recorded.yaw_rate_rad_s == pytest.approx(np.zeros(N_FRAMES), abs=1e-9)
    view = view_of(recorded, Mounting(yaw_deg=-60.0))
    moved_m = SPEED_MPS * view.times_s[-1]
    # along the axis, and to the left of it
    assert view.path_m[-1] == pytest.approx((0.5 * moved_m, math.sqrt(0.75) * moved_m))


def test_a_run_measures_the_cars_of_a_view() -> None:
    view = view_of(drive((25.0, 0.0, -0.3), (30.0, 6.0, -0.3)), Mounting())
    scores = run_view(view, region="north-america")
    error = scores.rows.ranges["fused"][0] / view.rows.true_m - 1
    assert np.isfinite(error).mean() > 0.9
    assert 0.0 < np.nanmax(np.abs(error)) < 0.25
    assert scores.doubts == (None,)
    error_m, sigma_m, length_m = scores.path_m[0]
    assert length_m == pytest.approx(SPEED_MPS * view.times_s[-1])
    assert 0.0 <= error_m < 2 * sigma_m < 2.0


def test_runs_are_scored_together_as_different_objects() -> None:
    view = view_of(drive((25.0, 0.0, -0.3), (30.0, 6.0, -0.3)), Mounting())
    run = run_view(view, region="north-america")
    both = RunScores.joined([run, run]).figures()
    alone = run.figures()
    assert (both["runs"], both["tracks"]) == (2, {"car": 4})
    assert both["car, fused"]["n"] == 2 * alone["car, fused"]["n"]
    assert both["car, fused"]["mean_pct"] == pytest.approx(alone["car, fused"]["mean_pct"])


def test_scores_compare_states_that_are_sure() -> None:
    n = 4
    parked, oncoming = (float(MOTION_STATES.index(name)) for name in ("parked", "oncoming"))
    scored = ScoredRows(
        track_id=np.arange(n),
        class_name=np.full(n, "car"),
        true_m=np.array([10.0, 20.0, 40.0, 4.0]),
        has_motion=np.ones(n, np.bool_),
        # at rest, oncoming, too slow for a state, along
        velocity_mps=np.array([[0.1, 0.0], [-5.0, 0.2], [0.6, 0.0], [6.0, 0.0]]),
        ranges={"fused": (np.array([11.0, 20.0, 60.0, 9.0]), np.array([1.0, 1.0, 5.0, 1.0]))},
        speed_mps=np.array([0.0, 5.0, np.nan, 5.0]),
        speed_sigma_mps=np.full(n, 0.4),
        state=np.array([parked, parked, oncoming, np.nan]),
    )
    figures = scored.figures()
    assert figures["tracks"] == {"car": 3}
    errors = figures["car, fused"]
    assert errors["mean_pct"] == pytest.approx(100 * (0.1 + 0.0 + 0.5) / 3)
    assert (errors["n"], errors["within_25"]) == (3, pytest.approx(2 / 3))
    assert (errors["within_1"], errors["within_2"]) == (pytest.approx(2 / 3), pytest.approx(2 / 3))
    motion = figures["vehicles, motion"]
    assert (motion["states"], motion["state_right"]) == (2, 0.5)
    assert motion["state_known"] == pytest.approx(2 / 3)
    assert motion["speed_error_mps"] == pytest.approx((0.1 + 0.004 + 1.0) / 3, abs=1e-3)
    assert motion["speed_within_2"] == pytest.approx(2 / 3)
