"""The scenario `occlusion`: road users behind poles, signs, fences, bushes and nearer vehicles.

At the times `reference_times_s`, each road user of a group is 6 to 50 m ahead, and its occluder is on the ray from the
camera to a point of it, at 0.3 to 0.9 of its distance:

    camera ------- occluder -------- road user        x_occluder = r x_point,  z_occluder = z_camera + r (z - z_camera)

Before and after these times the camera passes, and the occluders cover other parts. An eighth of the road users have
no occluder. A vehicle ahead in the ego lane may hide another one, at the speed of the ego vehicle.
"""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np

from track_range.simulation.world.motion import SpeedChanges, travelled_m
from track_range.simulation.world.obstacles import Obstacle, ObstacleKind
from track_range.simulation.world.scenarios.casting import Part, random_road, scene_of
from track_range.simulation.world.scene import AWAY_RAD, SIZE_HWL_M, STEP_S, TOWARDS_RAD, Scene

FIRST_S, EVERY_S = 0.5, 2.0
"""First reference time and the interval between them, s."""

N_PER_GROUP = 8
"""Number of road users, with their occluders, for each reference time."""

N_TRIALS = 40
"""Largest number of random places that are tried for one road user and its occluder."""

DISTANCE_M = (6.0, 50.0)
"""Range of the distances of the road users at their reference time; uniform on a logarithmic scale."""

RATIO = (0.3, 0.9)
"""Range of the occluder's distance relative to that of the road user."""

CAMERA_HEIGHT_M = 1.65
"""Height of the camera above the road, m."""

CORRIDOR_M = 1.8
"""Half of the width of the strip around the ego vehicle's path that stays free of static objects, m."""

WALK_S = 1.0
"""Time before and after the reference time during which some of the people walk or ride, s."""

FARTHEST_ASIDE_M = 10.0
"""Largest distance of objects from the middle of the ego lane, m: the houses are behind it."""

VIEW_SLOPE = 0.72
"""Largest x / z of a road user, so that it is in the image of a camera with KITTI's angle of view (0.86)."""

FREE_M = 0.35
"""Smallest distance between the bodies of two objects on the ground, m."""

USERS = (("Car", 0.5), ("Van", 0.12), ("Truck", 0.08), ("Pedestrian", 0.17), ("Cyclist", 0.13))
"""Types of the road users with their shares."""

OCCLUDERS = (("none", 0.13), ("pole", 0.24), ("sign", 0.17), ("fence", 0.2), ("bush", 0.1), ("vehicle", 0.16))
"""Kinds of occluders with their shares."""

LEAD_FRACTION = 0.6
"""Fraction of drives with a vehicle ahead that hides another one."""

Disc = tuple[float, float, float]
"""x, z and radius of a circle on the ground, m."""


def reference_times_s(seconds: float) -> list[float]:
    """The reference times of a drive of the given length."""
    return np.arange(FIRST_S, max(seconds, FIRST_S + 0.1), EVERY_S).tolist()


def occlusion(seed: int, seconds: float) -> Scene:
    """The scene of the scenario."""
    rng = np.random.default_rng([seed, 31])
    ego: SpeedChanges = ((0.0, float(rng.uniform(4, 11))),)
    builder = _Builder(rng)
    if rng.uniform() < LEAD_FRACTION:
        builder.add_leading(ego)
    for time_s in reference_times_s(seconds):
        for _ in range(N_PER_GROUP):
            builder.add_one(time_s, travelled_m(ego, time_s))
    surroundings = str(rng.choice(["town", "city", "country"], p=[0.5, 0.25, 0.25]))
    road = random_road(rng, swing_m=1.5, hill_m=0.4)
    scene = scene_of(seed, rng, builder.parts, ego, surroundings=surroundings, road=road)
    return Scene(
        **{name: getattr(scene, name) for name in Scene.__slots__ if name != "obstacles"},
        obstacles=tuple(builder.obstacles),
    )


@dataclass(slots=True)
class _Place:
    """A road user at its reference time: type, x, z, heading and distance."""

    kind: str
    x_m: float
    z_m: float
    heading_rad: float
    distance_m: float

    @property
    def width_m(self) -> float:
        """Extent across the view."""
        _, width, length = SIZE_HWL_M[self.kind]
        return float(length * abs(np.cos(self.heading_rad)) + width * abs(np.sin(self.heading_rad)))

    @property
    def depth_m(self) -> float:
        """Extent along the view."""
        _, width, length = SIZE_HWL_M[self.kind]
        return float(length * abs(np.sin(self.heading_rad)) + width * abs(np.cos(self.heading_rad)))

    @property
    def radius_m(self) -> float:
        """Radius of the circle around it."""
        _, width, length = SIZE_HWL_M[self.kind]
        return float(np.hypot(width, length)) / 2


