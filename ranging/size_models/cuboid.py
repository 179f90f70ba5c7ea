r"""What box an upright cuboid on the road makes in the image: the geometry behind ranging by size.

    camera o------ z            the cuboid is turned by `turn_rad` from the camera's direction of travel;
           |    ____            the ray through the middle of its box's columns meets its surface at `distance_m`:
           |   /   /| L         what is sought is where it then stands, and from that the edges of its box.
           x  /___/ |
               W            all sizes are over the focal length (tangents)

A car's box is as wide as its tail seen from behind, as its length seen from the side, and anything between, so the
width alone tells no distance; but which widths go with which heights is known once the sizes of cars are.
"""

from __future__ import annotations

from dataclasses import dataclass
from itertools import product
from typing import Any

import numpy as np
import numpy.typing as npt

_N_STEPS = 5  # of the iteration that puts the middle of the box on the ray
_N_MORE_STEPS = 2  # from where a cuboid of nearly the same size stands
_NEAREST_M = 0.3
_CORNERS = tuple(product((-0.5, 0.5), repeat=2))

Floats = npt.NDArray[np.floating[Any]]
"""Of single or double precision; what comes out has that of what goes in."""

_Pair = tuple[Floats, Floats]


@dataclass(frozen=True, slots=True)
class CuboidBox:
    """Logarithms of what the image shows, all of one shape.

    Attributes:
        log_height: of the box's height over the focal length.
        log_width: of its width over the focal length.
        log_nearness: of 1 / z of the nearest point on the ground, z in metres: where the bottom edge is.
        place_m: how far aside and ahead the cuboid's middle is, in metres (no logarithms).
    """

    log_height: Floats
    log_width: Floats
    log_nearness: Floats
    place_m: _Pair


def box_of_cuboid(
    log_hwl: Floats,
    *,
    turn_rad: Floats,
    bearing: Floats,
    distance_m: Floats,
    camera_height_m: float,
    near: CuboidBox | None = None,
) -> CuboidBox:
    """The box of cuboids with log sizes (height, width, length; 3 values, metres), for broadcast arrays of the rest.

    Args:
        log_hwl: (3,) or (3, ...) logarithms of the sizes in metres.
        turn_rad: of the long side away from the camera's axis.
        bearing: tangent of the angle of the box's middle column.
        distance_m: depth at which the ray of that column meets the surface.
        camera_height_m: above the ground that the cuboid stands on.
        near: the same for sizes that are nearly these: less is left to iterate.
    """
    height, width, length = np.exp(log_hwl)
    cos, sin = np.cos(turn_rad), np.sin(turn_rad)
    if near is None:
        depth = distance_m + 0.5 * (np.abs(cos) * length + np.abs(sin) * width)
        aside = bearing * depth
    else:
        aside, depth = near.place_m
    for _ in range(_N_STEPS if near is None else _N_MORE_STEPS):
        column, _ = _corners((aside, depth), (width, length), (cos, sin))
        aside = aside + (bearing - (column.min(axis=0) + column.max(axis=0)) / 2) * depth
        met_m = _entry((aside, depth), (width, length), (cos, sin), bearing)
        along_ray = np.clip(distance_m - met_m, -0.3 * depth, 0.3 * depth)  # a ray that misses says nothing of how far
        aside, depth = aside + bearing * along_ray, np.maximum(depth + along_ray, _NEAREST_M)
    column, nearness = _corners((aside, depth), (width, length), (cos, sin))
    nearest = nearness.max(axis=0)
    top = ((camera_height_m - height) * nearness).min(axis=0)
    log_height, log_width = np.log(camera_height_m * nearest - top), np.log(column.max(axis=0) - column.min(axis=0))
    return CuboidBox(log_height, log_width, np.log(nearest), (aside, depth))


def _corners(middle: _Pair, size: _Pair, turn: _Pair) -> _Pair:
    """(4, ...) column over the focal length and 1 / depth of the four upright edges."""
    (aside, depth), (width, length), (cos, sin) = middle, size, turn
    x = np.stack([aside + sin * i * length + cos * j * width for i, j in _CORNERS])
    z = np.stack([np.maximum(depth + cos * i * length - sin * j * width, _NEAREST_M) for i, j in _CORNERS])
    return x / z, 1.0 / z


def _entry(middle: _Pair, size: _Pair, turn: _Pair, bearing: Floats) -> Floats:
    """Depth at which the ray (bearing, 1) enters: a slab test, as in `box_surface`, seen from above."""
    (aside, depth), (width, length), (cos, sin) = middle, size, turn
    along, across = sin * bearing + cos, cos * bearing - sin
    along, across = (np.where(np.abs(part) < 1e-9, 1e-9, part) for part in (along, across))
    from_middle = sin * aside + cos * depth, cos * aside - sin * depth
    first_along = np.minimum(*((from_middle[0] + sign * length / 2) / along for sign in (-1, 1)))
    first_across = np.minimum(*((from_middle[1] + sign * width / 2) / across for sign in (-1, 1)))
    return np.asarray(np.maximum(first_along, first_across))
