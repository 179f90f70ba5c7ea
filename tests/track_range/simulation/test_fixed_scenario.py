"""The scenario of a camera that stands still: its road users keep apart, and its truth is exact."""

from itertools import pairwise

import numpy as np
import pytest

from track_range.simulation.camera.fixed_files import LINES_M, crossings, road_pixels
from track_range.simulation.world.scenarios import make_scenario
from track_range.stereo.geometry.camera import PinholeCamera

CAMERA = PinholeCamera.of_focal_length(820.0, (1280, 720))


@pytest.mark.parametrize("seed", range(4))
def test_vehicles_of_a_lane_do_not_meet_where_they_are_seen(seed):
    scene = make_scenario("fixed", seed=seed, seconds=20.0)
    assert scene.ego_z_m(20.0) == 0.0
    for time_s in np.arange(0.0, 20.0, 0.25):
        places = [(user.on_road_m(time_s), user.size_hwl_m[2]) for user in scene.road_users]
        for x_m in (0.0, -3.5):
            lane = sorted((z, length) for (x, z), length in places if x == x_m and 5 < z < 105)
            for (behind_m, first), (ahead_m, second) in pairwise(lane):
                assert ahead_m - behind_m > (first + second) / 2


def test_truth_of_crossings_is_where_the_way_meets_the_line():
    scene = make_scenario("fixed", seed=1, seconds=14.0)
    found = crossings(scene, 14.0)
    assert len(found) > 8
    for name, track_id, _, time_s, speed_mps, direction in found:
        user = next(user for user in scene.road_users if user.track_id == track_id)
        (_, before), (_, after) = user.on_road_m(time_s - 1e-3), user.on_road_m(time_s + 1e-3)
        assert (before + after) / 2 == pytest.approx(LINES_M[name], abs=0.02)
        assert abs(after - before) / 2e-3 == pytest.approx(speed_mps, abs=0.1)
        assert direction == ("up" if after > before else "down")


def test_the_road_is_in_the_image_and_farther_points_are_higher():
    scene = make_scenario("fixed", seed=2, seconds=5.0)
    near, far = road_pixels(scene, CAMERA, [(20.0, 0.0), (50.0, 0.0)])
    assert 0 < far[1] < near[1] < 720
