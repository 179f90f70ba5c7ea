"""SceneDepth: speeds by the expansion of the images."""

import math

import numpy as np
import pytest

from track_range.stereo.odometry.image_motion import ImageMotion
from track_range.stereo.odometry.scene_depth import SceneDepth
from track_range.stereo.odometry.speed_filter import SpeedFilter


def motion(expansion_hz, sigma_hz=0.0, dt_s=0.1):
    return ImageMotion(
        time_s=0.0, dt_s=dt_s, expansion_hz=expansion_hz, expansion_sigma_hz=sigma_hz
    )


def driven(speed_mps, n=10):
    """The filter of a drive until now, at time 0."""
    speeds = SpeedFilter()
    for k in range(n):
        speeds.update((k + 1 - n) / 10 - 0.1, 0.1, speed_mps, 0.1, 0.0)
    return speeds


def test_speed_of_a_depth_that_the_road_showed():
    """12 m/s at 0.6 per second: the scene is 20 m away, with 10 % of noise in each frame."""
    depth = SceneDepth()
    for _ in range(5):  # a single speed may be wrong
        assert np.isnan(depth.speed(motion(0.6, dt_s=0.0))).all()
        assert depth.fits(motion(0.6), 12.0)
    # the usual 30 m has a sigma of 0.5, beside five measurements
    speed_mps, noise_mps, lasting_mps = depth.speed(motion(0.5, 0.02))
    assert speed_mps == pytest.approx(0.5 * 20.0 * 1.5 ** (0.002 / 0.252))
    assert noise_mps / speed_mps == pytest.approx(math.hypot(0.1, 0.04))
    # 0.15 per root of a second
    variance = 0.25 * 0.002 / 0.252 + 0.15**2 * 0.1
    assert lasting_mps / speed_mps == pytest.approx(math.sqrt(variance))


def test_speed_that_would_need_another_depth_does_not_fit():
    """A shift of the road by a lead vehicle: 1 m/s at the expansion of 10 m/s."""
    depth, before = SceneDepth(), driven(10.0)
    assert not depth.fits(motion(0.5), 1.0)
    for _ in range(5):
        by_road = depth.checked(motion(0.5), (10.0, 0.1, 0.3), before)
        assert by_road == (10.0, 0.1, 0.3)
    by_scene = depth.checked(motion(0.5), (5.0, 0.1, 0.15), before)
    assert by_scene[0] == pytest.approx(10.0, rel=0.03)
    assert by_scene[1] == pytest.approx(1.0, rel=0.03)
    assert depth.checked(motion(0.5), (math.nan, 0.1, math.nan), before)[0] == by_scene[0]
    assert depth.speed(motion(0.5))[0] == pytest.approx(10.0, rel=0.03)
    # a scene that changed is learnt after some seconds without a speed that fits
    lasting = [depth.speed(motion(0.5))[2] for _ in range(40)]
    assert np.all(np.diff(lasting) > 0)
    assert depth.fits(motion(0.5), 5.0)


def test_rest_and_unknown_motion_show_no_speed():
    depth = SceneDepth()
    for _ in range(5):
        depth.fits(motion(0.6), 12.0)
    for nothing in (motion(0.0), motion(math.nan), motion(-0.1, 0.1)):
        assert np.isnan(depth.speed(nothing)).all()
        assert depth.fits(nothing, 3.0)
    # a camera that looks back or drives back has no speed forwards
    assert not depth.fits(motion(-0.1, 0.02), 3.0)
    assert depth.speed(motion(0.6))[0] == pytest.approx(12.0, rel=0.03)


def test_scene_that_changes_at_once_is_no_change_of_the_speed():
    """Behind the last lamps of a junction, only clouds have corners: 15 m/s at a depth of 20 m,
    then at 500 m, which the old depth would take for 0.6 m/s."""
    depth, before = SceneDepth(), driven(15.0)
    for _ in range(5):
        depth.checked(motion(0.75), (15.0, 0.1, 0.3), before)
    hidden = depth.checked(motion(0.03), (math.nan, 0.1, math.nan), before)
    assert np.isnan(hidden).all()
    assert np.isnan(depth.speed(motion(0.03))).all()  # until the road shows the new depth
    for _ in range(5):
        assert depth.checked(motion(0.03), (15.0, 0.1, 0.3), before) == (15.0, 0.1, 0.3)
    assert depth.speed(motion(0.03))[0] == pytest.approx(15.0, rel=0.03)


def test_road_within_reach_shows_the_depth_of_a_changed_scene():
    depth, before = SceneDepth(), driven(15.0)
    for _ in range(5):
        depth.checked(motion(0.75), (15.0, 0.1, 0.3), before)
    assert depth.checked(motion(0.03), (15.5, 0.1, 0.3), before) == (15.5, 0.1, 0.3)
    # neither the road nor the depth is within reach
    for _ in range(5):
        depth.checked(motion(0.03), (15.5, 0.1, 0.3), before)
    assert np.isnan(depth.checked(motion(0.5), (2.0, 0.1, 0.1), before)).all()
