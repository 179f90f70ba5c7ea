"""Who takes part: single road users, rows of traffic that never meet, parked cars, and what stands beside the road."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass

import numpy as np

from track_range.simulation.world.motion import LaneChange, SpeedChanges
from track_range.simulation.world.scene import AWAY_RAD, SIZE_HWL_M, SIZE_SPREAD, TOWARDS_RAD, RoadUser

PARKED_SPACING_M = 7.5


@dataclass(frozen=True, slots=True, kw_only=True)
class Part:
    """A road user to be: as `RoadUser`, before it has a size and an identity."""

    kind: str
    x_m: float
    z_m: float
    heading_rad: float = AWAY_RAD
    speed_mps: float = 0.0
    speed_changes: SpeedChanges = ()
    lane_change: LaneChange | None = None
    raised_m: float = 0.0


@dataclass(frozen=True, slots=True, kw_only=True)
class Flow:
    """One lane's traffic, all at one speed, so that nobody runs into anybody.

    Attributes:
        x_m: the lane's middle.
        speed_mps: of all of them.
        spacing_m: mean distance from one to the next; each is up to a fifth of it off.
        heading_rad: AWAY or TOWARDS.
        kinds: (kind, share) of vehicles.
        from_m, until_m: places at time 0.
    """

    x_m: float
    speed_mps: float
    spacing_m: float
    heading_rad: float = AWAY_RAD
    kinds: tuple[tuple[str, float], ...] = (("Car", 0.8), ("Van", 0.12), ("Truck", 0.08))
    from_m: float
    until_m: float

    def parts(self, rng: np.random.Generator) -> list[Part]:
        """Its vehicles."""
        names, shares = zip(*self.kinds, strict=True)
        places = np.arange(self.from_m, self.until_m, self.spacing_m)
        places = places + 0.2 * self.spacing_m * rng.uniform(-1, 1, len(places))
        chosen = rng.choice(names, len(places), p=np.array(shares) / sum(shares)).tolist()
        return [
            Part(kind=kind, x_m=self.x_m, z_m=z_m, heading_rad=self.heading_rad, speed_mps=self.speed_mps)
            for kind, z_m in zip(chosen, places.tolist(), strict=True)
        ]


def parked(rng: np.random.Generator, *, until_m: float, share: float = 0.6, free_m: Sequence[float] = ()) -> list[Part]:
    """Cars and vans along both kerbs, a little askew; nobody parks at `free_m`."""
    parts = []
    for x_m, heading_rad in ((6.5, AWAY_RAD), (-6.5, TOWARDS_RAD)):
        for z_m in np.arange(12.0, until_m, PARKED_SPACING_M).tolist():
            is_free = any(abs(z_m - at_m) < 1.2 * PARKED_SPACING_M for at_m in free_m)
            taken, kind_draw, askew = rng.uniform(), rng.uniform(), float(rng.normal(0, 0.02))
            if taken < share and not is_free:
                kind = "Van" if kind_draw < 0.15 else "Car"
                parts.append(Part(kind=kind, x_m=x_m, z_m=z_m, heading_rad=heading_rad + askew))
    return parts


def walkers(rng: np.random.Generator, *, until_m: float, x_m: float, spacing_m: float = 24.0) -> list[Part]:
    """People on both pavements, `x_m` from the middle, walking either way or waiting."""
    parts = []
    for side in (1, -1):
        for z_m in np.arange(14.0, until_m, spacing_m) + rng.uniform(0, spacing_m):
            waits, towards = rng.uniform() < 0.2, rng.uniform() < 0.5
            heading_rad = (TOWARDS_RAD if towards else AWAY_RAD) + (float(rng.normal(0, 0.8)) if waits else 0.0)
            speed_mps = 0.0 if waits else float(rng.uniform(1.0, 1.6))
            x = side * (x_m + (0.5 if towards else -0.5))  # those who meet pass each other
            parts.append(Part(kind="Pedestrian", x_m=x, z_m=float(z_m), heading_rad=heading_rad, speed_mps=speed_mps))
    return parts


def signs(*, until_m: float, x_m: float, spacing_m: float = 55.0, first_m: float = 24.0) -> list[Part]:
    """Traffic signs on the right, their fronts to the traffic."""
    places = np.arange(first_m, until_m, spacing_m).tolist()
    return [Part(kind="TrafficSign", x_m=x_m, z_m=z_m, heading_rad=TOWARDS_RAD, raised_m=2.1) for z_m in places]


def lights(z_m: float, *, x_m: float = 7.95) -> list[Part]:
    """Traffic lights on both sides of the road, their fronts to the traffic."""
    return [
        Part(kind="TrafficLight", x_m=side * x_m, z_m=z_m, heading_rad=TOWARDS_RAD, raised_m=2.5) for side in (1, -1)
    ]


def cast(rng: np.random.Generator, parts: Iterable[Part], *, first_id: int = 0) -> tuple[RoadUser, ...]:
    """Road users with identities in the order given, their sizes spread about their kind's mean."""
    users = []
    for track_id, part in enumerate(parts, first_id):
        height, width, length = np.array(SIZE_HWL_M[part.kind]) * (1 + SIZE_SPREAD * rng.uniform(-1, 1, 3))
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
