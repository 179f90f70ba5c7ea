"""Two walls of different distance that the vehicle approaches: the vertical motion distinguishes
the frames."""

from __future__ import annotations

from pathlib import Path

import cv2
import numpy as np
import pytest

from tests.support.images.approach import approach
from track_range.foundation.arrays import Image
from track_range.stereo.alignment.sync_check import measured_lag


@pytest.mark.parametrize("late", [-1, 0, 1, 2])
def test_lag_of_simulated_walls(late: int) -> None:
    lag = measured_lag(approach(4), approach(5), approach(5 - late, is_right=True))
    assert lag is not None
    assert lag.is_known
    assert lag.value == pytest.approx(late, abs=0.3)
    assert round(lag.value) == late


def test_sign_changes_with_a_later_left_image() -> None:
    lag = measured_lag(approach(6), approach(5), approach(4, is_right=True))
    assert lag is not None
    assert -1.3 < lag.value < -0.7


def test_rig_that_does_not_fit_has_no_lag() -> None:
    turn = np.array([[1.0, 0.02, 3.0], [-0.02, 1.03, 6.0]])
    right = np.asarray(cv2.warpAffine(approach(5, is_right=True), turn, (480, 260)), np.uint8)
    lag = measured_lag(approach(4), approach(5), right)
    assert lag is not None
    assert lag.is_known
    assert abs(lag.value) < 0.15


@pytest.mark.parametrize("late", [0, 1])
def test_exposure_of_the_other_camera_does_not_matter(late: int) -> None:
    right = np.asarray(0.5 * approach(5 - late, is_right=True) + 20, np.uint8)
    lag = measured_lag(approach(4), approach(5), right)
    assert lag is not None
    assert lag.is_known
    assert lag.value == pytest.approx(late, abs=0.1)


def test_static_scene_is_unknown() -> None:
    noise = np.random.default_rng(3).normal(0, 2, (3, 260, 480))
    left, right = approach(5).astype(float), approach(5, is_right=True).astype(float)
    images = [
        np.clip(image, 0, 255).astype(np.uint8)
        for image in (left + noise[0], left + noise[1], right + noise[2])
    ]
    assert measured_lag(*images) is None


def test_scene_without_texture_is_unknown() -> None:
    flat = np.full((260, 480, 3), 90, np.uint8)
    assert measured_lag(flat, flat, flat) is None


def test_images_without_common_points_are_unknown() -> None:
    lag = measured_lag(
        approach(4), approach(5), np.random.default_rng(1).integers(0, 255, (260, 480), np.uint8)
    )
    assert lag is not None
    assert not lag.is_known


@pytest.mark.parametrize("drive", ["0003", "0005"])
def test_real_drives(shared_data: Path, drive: str) -> None:
    videos: list[list[Image]] = []
    for side in ("left", "right"):
        video = cv2.VideoCapture(str(shared_data / "kitti_stereo" / drive / f"{side}.mp4"))
        videos.append([np.asarray(video.read()[1], np.uint8) for _ in range(8)])
    left, right = videos
    for late, tolerance in ((0, 0.1), (1, 0.25)):
        for own, other in ((left, right), (right, left)):
            lag = measured_lag(own[4], own[5], other[5 - late])
            assert lag is not None
            assert lag.is_known
            assert lag.value == pytest.approx(late, abs=tolerance)
