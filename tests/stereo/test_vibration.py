"""Vibration of a camera: jumps of its images and smooth turns."""

import math

import numpy as np
import pytest

from track_range.stereo.odometry.vibration import Vibration


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
