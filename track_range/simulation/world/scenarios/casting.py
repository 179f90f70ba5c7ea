"""Parts of scenarios: road users, lanes of traffic without collisions, parked cars, pedestrians,
signs, roads.
"""

from collections.abc import Iterable, Sequence
from dataclasses import replace
from typing import Any

import numpy as np

from track_range.simulation.world.motion import SpeedChanges
from track_range.simulation.world.road_shape import RoadShape, Wobble
from track_range.simulation.world.scene import (
    AWAY_RAD,
    SIZE_HWL_M,
    SIZE_SPREAD,
    TOWARDS_RAD,
    RoadUser,
    Scene,
)

WOBBLE_RAD = np.radians(0.12)  # root mean square of the pitch; that of the roll is half of it
PARKED_SPACING_M = 7.5  # distance between parking spaces
TRAFFIC_TYPES = (
    ("Car", 0.8),
    ("Van", 0.12),
    ("Truck", 0.08),
)  # types of vehicles with their fractions
# from the ego lane, and between them
SIGNS_M = {"city": (7.9, 55.0), "country": (3.9, 70.0), "highway": (10.6, 90.0)}


def road_user(
    kitti_type: str,
    x_m: float,
    z_m: float,
    heading_rad: float = AWAY_RAD,
    *,
    size_factor: float = 1.0,
    **others: Any,
) -> RoadUser:
    """A road user of mean size times a factor, without id; `others` are attributes of
    `RoadUser`.
    """
    height, width, length = (np.array(SIZE_HWL_M[kitti_type]) * size_factor).tolist()
    return RoadUser(
        track_id=-1,
        kitti_type=kitti_type,
        size_hwl_m=(height, width, length),
        start_xz_m=(x_m, z_m),
        rotation_y_rad=heading_rad,
        **others,
    )


def lane(
    rng: np.random.Generator,
    *,
    x_m: float,
    speed_mps: float,
    spacing_m: float,
    from_m: float,
    until_m: float,
    heading_rad: float = AWAY_RAD,
    types: tuple[tuple[str, float], ...] = TRAFFIC_TYPES,
) -> list[RoadUser]:
    """The traffic of the lane at `x_m`, all at one speed, so that there are no collisions.

    `spacing_m` is the mean distance between vehicles, and each position, from `from_m` to `until_m`
    at time 0, varies by up to a fifth of this distance.
    """
    positions_m = np.arange(from_m, until_m, spacing_m)
    positions_m = positions_m + 0.2 * spacing_m * rng.uniform(-1, 1, len(positions_m))
    chosen = drawn(rng, types, len(positions_m))
    return [
        road_user(kitti_type, x_m, z_m, heading_rad, speed_mps=speed_mps)
        for kitti_type, z_m in zip(chosen, positions_m.tolist(), strict=True)
    ]


def oncoming(
    rng: np.random.Generator, *, speed_mps: float, until_m: float, seconds: float, **others: Any
) -> list[RoadUser]:
    """The oncoming traffic of one lane nearer than `until_m` within `seconds`; `others`: arguments
    of `lane`.
    """
    until_m += speed_mps * seconds
    return lane(
        rng, speed_mps=speed_mps, from_m=30.0, until_m=until_m, heading_rad=TOWARDS_RAD, **others
    )


def drawn(rng: np.random.Generator, fractions: Sequence[tuple[str, float]], n: int) -> list[str]:
    """Random names, drawn with the given fractions."""
    names, weights = zip(*fractions, strict=True)
    chosen: list[str] = rng.choice(names, n, p=np.array(weights) / sum(weights)).tolist()
    return chosen


def parked(
    rng: np.random.Generator, *, until_m: float, fraction: float, free_m: Sequence[float] = ()
) -> list[RoadUser]:
    """Cars and vans parked along both kerbs at slightly varying angles, except near the positions
    `free_m`.
    """
    users = []
    for x_m, heading_rad in ((6.5, AWAY_RAD), (-6.5, TOWARDS_RAD)):
        for z_m in np.arange(12.0, until_m, PARKED_SPACING_M).tolist():
            is_free = any(abs(z_m - gap_m) < 1.2 * PARKED_SPACING_M for gap_m in free_m)
            occupancy, type_draw, angle_rad = (
                rng.uniform(),
                rng.uniform(),
                float(rng.normal(0, 0.02)),
            )
            if occupancy < fraction and not is_free:
                users.append(
                    road_user(
                        "Van" if type_draw < 0.15 else "Car", x_m, z_m, heading_rad + angle_rad
                    )
                )
    return users


