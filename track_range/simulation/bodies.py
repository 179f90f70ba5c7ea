"""A road user's body: which builder makes which KITTI type."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from track_range.simulation.faces import Face
from track_range.simulation.people import cyclist, pedestrian
from track_range.simulation.scene import RoadUser
from track_range.simulation.vehicles import car, truck, van

BUILDERS: dict[str, Callable[[np.random.Generator, tuple[float, float, float]], list[Face]]] = {
    "Car": car,
    "Van": van,
    "Truck": truck,
    "Pedestrian": pedestrian,
    "Cyclist": cyclist,
}


def body_of(user: RoadUser, seed: int) -> list[Face]:
    """The faces of a road user in its own axes; its looks follow from the seed and its track id."""
    rng = np.random.default_rng([seed, 2, user.track_id])
    return BUILDERS[user.kitti_type](rng, user.size_hwl_m)
