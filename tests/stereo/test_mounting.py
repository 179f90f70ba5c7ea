"""Mountings of cameras: axes, signs, parts of texts, and views of a camera."""

import math

import numpy as np
import pytest
from hypothesis import given, strategies as st

from track_range.stereo.geometry.camera import PinholeCamera
from track_range.stereo.geometry.mounting import Mounting
from track_range.stereo.geometry.rig import RigError, RoadCalibration, StereoRig
from track_range.stereo.rig_formats.reading import read_calibration
from track_range.stereo.rig_formats.rig_yaml import save_camera, save_rig

CAMERA = PinholeCamera(700.0, 700.0, 320.0, 180.0, width_px=640, height_px=360)
ANGLES = st.floats(-80.0, 80.0)


def axes(mounting):
    """The camera's right, down and forward in the axes of the vehicle."""
    return mounting.vehicle_from_camera.T.round(6).tolist()


def test_level_camera_looks_forward():
    assert axes(Mounting()) == [[0, -1, 0], [0, 0, -1], [1, 0, 0]]


@pytest.mark.parametrize(
    ("mounting", "axis"),
    [
        (Mounting(yaw_deg=90.0), [0, 1, 0]),  # to the left
        (Mounting(yaw_deg=-90.0), [0, -1, 0]),
        (Mounting(yaw_deg=180.0), [-1, 0, 0]),
        (Mounting(pitch_deg=30.0), [0.866025, 0, -0.5]),  # down
    ],
)
def test_signs_of_yaw_and_pitch(mounting, axis):
    assert axes(mounting)[2] == pytest.approx(axis, abs=1e-6)


def test_positive_roll_lowers_the_right_side():
    right, _, forward = axes(Mounting(roll_deg=10.0))
    assert right == pytest.approx([0, -0.984808, -0.173648], abs=1e-6)
    assert forward == [1, 0, 0]


def test_camera_that_looks_to_the_right_moves_to_its_left():
    # 58 degrees: sin = 0.848, cos = 0.530
    right, down, forward = Mounting(yaw_deg=-58.0).velocity_mps(10.0).tolist()
    assert (right, down, forward) == pytest.approx((-8.480, 0.0, 5.299), abs=1e-3)


def test_camera_in_front_of_the_reference_point_swings_out_in_turns():
    # 0.1 rad/s to the right, 2 m in front and 1 m to the left: 0.2 m/s to the right, 0.1 m/s faster
    mounting = Mounting(x_m=2.0, y_m=1.0)
    assert mounting.velocity_mps(10.0, 0.1).tolist() == pytest.approx([0.2, 0.0, 10.1])
    assert mounting.velocity_mps(10.0, math.nan).tolist() == pytest.approx([0.0, 0.0, 10.0])


@given(ANGLES, ANGLES, ANGLES, ANGLES, ANGLES)
def test_two_views_of_a_camera_are_the_view_of_their_sum(yaw, pitch, roll, first, second):
    mounting = Mounting(yaw_deg=yaw, pitch_deg=pitch, roll_deg=roll)
    twice = mounting.turned(first).turned(second).vehicle_from_camera
    once = mounting.turned(first + second).vehicle_from_camera
    assert np.abs(twice - once).max() < 1e-6
    assert np.abs(twice @ twice.T - np.eye(3)).max() < 1e-9
    # the camera's vertical axis stays
    assert np.abs((twice - mounting.vehicle_from_camera)[:, 1]).max() < 1e-6


def test_view_to_the_right_of_a_level_camera():
    assert Mounting(yaw_deg=20.0).turned(50.0).yaw_deg == pytest.approx(-30.0)


@pytest.mark.parametrize(
    ("yaw_deg", "is_ahead"), [(0.0, True), (10.0, True), (-10.5, False), (180.0, False)]
)
def test_limit_of_looking_ahead(yaw_deg, is_ahead):
    assert Mounting(yaw_deg=yaw_deg, pitch_deg=20.0).is_ahead == is_ahead


def test_parts_of_a_text():
    mounting = Mounting.of(["yaw=-58", " pitch = 2.5", "z=2.03"])
    assert mounting == Mounting(yaw_deg=-58.0, pitch_deg=2.5, z_m=2.03)
    assert Mounting.of(mounting.parts) == mounting


