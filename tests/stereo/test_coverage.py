"""What is missing in a set of views is said, and nothing where nothing is."""

from __future__ import annotations

import math

import numpy as np
import pytest

from tests.stereo.board_scenes import CAMERA, exact_view, pose, varied_poses
from track_range.stereo.calibration.coverage import coverage_of, lack_of_motion, varied, view_shape


def covered(poses):
    views = [exact_view(CAMERA, at, str(i)) for i, at in enumerate(poses)]
    return coverage_of(views, np.stack(poses))


def full_set():
    """Boards at nine places, far and near, tilted all ways."""
    tilts = [(30, 0, 0), (-30, 0, 0), (0, 30, 0), (0, -30, 0), (20, 20, 0), (0, 0, 0)]
    at = [(x * z, y * z) for z in (1.0,) for x in (-0.42, 0, 0.42) for y in (-0.21, 0, 0.21)]
    far = [pose(tilts[i % 6], (x, y, 1.0)) for i, (x, y) in enumerate(at)]
    return [*far, *(pose(tilt, (0, 0, 0.5)) for tilt in tilts)]


def test_a_full_set_lacks_nothing():
    found = covered(full_set())
    assert found.warnings == ()
    assert not found.is_parallel
    assert found.x_span[0] < 0.15
    assert found.x_span[1] > 0.85
    assert found.tilt_range_deg[1] == pytest.approx(30, abs=0.1)


@pytest.mark.parametrize(
    ("poses", "said"),
    [
        ([each for each in full_set() if each[0, 3] < -0.2], "hardly any corners in the right third of the image"),
        ([each for each in full_set() if each[1, 3] > 0.0], "hardly any corners in the top third of the image"),
        (full_set()[9:], "no corners near the left edge of the image: the lens terms are a guess there"),
        (full_set()[9:], "only 6 views"),
        ([pose((0, 0, 5 * i), (0, 0, 0.6)) for i in range(12)], "tilted by more than 15 degrees in 0 of 12 views"),
        ([pose((0, a, 0), (0, 0, 0.6)) for a in (-30, -20, 20, 30)], "hardly ever tilted forward and backward: do so"),
        ([pose((a, 0, 0), (0, 0, 0.6)) for a in (-30, -20, 20, 30)], "hardly ever tilted left and right: do so"),
        (full_set()[9:], "the board has the same size in all views"),
        ([pose((20, 20, 0), (0, 0, 3.0))] * 3, "the board is small in all views (6 % of the image's side at most)"),
    ],
)
def test_what_is_missing_is_said(poses, said):
    assert any(said in warning for warning in covered(poses).warnings), covered(poses).warnings


def test_parallel_boards_are_told():
    assert covered([pose((20, 0, 10 * i), (0, 0, 0.6)) for i in range(4)]).is_parallel
    assert not covered([pose((20, 0, 0), (0, 0, 0.6)), pose((28, 0, 0), (0, 0, 0.6))]).is_parallel


def test_the_shape_of_a_frontal_board():
    straight = exact_view(CAMERA, pose((0, 0, 0), (0, 0, 0.8)), "v")
    x, y, size, skew = view_shape(straight)
    assert (x, y) == (pytest.approx(315 / 640, abs=0.005), pytest.approx(183 / 360, abs=0.005))
    # 8 x 5 squares of 0.03 m at 0.8 m
    assert size == pytest.approx(math.sqrt(0.24 * 520 / 0.8 * 0.15 * 523 / 0.8 / (640 * 360)), rel=0.03)
    assert skew < 0.02
    tilted = view_shape(exact_view(CAMERA, pose((0, 40, 0), (0, 0, 0.8)), "v"))
    assert tilted[3] == pytest.approx(1 - math.cos(math.radians(40)), abs=0.05)


def test_varied_views_are_those_that_differ():
    near = [pose((0, 0, 0), (0.001 * i, 0, 0.6)) for i in range(6)]
    views = [exact_view(CAMERA, at, str(i)) for i, at in enumerate([*near, *varied_poses(3)])]
    chosen = varied(views, 4)
    assert chosen == sorted(chosen)
    assert set(chosen) >= {6, 7, 8}
    assert varied(views, 9) == list(range(9))


def test_motion_of_a_few_pixels_is_none():
    still = [exact_view(CAMERA, pose((0, 0, 0), (0.001 * i, 0, 0.6)), str(i)) for i in range(4)]
    assert lack_of_motion(still)
    assert not lack_of_motion([*still, exact_view(CAMERA, pose((0, 0, 0), (0.03, 0, 0.6)), "far")])
    assert not lack_of_motion([still[0].of_corners(np.arange(10)), still[1].of_corners(np.arange(20, 30))])
