r"""Bounding box of the projection of an upright cuboid on the road: the geometry behind ranging by
size.

    camera o------ z            The cuboid has the yaw `yaw_rad` relative to the camera's axis; the ray through the
           |    ____            middle column of its box meets its surface at `distance_m`. Its position (x, z) is
           |   /   /| L         solved for, and from that follow the edges of its box.
           x  /___/ |
               W                Image sizes are divided by the focal length (tangents).

The box of a car is as wide as its rear seen from behind, and as its length seen from the side, so
the width alone does not give a distance. But the joint distribution of width and height follows
from the sizes of cars.
"""

from dataclasses import dataclass
from itertools import product
from typing import Any

import numpy as np
import numpy.typing as npt

_N_STEPS = 5  # iterations for the position of a cuboid, from a start behind the visible surface
_N_STEPS_FROM_START = 2  # iterations for the position of a cuboid, from a cuboid of similar size
_MIN_DEPTH_M = 0.3  # smallest depth in m of a corner, to keep corners in front of the camera
# corners of the ground face in units of (length, width)
_CORNERS = tuple(product((-0.5, 0.5), repeat=2))
Floats = npt.NDArray[np.floating[Any]]  # of single or double precision, as the arguments

_Pair = tuple[Floats, Floats]


@dataclass(frozen=True, slots=True)
class CuboidBox:
    """Projection of cuboids into the image, as arrays of the same shape (...)."""

    log_height: Floats  # log of the box height divided by the focal length
    log_width: Floats  # log of the box width divided by the focal length
    # log of 1 / z of the nearest point on the ground; determines the bottom edge
    log_inverse_depth: Floats
    xz_m: _Pair  # position of the cuboid's centre, x to the right and z ahead, in metres
    inverse_depths: _Pair  # 1 / z of the nearest and of the farthest vertical edge, 1/m

    def log_height_of(self, height_m: Floats, camera_height_m: float) -> Floats:
        """Log height of the boxes of cuboids that differ only in their height, as `log_height`."""
        return _log_height(self.inverse_depths, height_m, camera_height_m)


def box_of_cuboid(
    log_hwl: Floats,
    *,
    yaw_rad: Floats,
    bearing: Floats,
    distance_m: Floats,
    camera_height_m: float,
    start: CuboidBox | None = None,
    anchor: _Pair | None = None,
    n_steps: int | None = None,
) -> CuboidBox:
    """Projection of cuboids with log sizes (height, width, length), for broadcast arrays of the
    other arguments.

    `log_hwl`, (3,) or (3, ...), is of metres; `yaw_rad` is the angle between the long side and the
    camera's axis, `bearing` the tangent of the angle of the box's middle column, whose ray meets
    the surface at the depth `distance_m`. From a `start`, the projection of cuboids of similar
    size, fewer iterations are needed. `anchor` is the bearing of another column than the middle
    one, and its place from the left edge (0) to the right one (1): of boxes that are cut. After
    `n_steps` = 3 iterations, widths are right within 0.1 % for 9 in 10 cuboids, and 0.6 % for all.
    """
    height, width, length = np.exp(log_hwl)
    cos, sin = np.cos(yaw_rad), np.sin(yaw_rad)
    at, place = (bearing, 0.5) if anchor is None else anchor
    if start is None:
        z = distance_m + 0.5 * (np.abs(cos) * length + np.abs(sin) * width)
        x = bearing * z
    else:
        x, z = start.xz_m
    size, yaw = (width, length), (cos, sin)
    corners, slabs = _corners(size, yaw), _slabs(size, yaw, bearing)
    for _ in range(n_steps or (_N_STEPS if start is None else _N_STEPS_FROM_START)):
        column, _ = _columns((x, z), corners)
        low, high = column.min(axis=0), column.max(axis=0)
        x = x + (at - (low + place * (high - low))) * z
        step_m = distance_m - _entry_depth((x, z), slabs)
        limit_m = 0.3 * z  # the entry of a ray that misses is arbitrary
        step_m = np.minimum(np.maximum(step_m, -limit_m), limit_m)
        x, z = x + bearing * step_m, np.maximum(z + step_m, _MIN_DEPTH_M)
    column, corner_z = _columns((x, z), corners)
    nearest, farthest = 1.0 / corner_z.min(axis=0), 1.0 / corner_z.max(axis=0)
    return CuboidBox(
        _log_height((nearest, farthest), height, camera_height_m),
        np.log(column.max(axis=0) - column.min(axis=0)),
        np.log(nearest),
        (x, z),
        (nearest, farthest),
    )


def _log_height(inverse_depths: _Pair, height_m: Floats, camera_height_m: float) -> Floats:
    """Log of the height of boxes divided by the focal length: the bottom edge is that of the nearest
    vertical edge, the top edge that of the farthest one if the cuboid is higher than the camera.
    """
    nearest, farthest = inverse_depths
    above_m = camera_height_m - height_m
    top = np.minimum(above_m * nearest, above_m * farthest)
    return np.asarray(np.log(camera_height_m * nearest - top))


def _corners(size: _Pair, yaw: _Pair) -> _Pair:
    """(4, ...) places of the four vertical edges from the centre, to the right and ahead; `yaw` is
    (cos, sin).
    """
    (width, length), (cos, sin) = size, yaw
    along, across = np.array(_CORNERS, width.dtype).T.reshape(2, 4, *[1] * np.ndim(cos * width))
    along, across = along * length, across * width
    return sin * along + cos * across, cos * along - sin * across


def _columns(centre: _Pair, corners: _Pair) -> _Pair:
    """(4, ...) bearings and depths of the four vertical edges."""
    depth = np.maximum(centre[1] + corners[1], _MIN_DEPTH_M)
    return (centre[0] + corners[0]) / depth, depth


def _slabs(size: _Pair, yaw: _Pair, bearing: Floats) -> tuple[tuple[Floats, Floats, Floats], ...]:
    """Of both slabs, factors of x and z of the centre for the depth at which the ray (bearing, 1)
    enters it, and what is subtracted, half its thickness along the ray.
    """
    (width, length), (cos, sin) = size, yaw
    along, across = sin * bearing + cos, cos * bearing - sin
    along, across = (np.where(np.abs(part) < 1e-9, 1e-9, part) for part in (along, across))
    return (
        (sin / along, cos / along, np.abs(length / 2 / along)),
        (cos / across, -sin / across, np.abs(width / 2 / across)),
    )


def _entry_depth(centre: _Pair, slabs: tuple[tuple[Floats, Floats, Floats], ...]) -> Floats:
    """Depth at which the ray enters the cuboid: the slab test (Kay and Kajiya) in the ground plane."""
    x, z = centre
    # the ray enters each slab at the smaller of (centre +- half) / direction
    first_along, first_across = (x * by_x + z * by_z - half for by_x, by_z, half in slabs)
    return np.asarray(np.maximum(first_along, first_across))
