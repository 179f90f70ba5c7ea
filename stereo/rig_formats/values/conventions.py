"""Conventions of programs for focal lengths and principal points, translated to pixels.

Each is a function of (4,) fx, fy, cx, cy as in the file and (2,) the width and height of its
images.
"""

from collections.abc import Callable

import numpy as np

from track_range.foundation.arrays import FloatArray

Convention = Callable[[FloatArray, FloatArray], FloatArray]


def from_centre(numbers: FloatArray, size: FloatArray) -> FloatArray:
    """Principal points relative to the middle of the image, in pixels: Agisoft Metashape."""
    return np.append(numbers[:2], numbers[2:] + size / 2)


def of_longer_side(numbers: FloatArray, size: FloatArray) -> FloatArray:
    """Fractions of the longer side, from the middle of the image: OpenSfM, OpenDroneMap."""
    return from_centre(numbers * size.max(), size)


def of_each_side(numbers: FloatArray, size: FloatArray) -> FloatArray:
    """Fractions of width and height, from the corner of the first pixel, if the principal point is
    below 1, else pixels: DSO.
    """
    if max(numbers[2:]) >= 1:
        return numbers
    return numbers * np.tile(size, 2) - (0.0, 0.0, 0.5, 0.5)
