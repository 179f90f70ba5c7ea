"""The bodies of road users, by type."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from track_range.simulation.world.bodies.cars import car
from track_range.simulation.world.bodies.faces import Face, Size
from track_range.simulation.world.bodies.people import cyclist, motorcyclist, pedestrian
from track_range.simulation.world.bodies.signs import POLE_M, overhead_sign, traffic_light, traffic_sign
from track_range.simulation.world.bodies.vehicles import bus, truck, van
from track_range.simulation.world.scene import RoadUser

BUILDERS: dict[str, Callable[[np.random.Generator, Size], list[Face]]] = {
    "Car": car,
    "Van": van,
    "Truck": truck,
    "Bus": bus,
    "Pedestrian": pedestrian,
    "Cyclist": cyclist,
    "Motorcycle": motorcyclist,
    "TrafficSign": traffic_sign,
    "TrafficLight": traffic_light,
}


def body_of(user: RoadUser, seed: int) -> list[Face]:
    """The faces of a road user in its frame; its appearance depends on the seed and its track id.

    A traffic sign that is higher than a pole hangs on a gantry.
    """
    rng = np.random.default_rng([seed, 2, user.track_id])
    if user.kitti_type == "TrafficSign" and user.raised_m > POLE_M:
        return overhead_sign(rng, user.size_hwl_m, user.raised_m)
    return BUILDERS[user.kitti_type](rng, user.size_hwl_m)
