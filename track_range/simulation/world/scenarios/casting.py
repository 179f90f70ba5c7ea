"""Parts of scenarios: road users, lanes of traffic without collisions, parked cars, pedestrians, signs, roads."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass

import numpy as np

from track_range.simulation.world.motion import LaneChange, SpeedChanges
from track_range.simulation.world.road_shape import RoadShape, Wobble
from track_range.simulation.world.scene import AWAY_RAD, SIZE_HWL_M, SIZE_SPREAD, TOWARDS_RAD, RoadUser, Scene

WOBBLE_RAD = np.radians(0.12)
"""Root mean square of the pitch; that of the roll is half of it."""

PARKED_SPACING_M = 7.5
"""Distance between parking spaces."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Part:
    """A `RoadUser` without size and id; see `RoadUser` for the attributes.

    Attributes:
        size_factor: size relative to the mean of its type.
    """

    kind: str
    x_m: float
    z_m: float
    heading_rad: float = AWAY_RAD
    speed_mps: float = 0.0
    speed_changes: SpeedChanges = ()
    lane_change: LaneChange | None = None
    raised_m: float = 0.0
    size_factor: float = 1.0


@dataclass(frozen=True, slots=True, kw_only=True)
class Flow:
    """The traffic of one lane, at one speed, so that there are no collisions.

    Attributes:
        x_m: centre of the lane.
        speed_mps: speed of all vehicles.
        spacing_m: mean distance between vehicles; each position varies by up to a fifth of it.
        heading_rad: `AWAY_RAD` or `TOWARDS_RAD`.
        kinds: (type, fraction) of vehicles.
        from_m, until_m: range of positions along the road at time 0.
    """

    x_m: float
    speed_mps: float
    spacing_m: float
    heading_rad: float = AWAY_RAD
    kinds: tuple[tuple[str, float], ...] = (("Car", 0.8), ("Van", 0.12), ("Truck", 0.08))
    from_m: float
    until_m: float

    def parts(self, rng: np.random.Generator) -> list[Part]:
        """The vehicles of the lane."""
        names, fractions = zip(*self.kinds, strict=True)
        places = np.arange(self.from_m, self.until_m, self.spacing_m)
        places = places + 0.2 * self.spacing_m * rng.uniform(-1, 1, len(places))
        chosen = rng.choice(names, len(places), p=np.array(fractions) / sum(fractions)).tolist()
        return [
            Part(kind=kind, x_m=self.x_m, z_m=z_m, heading_rad=self.heading_rad, speed_mps=self.speed_mps)
            for kind, z_m in zip(chosen, places.tolist(), strict=True)
        ]


def parked(
    rng: np.random.Generator, *, until_m: float, fraction: float = 0.6, free_m: Sequence[float] = ()
) -> list[Part]:
    """Cars and vans parked along both kerbs at slightly varying angles, except near the positions `free_m`."""
    parts = []
    for x_m, heading_rad in ((6.5, AWAY_RAD), (-6.5, TOWARDS_RAD)):
        for z_m in np.arange(12.0, until_m, PARKED_SPACING_M).tolist():
            is_free = any(abs(z_m - gap_m) < 1.2 * PARKED_SPACING_M for gap_m in free_m)
            occupancy, kind_draw, angle_rad = rng.uniform(), rng.uniform(), float(rng.normal(0, 0.02))
            if occupancy < fraction and not is_free:
                kind = "Van" if kind_draw < 0.15 else "Car"
                parts.append(Part(kind=kind, x_m=x_m, z_m=z_m, heading_rad=heading_rad + angle_rad))
    return parts