@pytest.mark.parametrize(
    ("parts", "word"),
    [
        (["jaw=3"], "yaw, pitch, roll, x, y, z, front, sigma"),
        (["yaw"], "number after yaw"),
        (["yaw=left"], "'left'"),
        (["yaw=1", "yaw=2"], "twice"),
        (["yaw=200"], "-180 to 180"),
        (["yaw=nan"], "nan"),
        (["z=70"], "0.2 to 60"),
        (["x=2,front=1.5"], "front.*at least at x of the camera, 2, found 1.5"),
    ],
)
def test_unusable_parts_are_named(parts, word):
    with pytest.raises(ValueError, match=word):
        Mounting.of(parts)


@pytest.mark.parametrize(
    ("values", "found"),
    [
        ({"yaw_deg": None}, "yaw from -180 to 180, found None"),
        ({"sigma_deg": None}, "sigma from 0 to 90, found None"),
        ({"yaw_deg": True}, "yaw from -180 to 180, found True"),
        ({"yaw_deg": "-58"}, "yaw from -180 to 180, found '-58'"),
    ],
)
def test_values_that_are_no_numbers_are_named(values, found):
    with pytest.raises(ValueError, match=found):
        Mounting(**values)


def test_parts_of_numpy_numbers():
    mounting = Mounting(yaw_deg=np.float64(-58.0), pitch_deg=np.int64(2))
    assert Mounting.of(mounting.parts) == mounting


def mounting_of(path):
    return read_calibration(path, is_grey=False, is_pair=False).mounting


def test_mounting_in_rig_yaml(tmp_path):
    mounting = Mounting(yaw_deg=-58.0, pitch_deg=2.0, x_m=1.5, z_m=2.03, sigma_deg=0.5)
    path = tmp_path / "rig.yaml"
    save_camera(CAMERA, path, mounting=mounting)
    assert "z_m: 2.03" in path.read_text()
    assert mounting_of(path) == mounting
    save_rig(StereoRig.rectified(CAMERA, 0.5), path, mounting=mounting)
    assert mounting_of(path) == mounting


def test_mounting_beside_a_calibration_from_the_road(tmp_path):
    road = RoadCalibration(
        focal_sigma=0.04,
        camera_height_m=1.42,
        camera_height_sigma_m=0.05,
        pitch_deg=1.1,
        pitch_sigma_deg=0.2,
    )
    path = tmp_path / "rig.yaml"
    save_camera(CAMERA, path, road=road)
    assert mounting_of(path) is None  # such a file does not say where the camera looks
    mounting = Mounting(yaw_deg=3.0)
    save_camera(CAMERA, path, road=road, mounting=mounting)
    content = read_calibration(path, is_grey=False, is_pair=False)
    assert (content.road, content.mounting) == (road, mounting)


@pytest.mark.parametrize(
    ("block", "word"),
    [
        ("{yaw_deg: 300}", "yaw from -180 to 180"),
        ("{jaw_deg: 3}", "unknown"),
        ("{focal_sigma: 0.1, pitch_deg: 1}", "camera_height_m"),
        ("{yaw_deg: left}", "number"),
        ("{focal_sigma: 0.1, yaw_deg: -58}", "only in the block 'road'"),
        ("{focal_sigma: 0.1}\nroad: {focal_sigma: 0.2}", "only in the block 'road'"),
    ],
)
def test_unusable_block_is_named(tmp_path, block, word):
    path = tmp_path / "rig.yaml"
    save_camera(CAMERA, path)
    path.write_text(path.read_text() + f"mounting: {block}\n")
    with pytest.raises(RigError, match=f"rig.yaml.*{word}"):
        read_calibration(path, is_grey=False, is_pair=False)


@pytest.mark.parametrize(
    ("one", "other", "apart_deg"),
    [
        (Mounting(yaw_deg=180.0), Mounting(yaw_deg=-179.0), 1.0),
        (Mounting(yaw_deg=-58.0), Mounting(yaw_deg=58.0), 116.0),
        (Mounting(pitch_deg=10.0), Mounting(pitch_deg=-5.0), 15.0),
        (Mounting(yaw_deg=30.0), Mounting(yaw_deg=30.0), 0.0),
        (Mounting(), Mounting(yaw_deg=180.0), 180.0),
        # about its own axis, a camera ahead moves as before
        (Mounting(), Mounting(roll_deg=20.0), 0.0),
    ],
)
def test_angle_between_the_directions_of_travel(one, other, apart_deg):
    assert one.apart_deg(other) == pytest.approx(apart_deg, abs=1e-5)
