"""Images of a vehicle that approaches walls at two distances, for checks of simultaneous images."""

from __future__ import annotations

from functools import cache

import cv2
import numpy as np

from track_range.foundation.arrays import Image

SIZE_PX = (480, 260)
# magnification per frame, and disparity, of the near and the far wall
ZOOMS, DISPARITIES_PX = (1.015, 1.002), (16, 4)


@cache
def _texture(seed: int) -> Image:
    noise = np.random.default_rng(seed).normal(size=(500, 900))
    smooth = cv2.GaussianBlur(noise, (0, 0), 1.5)
    return np.asarray(cv2.normalize(smooth, np.empty(0), 0, 255, cv2.NORM_MINMAX), np.uint8)


@cache
def approach(number: int, *, is_right: bool = False) -> Image:
    """(260, 480) image of frame `number` (0 to 40): two stripes of the near wall before the far
    one."""
    walls = []
    for seed, (zoom, disparity_px) in enumerate(zip(ZOOMS, DISPARITIES_PX, strict=True)):
        scale = 0.8 * zoom**number
        x_px = 240 - scale * 450 - (disparity_px if is_right else 0)
        to_image = np.array([[scale, 0, x_px], [0, scale, 130 - scale * 250]])
        walls.append(
            cv2.warpAffine(_texture(seed), to_image, SIZE_PX, borderMode=cv2.BORDER_REFLECT)
        )
    columns = np.arange(SIZE_PX[0]) + (DISPARITIES_PX[0] if is_right else 0)
    return np.where((columns // 120 % 2 == 0)[None], walls[0], walls[1]).astype(np.uint8)