def walkers(rng: np.random.Generator, *, until_m: float, x_m: float, spacing_m: float = 24.0) -> list[Part]:
    """Pedestrians on both pavements, `x_m` from the ego lane's centre, walking in either direction or waiting."""
    parts = []
    for side in (1, -1):
        for z_m in np.arange(14.0, until_m, spacing_m) + rng.uniform(0, spacing_m):
            is_waiting, is_oncoming = rng.uniform() < 0.2, rng.uniform() < 0.5
            heading_rad = TOWARDS_RAD if is_oncoming else AWAY_RAD
            heading_rad += float(rng.normal(0, 0.8)) if is_waiting else 0.0
            speed_mps = 0.0 if is_waiting else float(rng.uniform(1.0, 1.6))
            x = side * (x_m + (0.5 if is_oncoming else -0.5))  # the two directions do not collide
            parts.append(Part(kind="Pedestrian", x_m=x, z_m=float(z_m), heading_rad=heading_rad, speed_mps=speed_mps))
    return parts


def signs(*, until_m: float, x_m: float, spacing_m: float = 55.0, first_m: float = 24.0) -> list[Part]:
    """Traffic signs on the right-hand side, facing the traffic."""
    places = np.arange(first_m, until_m, spacing_m).tolist()
    return [Part(kind="TrafficSign", x_m=x_m, z_m=z_m, heading_rad=TOWARDS_RAD, raised_m=2.1) for z_m in places]


def lights(z_m: float, *, x_m: float = 7.95) -> list[Part]:
    """Traffic lights on both sides of the road, facing the traffic."""
    return [
        Part(kind="TrafficLight", x_m=side * x_m, z_m=z_m, heading_rad=TOWARDS_RAD, raised_m=2.5) for side in (1, -1)
    ]


def cast(rng: np.random.Generator, parts: Iterable[Part], *, first_id: int = 0) -> tuple[RoadUser, ...]:
    """Road users with consecutive ids and sizes that vary around the mean of their type."""
    users = []
    for track_id, part in enumerate(parts, first_id):
        mean_m = np.array(SIZE_HWL_M[part.kind]) * part.size_factor
        height, width, length = mean_m * (1 + SIZE_SPREAD * rng.uniform(-1, 1, 3))
        users.append(
            RoadUser(
                track_id=track_id,
                kitti_type=part.kind,
                size_hwl_m=(float(height), float(width), float(length)),
                start_xz_m=(part.x_m, part.z_m),
                rotation_y_rad=part.heading_rad,
                speed_mps=part.speed_mps,
                speed_changes=part.speed_changes,
                lane_change=part.lane_change,
                raised_m=part.raised_m,
            )
        )
    return tuple(users)


def scene_of(
    seed: int, rng: np.random.Generator, parts: list[Part], ego: SpeedChanges, *, surroundings: str, road: RoadShape
) -> Scene:
    """The scene of a scenario: its road users with sizes and ids, and an ego car that wobbles on its springs."""
    return Scene(
        seed=seed,
        road_users=cast(rng, parts),
        ego_speed_changes=ego,
        road=road,
        wobble=Wobble(pitch_rad=WOBBLE_RAD, roll_rad=WOBBLE_RAD / 2, seed=seed),
        surroundings=surroundings,
    )


def random_road(rng: np.random.Generator, *, swing_m: float, hill_m: float, longer: float = 1.0) -> RoadShape:
    """A road with random phases and 70 to 100 % of the given amplitudes; `longer` is a factor of its periods."""
    swing, hill, *phases = (float(number) for number in rng.uniform((0.7, 0.7, 0, 0), (1, 1, 2 * np.pi, 2 * np.pi)))
    return RoadShape(
        swing_m=swing_m * swing,
        swing_length_m=320.0 * longer,
        swing_phase_rad=phases[0],
        hill_m=hill_m * hill,
        hill_length_m=300.0 * longer,
        hill_phase_rad=phases[1],
    )


def oncoming(rng: np.random.Generator, *, x_m: float, speed_mps: float, spacing_m: float, until_m: float) -> list[Part]:
    """The oncoming traffic of one lane."""
    flow = Flow(
        x_m=x_m, speed_mps=speed_mps, spacing_m=spacing_m, heading_rad=TOWARDS_RAD, from_m=30.0, until_m=until_m
    )
    return flow.parts(rng)


def earlier(changes: SpeedChanges, by_s: float) -> SpeedChanges:
    """The speed changes shifted to earlier times, as for a vehicle ahead."""
    return tuple((time_s - by_s, speed_mps) for time_s, speed_mps in changes)
