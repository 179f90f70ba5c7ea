"""Mounting of a camera: jumps of its images and smooth turns, and the direction of travel beside the
principal point, by hand-worked angles at f = 700 px.
"""

import math

import numpy as np
import pytest

from track_range.stereo.geometry.camera import PinholeCamera
from track_range.stereo.odometry.mounting import TravelDirection, Vibration

CAMERA = PinholeCamera(700.0, 700.0, 620.0, 188.0, 1240, 376)


def vibration(angles_rad):
    """The vibration after frames at these angles of pitch, at 10 Hz."""
    measured = Vibration()
    for k, step in enumerate(np.diff(angles_rad)):
        measured.add(k / 10, np.array([step, 0.0, 0.0]))
    return measured


@pytest.mark.parametrize("sigma_rad", [0.002, 0.006])
def test_jumping_images_have_their_angle(sigma_rad):
    measured = vibration(sigma_rad * np.random.default_rng(0).normal(size=100))
    assert measured.sigma_rad == pytest.approx(sigma_rad, rel=0.35)
    (note,) = measured.notes(focal_px=1000.0)
    assert "vibrate" in note


def test_turn_and_slow_pitching_are_no_vibration():
    time_s = np.arange(0, 10, 0.1)
    measured = vibration(0.2 * time_s + 0.01 * np.sin(2 * math.pi * time_s))
    assert measured.notes(focal_px=1000.0) == ()


def test_unknown_rotation_separates_frames():
    measured = Vibration()
    for k in range(100):
        measured.add(k / 10, None if k % 2 else np.array([0.01 * (-1) ** (k // 2), 0.0, 0.0]))
    assert measured.sigma_rad == 0.0


def notes_after(seconds: float, side_rad: float, yaw_rad_s: float = 0.0) -> tuple[str, ...]:
    direction = TravelDirection(CAMERA)
    for _ in range(round(10 * seconds)):
        direction.add(0.1, side_rad, yaw_rad_s)
    return direction.notes


def test_a_direction_to_the_left_is_noted_with_its_pixels():
    # 0.0886 rad = 5.08 degrees, 62 px at 700 px
    (note,) = notes_after(2.0, -0.0886)
    assert "5.1 degrees to the left" in note
    assert "principal point is 62 px too far to the right" in note


@pytest.mark.parametrize(
    ("seconds", "side_rad", "yaw_rad_s"),
    [(1.0, 0.09, 0.0), (9.0, 0.04, 0.0), (9.0, 0.09, 0.1), (9.0, math.nan, 0.0)],
    ids=["short", "small", "turn", "unknown"],
)
def test_what_is_no_clear_direction_is_not_noted(seconds, side_rad, yaw_rad_s):
    assert notes_after(seconds, side_rad, yaw_rad_s) == ()


def test_the_direction_is_the_mean_over_time():
    direction = TravelDirection(CAMERA)
    direction.add(0.1, 0.0, 0.0)
    direction.add(0.3, 0.08, 0.0)
    assert direction.side_rad == pytest.approx(0.06)
