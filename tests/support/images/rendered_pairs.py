"""Pairs of a rendered drive, and what may be wrong with one of their images."""

from __future__ import annotations

from functools import cache

import cv2
import numpy as np

from track_range.foundation.arrays import Image
from track_range.simulation.render.renderer import Renderer, kitti_like_rig
from track_range.simulation.world.scene import make_scene

RIG = kitti_like_rig(width_px=620, height_px=188)
N_PAIRS = 13  # 0.1 s apart
Pairs = list[tuple[Image, Image]]


@cache
def rendered() -> tuple[tuple[Image, Image], ...]:
    """All pairs of the drive."""
    renderer = Renderer(make_scene(0, seconds=2.0), RIG)
    return tuple(
        (renderer.render(i / 10), renderer.render(i / 10, side="right")) for i in range(N_PAIRS)
    )


def warped(image: Image, matrix: np.ndarray) -> Image:
    return np.asarray(
        cv2.warpPerspective(image, matrix, (image.shape[1], image.shape[0])), np.uint8
    )


def shifted(image: Image, x_px: float, y_px: float = 0.0) -> Image:
    return warped(image, np.array([[1.0, 0.0, x_px], [0.0, 1.0, y_px], [0.0, 0.0, 1.0]]))


def turned(image: Image) -> Image:
    return np.asarray(cv2.rotate(image, cv2.ROTATE_180), np.uint8)


def mirrored(image: Image) -> Image:
    return np.asarray(cv2.flip(image, 1), np.uint8)


def of_drive(*, n: int = 7) -> Pairs:
    """The first n pairs, 0.2 s apart."""
    return list(rendered()[::2][:n])  # in this slow drive, points move enough in 0.2 s
