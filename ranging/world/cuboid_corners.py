"""Corners of upright cuboids."""

import numpy as np

from track_range.foundation.arrays import FloatArray
from track_range.ranging.world.cuboids import Cuboids

# (8, 3) of half of the length, width and height: to the front, to the left, up
_SIGNS = np.array([(f, s, up) for up in (-1, 1) for f, s in ((1, 1), (1, -1), (-1, -1), (-1, 1))])


def cuboid_corners(cuboids: Cuboids) -> FloatArray:
    """(N, 8, 3) corners in the camera's axes (right, down, forward): the lower four, from the front
    on the left clockwise as seen from above, and the upper four; NaN = unknown.
    """
    yaw_rad = np.radians(cuboids.yaw_deg)
    sine, cosine, zero = np.sin(yaw_rad), np.cos(yaw_rad), np.zeros_like(yaw_rad)
    axes = np.array([[-sine, zero, cosine], [-cosine, zero, -sine], [zero, zero - 1, zero]])
    offsets = _SIGNS * cuboids.lwh_m[:, None] / 2
    return np.asarray(cuboids.centre_m[:, None] + np.einsum("nka,acn->nkc", offsets, axes))