@dataclass(slots=True)
class _Builder:
    """Places road users and occluders without overlap."""

    rng: np.random.Generator
    parts: list[Part] = field(default_factory=list)
    obstacles: list[Obstacle] = field(default_factory=list)
    occupied: list[Disc] = field(default_factory=list)

    def add_leading(self, ego: SpeedChanges) -> None:
        """Two vehicles ahead in the ego lane at the ego speed; the nearer one hides part of the other."""
        near_m, ratio = float(self.rng.uniform(9, 18)), float(self.rng.uniform(0.4, 0.75))
        for kinds, z_m in ((("Car", "Car", "Van"), near_m), (("Car", "Van", "Truck"), near_m / ratio + 3.0)):
            x_m = float(self.rng.uniform(-0.35, 0.35))
            self.parts.append(Part(kind=str(self.rng.choice(kinds)), x_m=x_m, z_m=z_m, speed_changes=ego))

    def add_one(self, time_s: float, camera_z_m: float) -> None:
        """Add a road user and its occluder for a reference time; nothing if there is no room."""
        kind, occluder = (_drawn(self.rng, fractions) for fractions in (USERS, OCCLUDERS))
        for _ in range(N_TRIALS):
            place = self._random_place(kind, camera_z_m)
            placed = self._occluder(occluder, place, camera_z_m) if occluder != "none" else ([], None)
            speed_mps = self._speed_mps(kind)
            if placed is None or not self._is_free(path := _path(place, speed_mps), placed[0]):
                continue
            self.occupied += path + placed[0]
            if isinstance(placed[1], Obstacle):
                self.obstacles.append(placed[1])
            elif placed[1] is not None:
                self.parts.append(placed[1])
            self.parts.append(_part(place, speed_mps, time_s))
            return

    def _random_place(self, kind: str, camera_z_m: float) -> _Place:
        distance_m = float(np.exp(self.rng.uniform(*np.log(DISTANCE_M))))
        farthest_m = min(VIEW_SLOPE * distance_m, FARTHEST_ASIDE_M - 1.5)
        x_m = float(self.rng.uniform(CORRIDOR_M, max(farthest_m, CORRIDOR_M + 0.1))) * _sign(self.rng)
        if self.rng.uniform() < 0.45:
            heading_rad = (AWAY_RAD if x_m > 0 else TOWARDS_RAD) + float(self.rng.normal(0, 0.06))
        else:
            heading_rad = float(self.rng.uniform(-np.pi, np.pi))
        place = _Place(kind, x_m, 0.0, heading_rad, distance_m)
        place.z_m = camera_z_m + distance_m + place.depth_m / 2
        return place

    def _speed_mps(self, kind: str) -> float:
        is_moving = kind in ("Pedestrian", "Cyclist") and self.rng.uniform() < 0.5
        return float(self.rng.uniform(0.8, 1.6)) if is_moving else 0.0

    def _occluder(self, kind: str, place: _Place, camera_z_m: float) -> tuple[list[Disc], Obstacle | Part] | None:
        """Circles on the ground and the occluder on the ray to a random point of the road user; None = impossible."""
        rng, ratio = self.rng, float(self.rng.uniform(*RATIO))
        is_middle = rng.uniform() < 0.55
        aside = float(rng.normal(0, 0.1)) if is_middle else 0.42 * float(rng.uniform(0.4, 1.0)) * _sign(rng)
        if kind == "vehicle":
            aside = float(rng.uniform(0.35, 0.9)) * _sign(rng)
        x_m = ratio * (place.x_m + aside * place.width_m)
        z_m = camera_z_m + ratio * place.distance_m
        if z_m - camera_z_m < 2.2:
            return None
        height_m = SIZE_HWL_M[place.kind][0]
        covered_m = float(rng.uniform(0.3, 0.95)) * height_m
        low_m = float(np.clip(CAMERA_HEIGHT_M - (CAMERA_HEIGHT_M - covered_m) * ratio, 0.45, 2.2))
        if kind == "pole":
            wide_m = float(np.exp(rng.uniform(*np.log((0.07, 0.4)))))
            high_m = low_m if rng.uniform() < 0.2 else float(rng.uniform(2.2, 6.0))
            return [(x_m, z_m, wide_m / 2)], self._obstacle("pole", (high_m, wide_m, wide_m), (x_m, z_m))
        if kind == "sign":
            sign = Part(
                kind="TrafficSign",
                x_m=x_m,
                z_m=z_m,
                heading_rad=TOWARDS_RAD + float(rng.normal(0, 0.15)),
                raised_m=float(rng.uniform(0.3, 2.1)),
                size_factor=float(rng.uniform(0.65, 1.5)),
            )
            return [(x_m, z_m, 0.4)], sign
        if kind == "bush":
            wide_m = float(np.clip(rng.uniform(0.35, 1.1) * place.width_m * ratio, 0.7, 3.0))
            size = (low_m, float(np.clip(0.5 * wide_m, 0.3, 1.2)), wide_m)
            discs = _discs(x_m, z_m, wide_m, 0.0)
            return discs, self._obstacle("bush", size, (x_m, z_m), float(rng.normal(0, 0.3)))
        if kind == "fence":
            long_m, heading_rad = float(rng.uniform(1.8, 6.0)), float(rng.uniform(-1.3, 1.3))
            discs = _discs(x_m, z_m, long_m, heading_rad)
            return discs, self._obstacle("fence", (low_m, 0.08, long_m), (x_m, z_m), heading_rad)
        vehicle = str(rng.choice(["Car", "Van"], p=[0.85, 0.15]))
        heading_rad = float(rng.choice([AWAY_RAD, TOWARDS_RAD, rng.uniform(-np.pi, np.pi)]))
        radius_m = _Place(vehicle, x_m, z_m, heading_rad, 0.0).radius_m
        return [(x_m, z_m, radius_m)], Part(kind=vehicle, x_m=x_m, z_m=z_m, heading_rad=heading_rad)

    def _obstacle(
        self, kind: ObstacleKind, size_hwl_m: tuple[float, float, float], at: tuple[float, float], heading: float = 0.0
    ) -> Obstacle:
        return Obstacle(
            number=len(self.obstacles), kind=kind, size_hwl_m=size_hwl_m, at_xz_m=at, rotation_y_rad=heading
        )

    def _is_free(self, path: list[Disc], occluder: list[Disc]) -> bool:
        """Whether a road user on its path and its occluder are beside the ego vehicle's path and apart from all."""
        x, _, radius = np.array(path + occluder).T
        if (np.abs(x) - radius < CORRIDOR_M).any() or (np.abs(x) > FARTHEST_ASIDE_M).any():
            return False
        return _are_apart(path, occluder) and _are_apart(path + occluder, self.occupied)