def walkers(
    rng: np.random.Generator, *, until_m: float, x_m: float = 9.4, spacing_m: float = 24.0
) -> list[RoadUser]:
    """Pedestrians on both pavements, `x_m` from the ego lane's centre, walking in either direction
    or waiting.
    """
    users = []
    for side in (1, -1):
        for z_m in np.arange(14.0, until_m, spacing_m) + rng.uniform(0, spacing_m):
            is_waiting, is_oncoming = rng.uniform() < 0.2, rng.uniform() < 0.5
            heading_rad = TOWARDS_RAD if is_oncoming else AWAY_RAD
            heading_rad += float(rng.normal(0, 0.8)) if is_waiting else 0.0
            speed_mps = 0.0 if is_waiting else float(rng.uniform(1.0, 1.6))
            x = side * (x_m + (0.5 if is_oncoming else -0.5))  # the two directions do not collide
            users.append(road_user("Pedestrian", x, float(z_m), heading_rad, speed_mps=speed_mps))
    return users


def signs(surroundings: str, *, until_m: float, first_m: float = 24.0) -> list[RoadUser]:
    """Traffic signs on the right-hand side, facing the traffic."""
    x_m, spacing_m = SIGNS_M[surroundings]
    positions_m = np.arange(first_m, until_m, spacing_m).tolist()
    return [road_user("TrafficSign", x_m, z_m, TOWARDS_RAD, raised_m=2.1) for z_m in positions_m]


def lights(z_m: float) -> list[RoadUser]:
    """Traffic lights on both sides of the road, facing the traffic."""
    return [road_user("TrafficLight", x_m, z_m, TOWARDS_RAD, raised_m=2.5) for x_m in (7.95, -7.95)]


def earlier(changes: SpeedChanges, by_s: float) -> SpeedChanges:
    """The speed changes shifted to earlier times, as for a vehicle ahead."""
    return tuple((time_s - by_s, speed_mps) for time_s, speed_mps in changes)


def scene_of(
    seed: int,
    rng: np.random.Generator,
    users: Iterable[RoadUser],
    ego: SpeedChanges,
    surroundings: str,
    road: RoadShape | tuple[float, float],
) -> Scene:
    """The scene of a scenario, with an ego car that wobbles on its springs.

    The road users have no ids yet, and their sizes vary around the given ones. `surroundings` is a
    key of `SURROUNDINGS`; `road` may be the lateral and vertical amplitude in m of a random road,
    with 70 to 100 % of both.
    """
    road = (
        road
        if isinstance(road, RoadShape)
        else _random_road(rng, *road, 1.6 if surroundings == "highway" else 1.0)
    )
    sized = []
    for track_id, user in enumerate(users):
        height, width, length = np.array(user.size_hwl_m) * (
            1 + SIZE_SPREAD * rng.uniform(-1, 1, 3)
        )
        sized.append(
            replace(
                user, track_id=track_id, size_hwl_m=(float(height), float(width), float(length))
            )
        )
    return Scene(
        seed=seed,
        road_users=tuple(sized),
        ego_speed_changes=ego,
        road=road,
        wobble=Wobble(pitch_rad=WOBBLE_RAD, roll_rad=WOBBLE_RAD / 2, seed=seed),
        surroundings=surroundings,
    )


def _random_road(
    rng: np.random.Generator, swing_m: float, hill_m: float, longer: float
) -> RoadShape:
    swing, hill, *phases = (
        float(number) for number in rng.uniform((0.7, 0.7, 0, 0), (1, 1, 2 * np.pi, 2 * np.pi))
    )
    return RoadShape(
        swing_m=swing_m * swing,
        swing_length_m=320.0 * longer,
        swing_phase_rad=phases[0],
        hill_m=hill_m * hill,
        hill_length_m=300.0 * longer,
        hill_phase_rad=phases[1],
    )
