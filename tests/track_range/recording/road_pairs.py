"""A pair of images of a wall above a road."""

from functools import cache

import cv2
import numpy as np

from track_range.stereo.geometry.camera import PinholeCamera
from track_range.stereo.geometry.rig import StereoRig

WIDTH_PX, HEIGHT_PX = 480, 260
RIG = StereoRig.rectified(PinholeCamera(400.0, 400.0, 239.5, 129.5, WIDTH_PX, HEIGHT_PX), 0.5)


@cache
def road(sign, row_px=0):
    """Image of a wall above a road: disparities of 8 px grow downwards below the middle, half of
    them per side."""
    noise = np.random.default_rng(7).normal(size=(HEIGHT_PX, 700))
    texture = cv2.normalize(
        cv2.GaussianBlur(noise, (0, 0), 1.5), None, 0, 255, cv2.NORM_MINMAX
    ).astype(np.uint8)
    shift_px = 100 + sign * np.round(
        4 + 0.1 * np.maximum(np.arange(HEIGHT_PX) - HEIGHT_PX / 2, 0)
    ).astype(int)
    image = np.stack(
        [
            row[start : start + WIDTH_PX]
            for row, start in zip(texture, shift_px.tolist(), strict=True)
        ]
    )
    return np.roll(image, row_px, axis=0)
