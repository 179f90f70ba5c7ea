"""The focal length by the turns of a drive: of rendered images, and what is tracked at all."""

import math
from dataclasses import replace

import numpy as np
import pytest

from track_range.ranging.cameras.evidence import SeenFrame
from track_range.ranging.cameras.motion_evidence import MotionEvidence
from track_range.ranging.measurement.ranges import Ranges
from track_range.simulation.render.renderer import Renderer, kitti_like_rig
from track_range.simulation.world.scenarios import make_scenario
from track_range.stereo.geometry.camera import PinholeCamera
from track_range.stereo.odometry.ego_motion import Ego, EgoMotion
from track_range.tracking.tracks import Tracks

RIG = kitti_like_rig(width_px=800, height_px=256)


def seen(time_s, yaw_rad_s, image=None):
    ids = np.zeros(0, np.int64)
    nothing = np.zeros(0)
    tracks = Tracks(ids, np.zeros((0, 4)), ids, nothing, np.zeros(0, np.bool_))
    ego = Ego(motion=EgoMotion(yaw_rad_s=yaw_rad_s))
    return SeenFrame(tracks, Ranges(ids, nothing, nothing), None, ego, time_s, image=image)


@pytest.mark.slow
@pytest.mark.parametrize("factor", [1.0, 1.2])
def test_a_turn_shows_the_focal_length(factor):
    scene = make_scenario("winding", seed=700, seconds=20.0)
    renderer = Renderer(replace(scene, road_users=()), RIG)
    left = RIG.left
    camera = PinholeCamera(
        factor * left.fx_px, factor * left.fy_px, left.cx_px, left.cy_px, *left.size_px
    )
    check = MotionEvidence(camera)

    def heading_rad(time_s):
        return float(scene.road.yaw_rad(np.array(scene.ego_z_m(time_s))))

    for time_s in np.arange(0.0, 20.0, 0.1).tolist():
        yaw_rad_s = (heading_rad(time_s + 0.05) - heading_rad(time_s - 0.05)) / 0.1
        image = renderer.render(time_s) if abs(yaw_rad_s) > 0.05 and not check.evidence else None
        check.add(seen(time_s, yaw_rad_s, image))
    (first, *_) = check.evidence
    assert first.name.startswith("the turn at 0:")
    assert abs(first.value - math.log(factor)) < 2.5 * first.sigma
    assert first.sigma < 0.05


def test_straight_drives_and_small_turns_show_nothing():
    rng = np.random.default_rng(0)
    image = rng.integers(0, 255, (256, 800, 3)).astype(np.uint8)
    for yaw_rad_s in (0.0, 0.03, math.nan):
        check = MotionEvidence(RIG.left)
        for k in range(50):
            check.add(seen(0.1 * k, yaw_rad_s, image))
        assert check.evidence == ()
    check = MotionEvidence(RIG.left)
    for k in range(80):  # 5 degrees
        check.add(seen(0.1 * k, 0.1 if 10 <= k < 20 else 0.0, image if 10 <= k < 20 else None))
    assert check.evidence == ()
