"""Lines of the cuboids of road users in images."""

import numpy as np

from track_range.foundation.arrays import FloatArray
from track_range.ranging.world.cuboid_corners import cuboid_corners
from track_range.ranging.world.cuboids import Cuboids
from track_range.stereo.geometry.camera import PinholeCamera

# the ends of the twelve edges by number of their corners, and of a line on the ground from the
# middle (8) to the front (9)
_ENDS = np.array(
    [(i + up, (i + 1) % 4 + up) for up in (0, 4) for i in range(4)]
    + [(i, i + 4) for i in range(4)]
    + [(8, 9)]
)
_PARTS = np.linspace(0.0, 1.0, 9)[:, None]  # points of a line, which lenses bend
_NEAR_M = 0.3  # smallest distance of a point that is drawn


def cuboid_strokes(cuboids: Cuboids, camera: PinholeCamera) -> FloatArray:
    """(N, 13, 9, 2) pixels of points on the edges of cuboids and on their directions; NaN = unknown
    or behind the camera, or a direction whose front is not known.
    """
    corners = cuboid_corners(cuboids)
    middle, front = corners[:, :4].mean(axis=1), corners[:, :2].mean(axis=1)
    front[~cuboids.front_known] = np.nan
    points = np.concatenate([corners, middle[:, None], front[:, None]], axis=1)
    first, last = points[:, _ENDS].transpose(2, 0, 1, 3)
    z_m, step_m = first[..., 2], (last - first)[..., 2]
    # the part of a line that is before the camera
    with np.errstate(divide="ignore", invalid="ignore"):
        cut = np.clip((_NEAR_M - z_m) / step_m, 0.0, 1.0)
    start, end = np.where(z_m < _NEAR_M, cut, 0.0), np.where(z_m + step_m < _NEAR_M, cut, 1.0)
    start[np.maximum(z_m, z_m + step_m) < _NEAR_M] = np.nan
    part = start[..., None, None] + _PARTS * (end - start)[..., None, None]
    places = first[..., None, :] + part * (last - first)[..., None, :]
    return camera.project(places.reshape(-1, 3)).reshape(*places.shape[:3], 2)