def _are_apart(discs: list[Disc], others: list[Disc]) -> bool:
    """Whether the circles of one list are apart from those of the other."""
    if not discs or not others:
        return True
    (x, z, radius), (other_x, other_z, other_radius) = np.array(discs).T[:, :, None], np.array(others).T[:, None]
    return bool((np.hypot(x - other_x, z - other_z) > radius + other_radius + FREE_M).all())


def _path(place: _Place, speed_mps: float) -> list[Disc]:
    """Circles along the path of a road user around its reference time."""
    ways_m = speed_mps * WALK_S * np.linspace(-1, 1, 5) if speed_mps else np.zeros(1)
    cos, sin = float(np.cos(place.heading_rad)), float(np.sin(place.heading_rad))
    return [(place.x_m + way_m * cos, place.z_m - way_m * sin, place.radius_m) for way_m in ways_m.tolist()]


def _part(place: _Place, speed_mps: float, time_s: float) -> Part:
    """The road user, which is at its place at the reference time `time_s` and moves `WALK_S` before and after it."""
    x_m, z_m = place.x_m, place.z_m
    changes: SpeedChanges = ()
    if speed_mps:
        from_s, to_s = time_s - WALK_S, time_s + WALK_S
        changes = ((from_s, 0.0), (from_s + STEP_S, speed_mps), (to_s - STEP_S, speed_mps), (to_s, 0.0))
        way_m = travelled_m(changes, time_s)
        x_m -= way_m * float(np.cos(place.heading_rad))
        z_m += way_m * float(np.sin(place.heading_rad))
    return Part(kind=place.kind, x_m=x_m, z_m=z_m, heading_rad=place.heading_rad, speed_changes=changes)


def _discs(x_m: float, z_m: float, long_m: float, heading_rad: float) -> list[Disc]:
    """Circles along a fence or bush of a given length."""
    n = max(2, int(np.ceil(long_m / 0.8)))
    along = (np.arange(n) + 0.5) / n * long_m - long_m / 2
    cos, sin = float(np.cos(heading_rad)), float(np.sin(heading_rad))
    return [(x_m + a * cos, z_m - a * sin, 0.3) for a in along.tolist()]


def _drawn(rng: np.random.Generator, fractions: tuple[tuple[str, float], ...]) -> str:
    names, weights = zip(*fractions, strict=True)
    return str(rng.choice(names, p=np.array(weights) / sum(weights)))


def _sign(rng: np.random.Generator) -> float:
    return 1.0 if rng.uniform() < 0.5 else -1.0
