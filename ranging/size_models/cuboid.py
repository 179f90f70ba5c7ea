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


def box_of_cuboid(
    log_hwl: Floats,
    *,
    yaw_rad: Floats,
    bearing: Floats,
    distance_m: Floats,
    camera_height_m: float,
    start: CuboidBox | None = None,
) -> CuboidBox:
    """Projection of cuboids with log sizes (height, width, length), for broadcast arrays of the
    other arguments.

    `log_hwl`, (3,) or (3, ...), is of metres; `yaw_rad` is the angle between the long side and the
    camera's axis, `bearing` the tangent of the angle of the box's middle column, whose ray meets
    the surface at the depth `distance_m`. From a `start`, the projection of cuboids of similar
    size, fewer iterations are needed.
    """
    height, width, length = np.exp(log_hwl)
    cos, sin = np.cos(yaw_rad), np.sin(yaw_rad)
    if start is None:
        z = distance_m + 0.5 * (np.abs(cos) * length + np.abs(sin) * width)
        x = bearing * z
    else:
        x, z = start.xz_m
    for _ in range(_N_STEPS if start is None else _N_STEPS_FROM_START):
        column, _ = _corners((x, z), (width, length), (cos, sin))
        x = x + (bearing - (column.min(axis=0) + column.max(axis=0)) / 2) * z
        entry_m = _entry_depth((x, z), (width, length), (cos, sin), bearing)
        step_m = np.clip(
            distance_m - entry_m, -0.3 * z, 0.3 * z
        )  # limited: the entry of a ray that misses is arbitrary
        x, z = x + bearing * step_m, np.maximum(z + step_m, _MIN_DEPTH_M)
    column, inverse_depth = _corners((x, z), (width, length), (cos, sin))
    nearest = inverse_depth.max(axis=0)
    top = ((camera_height_m - height) * inverse_depth).min(axis=0)
    log_height, log_width = (
        np.log(camera_height_m * nearest - top),
        np.log(column.max(axis=0) - column.min(axis=0)),
    )
    return CuboidBox(log_height, log_width, np.log(nearest), (x, z))


def _corners(centre: _Pair, size: _Pair, yaw: _Pair) -> _Pair:
    """(4, ...) column divided by the focal length, and 1 / z, of the four vertical edges; `yaw` is
    (cos, sin).
    """
    (x, z), (width, length), (cos, sin) = centre, size, yaw
    corner_x = np.stack([x + sin * i * length + cos * j * width for i, j in _CORNERS])
    corner_z = np.stack(
        [np.maximum(z + cos * i * length - sin * j * width, _MIN_DEPTH_M) for i, j in _CORNERS]
    )
    return corner_x / corner_z, 1.0 / corner_z


def _entry_depth(centre: _Pair, size: _Pair, yaw: _Pair, bearing: Floats) -> Floats:
    """Depth at which the ray (bearing, 1) enters the cuboid: the slab test (Kay and Kajiya) in the
    ground plane.
    """
    (x, z), (width, length), (cos, sin) = centre, size, yaw
    along, across = sin * bearing + cos, cos * bearing - sin
    along, across = (np.where(np.abs(part) < 1e-9, 1e-9, part) for part in (along, across))
    centre_along, centre_across = sin * x + cos * z, cos * x - sin * z
    first_along = np.minimum(*((centre_along + sign * length / 2) / along for sign in (-1, 1)))
    first_across = np.minimum(*((centre_across + sign * width / 2) / across for sign in (-1, 1)))
    return np.asarray(np.maximum(first_along, first_across))
