"""Warnings about missing views, none for a complete set."""

from __future__ import annotations

import math

import numpy as np
import pytest

from tests.support.images.board_scenes import CAMERA, exact_view, pose, varied_poses
from track_range.stereo.calibration.coverage import (
    coverage_of,
    is_static,
    most_different,
    view_shape,
)


def covered(poses):
    views = [exact_view(CAMERA, at, str(i)) for i, at in enumerate(poses)]
    return coverage_of(views, np.stack(poses))


def full_set():
    """Boards at nine positions, far and near, with tilts in all directions."""
    tilts = [(30, 0, 0), (-30, 0, 0), (0, 30, 0), (0, -30, 0), (20, 20, 0), (0, 0, 0)]
    at = [(x * z, y * z) for z in (1.0,) for x in (-0.42, 0, 0.42) for y in (-0.21, 0, 0.21)]
    far = [pose(tilts[i % 6], (x, y, 1.0)) for i, (x, y) in enumerate(at)]
    return [*far, *(pose(tilt, (0, 0, 0.5)) for tilt in tilts)]


def test_complete_set_has_no_warnings():
    result = covered(full_set())
    assert result.warnings == ()
    assert not result.is_parallel
    assert result.x_span[0] < 0.15
    assert result.x_span[1] > 0.85
    assert result.tilt_range_deg[1] == pytest.approx(30, abs=0.1)


@pytest.mark.parametrize(
    ("poses", "key_word"),
    [
        ([pose for pose in full_set() if pose[0, 3] < -0.2], "right third"),
        ([pose for pose in full_set() if pose[1, 3] > 0.0], "top third"),
        (full_set()[9:], "left edge"),
        (full_set()[9:], "6 views"),
        ([pose((0, 0, 5 * i), (0, 0, 0.6)) for i in range(12)], "0 of 12 views"),
        ([pose((0, a, 0), (0, 0, 0.6)) for a in (-30, -20, 20, 30)], "forward and backward"),
        ([pose((a, 0, 0), (0, 0, 0.6)) for a in (-30, -20, 20, 30)], "left and right"),
        (full_set()[9:], "same size"),
        ([pose((20, 20, 0), (0, 0, 3.0))] * 3, "6 %"),
    ],
)
def test_warnings(poses, key_word):
    assert any(key_word in warning for warning in covered(poses).warnings), covered(poses).warnings


def test_parallel_boards():
    assert covered([pose((20, 0, 10 * i), (0, 0, 0.6)) for i in range(4)]).is_parallel
    assert not covered([pose((20, 0, 0), (0, 0, 0.6)), pose((28, 0, 0), (0, 0, 0.6))]).is_parallel


def test_the_shape_of_a_frontal_board():
    x, y, size, skew = view_shape(exact_view(CAMERA, pose((0, 0, 0), (0, 0, 0.8)), "v"))
    assert (x, y) == (pytest.approx(315 / 640, abs=0.005), pytest.approx(183 / 360, abs=0.005))
    # 8 x 5 squares of 0.03 m at 0.8 m
    assert size == pytest.approx(
        math.sqrt(0.24 * 520 / 0.8 * 0.15 * 523 / 0.8 / (640 * 360)), rel=0.03
    )
    assert skew < 0.02
    tilted = view_shape(exact_view(CAMERA, pose((0, 40, 0), (0, 0, 0.8)), "v"))
    assert tilted[3] == pytest.approx(1 - math.cos(math.radians(40)), abs=0.05)


def test_most_different_views():
    near = [pose((0, 0, 0), (0.001 * i, 0, 0.6)) for i in range(6)]
    views = [exact_view(CAMERA, at, str(i)) for i, at in enumerate([*near, *varied_poses(3)])]
    chosen = most_different(views, 4)
    assert chosen == sorted(chosen)
    assert set(chosen) >= {6, 7, 8}
    assert most_different(views, 9) == list(range(9))


def test_is_static():
    still = [exact_view(CAMERA, pose((0, 0, 0), (0.001 * i, 0, 0.6)), str(i)) for i in range(4)]
    assert is_static(still)
    assert not is_static([*still, exact_view(CAMERA, pose((0, 0, 0), (0.03, 0, 0.6)), "far")])
    assert not is_static(
        [still[0].of_corners(np.arange(10)), still[1].of_corners(np.arange(20, 30))]
    )
