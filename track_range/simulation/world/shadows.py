"""Shadows of bodies on the road: dark directly below, and a soft cast shadow to the left, away from the sun."""

from __future__ import annotations

import cv2
import numpy as np

from track_range.simulation.world.bodies.faces import Face

TEXELS_PER_M = 12  # resolution of the shadow's texture
MARGIN_M = 0.6  # margin of the texture for the soft edge
CAST = 0.45  # length of the cast shadow, to the left, relative to the body's height
UNDER, BESIDE = 205, 105  # darkness of the shadow below the body and of the cast shadow, 0 to 255


def shadow(size_hwl_m: tuple[float, float, float], *, under: float = UNDER) -> Face:
    """The shadow of a body of the given size, in its frame, 1 cm above the road."""
    height, width, length = size_hwl_m
    cast_m = CAST * height
    x, right, left = length / 2 + MARGIN_M, -width / 2 - MARGIN_M, width / 2 + MARGIN_M + cast_m
    shape = (max(4, round((left - right) * TEXELS_PER_M)), max(4, round(2 * x * TEXELS_PER_M)))
    dark = np.zeros(shape, np.float32)
    edge = round(MARGIN_M * TEXELS_PER_M)
    beside = round(cast_m * TEXELS_PER_M)
    dark[edge:-edge, edge:-edge] = BESIDE
    dark[edge + beside : -edge, edge:-edge] = under
    picture = np.zeros((*shape, 4), np.uint8)
    picture[:, :, 3] = cv2.GaussianBlur(dark, (0, 0), 0.14 * TEXELS_PER_M)
    along, down = np.array([2 * x, 0, 0]), np.array([0.0, 0.0, right - left])
    return Face(np.array([-x, -0.01, left]), along, down, picture, is_shadow=True)
