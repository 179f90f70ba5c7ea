"""Obstacles: static objects beside the road that are no road users: poles, fences and bushes; they have no labels."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal

ObstacleKind = Literal["pole", "fence", "bush"]
"""Kind of an obstacle."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Obstacle:
    """One obstacle of a scene.

    Attributes:
        number: number from 0, unique among the obstacles of the scene; it also determines the appearance.
        kind: kind of the obstacle.
        size_hwl_m: height, width, length of its 3-D box.
        at_xz_m: centre of the box on the road: distance to the right of the ego lane's centre, and z.
        rotation_y_rad: direction of its length as KITTI's rotation_y, relative to the road's direction.
    """

    number: int
    kind: ObstacleKind
    size_hwl_m: tuple[float, float, float]
    at_xz_m: tuple[float, float]
    rotation_y_rad: float = 0.0
