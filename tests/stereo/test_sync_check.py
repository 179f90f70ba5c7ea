"""A vehicle that drives towards a wall: points move outwards, which distinguishes the frames."""

from __future__ import annotations

from pathlib import Path

import cv2
import numpy as np
import pytest

from track_range.foundation.arrays import Image
from track_range.stereo.alignment.sync_check import check_sync


def views(*, zoom_per_frame: float, n: int = 4, shift_px: int = 10) -> tuple[list[Image], list[Image]]:
    """Left and right images of a textured wall, magnified by a factor from frame to frame."""
    noise = np.random.default_rng(7).normal(size=(320, 700))
    wall = cv2.normalize(cv2.GaussianBlur(noise, (0, 0), 1.5), None, 0, 255, cv2.NORM_MINMAX).astype(np.uint8)
    videos: list[list[Image]] = [[], []]
    for number in range(n):
        zoom = zoom_per_frame**number
        for frames, shift in zip(videos, (0, shift_px), strict=True):
            towards = np.array([[zoom, 0, 350 - zoom * 350 - 100 - shift], [0, zoom, 160 - zoom * 160 - 30]])
            frames.append(np.asarray(cv2.warpAffine(wall, towards, (480, 260)), np.uint8))
    return videos[0], videos[1]


def test_synchronised_and_lagging_cameras() -> None:
    left, right = views(zoom_per_frame=1.05)
    assert check_sync(left[1], right[:3]) == "synchronised"
    assert check_sync(left[1], right[1:4]) == "left lags"
    assert check_sync(left[2], right[:3]) == "right lags"


def test_static_scene_is_unknown() -> None:
    left, right = views(zoom_per_frame=1.0)
    assert check_sync(left[1], right[:3]) == "unknown"


def test_scene_without_texture_is_unknown() -> None:
    flat = np.full((260, 480, 3), 90, np.uint8)
    assert check_sync(flat, [flat] * 3) == "unknown"


@pytest.mark.parametrize("drive", ["0003", "0005"])
def test_real_drives(shared_data: Path, drive: str) -> None:
    videos = []
    for side in ("left", "right"):
        video = cv2.VideoCapture(str(shared_data / "kitti_stereo" / drive / f"{side}.mp4"))
        videos.append([np.asarray(video.read()[1], np.uint8) for _ in range(5)])
    left, right = videos
    assert check_sync(left[2], right[1:4]) == "synchronised"
    assert check_sync(left[2], right[0:3]) == "right lags"
    assert check_sync(left[2], right[2:5]) == "left lags"
