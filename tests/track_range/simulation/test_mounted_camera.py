"""Drives of cameras that do not look ahead: exact positions, and images of the right directions."""

import math
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from pydantic import ValidationError

from track_range.simulation.drive import write_drive
from track_range.simulation.render.renderer import Renderer
from track_range.simulation.render.street import stretches
from track_range.simulation.settings import DriveOptions
from track_range.simulation.world.road_shape import RoadShape
from track_range.simulation.world.scene import AWAY_RAD, RoadUser, Scene
from track_range.stereo.geometry.camera import PinholeCamera
from track_range.stereo.geometry.mounting import Mounting
from track_range.stereo.geometry.rig import StereoRig
from track_range.stereo.rig_formats.rig_yaml import RIG_YAML

RIG = StereoRig.rectified(PinholeCamera.of_focal_length(200.0, (320, 180)), 0.5)


def parked(x_m: float, z_m: float) -> RoadUser:
    return RoadUser(
        track_id=0,
        kitti_type="Car",
        size_hwl_m=(1.5, 1.7, 4.2),
        start_xz_m=(x_m, z_m),
        rotation_y_rad=AWAY_RAD,
    )


@pytest.mark.parametrize(
    ("mounting", "location_m"),
    [
        (Mounting(), (5.0, 1.65, 10.0)),
        (Mounting(yaw_deg=-90.0), (-10.0, 1.65, 5.0)),
        (Mounting(yaw_deg=90.0), (10.0, 1.65, -5.0)),
        (Mounting(yaw_deg=180.0), (-5.0, 1.65, -10.0)),
        # 2 m ahead of the reference point and 1 m to its left
        (Mounting(x_m=2.0, y_m=1.0), (6.0, 1.65, 8.0)),
        (Mounting(yaw_deg=-90.0, x_m=2.0, y_m=1.0), (-8.0, 1.65, 6.0)),
        # 45 degrees down: (1.65 + 10) / sqrt 2 along the axis, (10 - 1.65) / sqrt 2 above it
        (Mounting(pitch_deg=45.0), (5.0, -8.35 / math.sqrt(2), 11.65 / math.sqrt(2))),
        # the right side is 90 degrees lower: what is below is on the right, and what is on the right above
        (Mounting(roll_deg=90.0), (1.65, -5.0, 10.0)),
    ],
)
def test_objects_are_where_the_camera_sees_them(
    mounting: Mounting, location_m: tuple[float, float, float]
) -> None:
    scene = Scene(seed=0, road_users=(parked(5.0, 10.0),), mounting=mounting)
    assert scene.location_m(0.0)[0] == pytest.approx(location_m, abs=1e-9)


def test_headings_turn_against_the_camera() -> None:
    scene = Scene(seed=0, road_users=(parked(5.0, 10.0),), mounting=Mounting(yaw_deg=90.0))
    # the car's length is along the x axis of a camera that looks to the left
    assert scene.rotation_y_rad()[0] == pytest.approx(0.0)
    assert scene.rotations(0.0)[0] == pytest.approx(np.eye(3))


def test_a_camera_ahead_of_the_reference_point_swings_out_in_a_bend() -> None:
    road = RoadShape(bend_rad=math.radians(60.0), bend_at_m=20.0)
    scene = Scene(seed=0, road_users=(), road=road, mounting=Mounting(x_m=2.0, y_m=0.5))
    for time_s in (0.0, 2.0, 4.0):
        z_m = scene.ego_z_m(time_s)
        yaw_rad = float(road.yaw_rad(np.array(z_m)))
        moved_m = scene.pose(time_s).position_m - (float(road.x_m(np.array(z_m))), -1.65, z_m)
        cos, sin = math.cos(yaw_rad), math.sin(yaw_rad)
        assert moved_m == pytest.approx((2 * sin - 0.5 * cos, 0.0, 2 * cos + 0.5 * sin))


def test_a_camera_that_looks_to_the_rear_sees_the_street_behind() -> None:
    ahead = Scene(seed=0, road_users=(), mounting=Mounting(pitch_deg=5.0))
    behind = replace(ahead, mounting=Mounting(yaw_deg=180.0, pitch_deg=5.0))
    road_m, other_m = (Renderer(scene, RIG, noise_grey=0).depth_m(6.0) for scene in (ahead, behind))
    # the lower half shows the same plane, at 60 m from the start of the street
    assert np.isfinite(road_m[120:]).all()
    assert other_m[120:] == pytest.approx(road_m[120:], rel=1e-4)


def test_stretches_to_both_sides_are_adjacent_and_cover_the_view() -> None:
    pieces = list(stretches(100.0, is_behind_too=True))
    starts_m, lengths_m = np.array(pieces).T
    assert starts_m[0] <= 100.0 - 250.0
    assert starts_m[-1] + lengths_m[-1] >= 350.0
    assert starts_m[1:] == pytest.approx(starts_m[:-1] + lengths_m[:-1])
    # the shortest ones are beside the camera
    assert set(lengths_m[(starts_m > 80) & (starts_m < 120)]) == {3}
    assert lengths_m.max() == 24


def test_a_drive_has_its_mounting_in_the_rig_and_distances_along_the_axis(tmp_path: Path) -> None:
    options = DriveOptions(mount=("yaw=-58,pitch=2,x=2,z=2.1",))
    drive = write_drive(tmp_path, seed=0, seconds=0.1, rig=RIG, options=options)
    known = RIG_YAML.read(drive.rig.read_text(encoding="utf-8"), drive.rig, False)
    assert known.mounting == Mounting(yaw_deg=-58.0, pitch_deg=2.0, x_m=2.0, z_m=2.1)
    assert drive.left.stat().st_size > 0


def test_a_mounting_that_is_none_is_refused() -> None:
    with pytest.raises(ValidationError, match="expected yaw from -180 to 180"):
        DriveOptions(mount=("yaw=300",))
