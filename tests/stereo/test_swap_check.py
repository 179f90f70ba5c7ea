"""Order and row offset of pairs; unknown without texture."""

from __future__ import annotations

from pathlib import Path

import cv2
import numpy as np
import pytest

from track_range.foundation.arrays import Image
from track_range.stereo.alignment.pair_checks import check_pair


def wall(*, disparity_px: int, row_offset_px: int = 0) -> tuple[Image, Image]:
    noise = np.random.default_rng(2).normal(size=(300, 600))
    image = cv2.normalize(cv2.GaussianBlur(noise, (0, 0), 2.0), None, 0, 255, cv2.NORM_MINMAX).astype(np.uint8)
    left = image[20:-20, 60:-60]
    right = image[20 - row_offset_px : 280 - row_offset_px, 60 + disparity_px : 540 + disparity_px]
    return left.copy(), right.copy()


def test_correct_and_swapped_order() -> None:
    left, right = wall(disparity_px=12)
    assert check_pair(left, right).view_order == "correct"
    swapped = check_pair(right, left)
    assert swapped.is_swapped
    assert swapped.is_conclusive
    assert swapped.negative_fraction > 0.95


@pytest.mark.parametrize("row_offset_px", [0, 3, -7])
def test_row_offset(row_offset_px: int) -> None:
    left, right = wall(disparity_px=12, row_offset_px=row_offset_px)
    check = check_pair(left, right)
    assert check.n_matches > 200
    assert check.row_offset_px == pytest.approx(row_offset_px, abs=0.05)


def test_equal_images_are_not_swapped() -> None:
    left, _ = wall(disparity_px=12)
    check = check_pair(left, left)
    assert check.view_order == "unknown"
    assert not check.is_conclusive
    assert check.negative_fraction == 0.0


def test_images_without_texture_are_unknown() -> None:
    flat = np.full((200, 300, 3), 90, np.uint8)
    check = check_pair(flat, flat)
    assert (check.n_matches, check.view_order) == (0, "unknown")
    assert np.isnan(check.row_offset_px)
    assert np.isnan(check.negative_fraction)


def test_images_of_different_scenes_are_unknown() -> None:
    rng = np.random.default_rng(3)
    left, right = (cv2.GaussianBlur(rng.integers(0, 256, (300, 500), dtype=np.uint8), (0, 0), 1.5) for _ in range(2))
    assert check_pair(left, right).view_order == "unknown"


def test_disparities_of_both_signs_are_unknown() -> None:
    left, right = wall(disparity_px=12)
    half = left.shape[0] // 2
    mixed_left, mixed_right = left.copy(), right.copy()
    mixed_left[half:], mixed_right[half:] = right[half:], left[half:]
    assert check_pair(mixed_left, mixed_right).view_order == "unknown"


def kitti_pairs(folder: Path) -> list[tuple[Image, Image]]:
    pairs = []
    for path in sorted((folder / "kitti2015" / "image_2").glob("*.png")):
        left, right = (cv2.imread(str(folder / "kitti2015" / side / path.name)) for side in ("image_2", "image_3"))
        assert left is not None
        assert right is not None
        pairs.append((left, right))
    return pairs


def video_pairs(folder: Path, *, every: int) -> list[tuple[Image, Image]]:
    videos = [cv2.VideoCapture(str(folder / f"{side}.mp4")) for side in ("left", "right")]
    pairs = []
    for index in range(10_000):
        (left_read, left), (right_read, right) = (video.read() for video in videos)
        if not (left_read and right_read):
            break
        if index % every == 0:
            pairs.append((left, right))
    return pairs


def test_kitti_2015_pairs_in_both_orders(shared_data: Path) -> None:
    pairs = kitti_pairs(shared_data)
    assert len(pairs) == 16
    for left, right in pairs:
        assert check_pair(left, right).view_order == "correct"
        assert check_pair(right, left).view_order == "swapped"


@pytest.mark.parametrize("name", ["kitti_stereo/0003", "kitti_stereo/0005", "kitti_odometry/gray51"])
def test_kitti_videos_in_both_orders(shared_data: Path, name: str) -> None:
    pairs = video_pairs(shared_data / name, every=8)
    assert len(pairs) >= 2
    for left, right in pairs:
        assert check_pair(left, right).view_order == "correct"
        assert check_pair(right, left).view_order == "swapped"
        assert abs(check_pair(left, right).row_offset_px) < 0.5
