import math

import numpy as np
import pytest

from track_range.stereo.odometry.camera_height import CameraHeight
from track_range.stereo.odometry.ego_motion import EgoMotion


def after(n, *, factor=1.1, noise=0.05, known_mps=10.0, seed=0):
    """The estimator after `n` frames in which the camera is `factor` times as high as assumed."""
    height, rng = CameraHeight(1.5), np.random.default_rng(seed)
    for k in range(n):
        road_mps = known_mps / factor * math.exp(noise * rng.normal())
        height.update(0.1 * k, EgoMotion(known_mps, 0.1), EgoMotion(road_mps, 0.3))
    return height.height_m


def test_height_of_a_known_speed():
    height_m, sigma_m = after(100)
    assert height_m == pytest.approx(1.65, rel=0.02)
    assert 0.02 < sigma_m / height_m < 0.04


def test_sigma_shrinks_to_the_shared_error():
    sigmas = [sigma_m / height_m for height_m, sigma_m in (after(15), after(50), after(500))]
    assert sigmas[0] > sigmas[1] > sigmas[2] > 0.02


def test_unknown_at_first_and_at_low_speed():
    assert after(5) is None
    assert after(100, known_mps=2.0) is None


def test_unknown_speeds_are_left_out():
    height = CameraHeight(1.5)
    for k in range(40):
        known = EgoMotion(10.0, 0.1) if k % 3 else EgoMotion()
        road = EgoMotion(10.0, 0.3) if k % 4 else EgoMotion()
        height.update(0.1 * k, known, road)
    assert height.height_m == pytest.approx((1.5, 0.03))
