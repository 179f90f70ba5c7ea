"""Corners of upright cuboids, and the mean cuboid of a track."""

import numpy as np

from track_range.foundation.arrays import FloatArray
from track_range.ranging.world.cuboids import Cuboids

# (8, 3) of half of the length, width and height: to the front, to the left, up
_SIGNS = np.array([(f, s, up) for up in (-1, 1) for f, s in ((1, 1), (1, -1), (-1, -1), (-1, 1))])
_LEAST_M = 0.01  # standard deviation of a size that is given


def cuboid_corners(cuboids: Cuboids) -> FloatArray:
    """(N, 8, 3) corners in the camera's axes (right, down, forward): the lower four, from the front
    on the left clockwise as seen from above, and the upper four; NaN = unknown.
    """
    yaw_rad = np.radians(cuboids.yaw_deg)
    sine, cosine, zero = np.sin(yaw_rad), np.cos(yaw_rad), np.zeros_like(yaw_rad)
    axes = np.array([[-sine, zero, cosine], [-cosine, zero, -sine], [zero, zero - 1, zero]])
    offsets = _SIGNS * cuboids.lwh_m[:, None] / 2
    return np.asarray(cuboids.centre_m[:, None] + np.einsum("nka,acn->nkc", offsets, axes))


def mean_size_m(lwh_m: FloatArray, sigma_m: FloatArray) -> list[float]:
    """Length, width and height of a track by those of its frames (N, 3) and their standard
    deviations: sure ones count more.
    """
    weights = 1 / np.maximum(np.nan_to_num(sigma_m, nan=np.inf), _LEAST_M) ** 2
    weights = np.where(weights.sum(axis=0) > 0, weights, 1.0)
    return [float(mean) for mean in np.average(lwh_m, axis=0, weights=weights)]


def mean_axis_rad(yaw_rad: FloatArray) -> float:
    """The mean axis of directions (N,) that may be turned by 180 degrees, in the direction of most."""
    axis_rad = float(np.angle(np.exp(2j * yaw_rad).sum())) / 2
    return axis_rad + np.pi * (np.mean(np.cos(yaw_rad - axis_rad) < 0) > 0.5)
