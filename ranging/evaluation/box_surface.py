r"""Depth at which a ray first meets an upright 3-D box: the ground truth for distances.

        z                 Box in KITTI's convention: bottom centre (X, Y, Z), height h along -y, length l along the x
ray   / |____             axis and width w along the z axis of the box, rotated by rotation_y about the camera's y
 \   / /    /|            axis. In the axes of the box, the intersection is a slab test (Kay and Kajiya 1986).
  \ / /____/ |
   o x the ray meets the front face first: distance_m is the z of that point
"""

from __future__ import annotations

import numpy as np

from track_range.foundation.arrays import FloatArray


def surface_distance_m(
    rays: FloatArray, location_m: FloatArray, *, size_hwl_m: FloatArray, rotation_y_rad: FloatArray
) -> FloatArray:
    """(N,) z at which each ray from the camera first meets its box; NaN = it misses the box, or starts inside it.

    Args:
        rays: (N, 3) directions with z = 1, so that the parameter of a ray is the depth.
        location_m: (N, 3) bottom centre of each box in the camera's frame.
        size_hwl_m: (N, 3) height, width, length.
        rotation_y_rad: (N,) yaw.
    """
    origin = _in_box_axes(-location_m, rotation_y_rad)
    direction = _in_box_axes(rays, rotation_y_rad)
    height, width, length = size_hwl_m.T
    low = np.stack([-length / 2, -height, -width / 2], axis=1)
    high = np.stack([length / 2, np.zeros_like(height), width / 2], axis=1)
    safe = np.where(np.abs(direction) < 1e-12, 1e-12, direction)  # no division by 0 for rays parallel to a face
    first, second = (low - origin) / safe, (high - origin) / safe
    enters = np.minimum(first, second).max(axis=1)
    leaves = np.maximum(first, second).min(axis=1)
    return np.where((enters <= leaves) & (enters > 0), enters, np.nan)


def _in_box_axes(vectors: FloatArray, rotation_y_rad: FloatArray) -> FloatArray:
    """(N, 3) vectors rotated from the camera's axes to those of each box, by -rotation_y about y."""
    cos, sin = np.cos(rotation_y_rad), np.sin(rotation_y_rad)
    x, y, z = vectors.T
    return np.stack([cos * x - sin * z, y, sin * x + cos * z], axis=1)
