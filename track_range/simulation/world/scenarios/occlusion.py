"""The scenario `occlusion`: road users behind poles, signs, fences, bushes and nearer vehicles.

At the times `reference_times_s`, each road user of a group is 6 to 50 m ahead, and its occluder is
on the ray from the camera to a point of it, at 0.3 to 0.9 of its distance:

    camera ------- occluder -------- road user        x_occluder = r x_point,  z_occluder = z_camera + r (z - z_camera)

Before and after these times the camera passes, and the occluders cover other parts. An eighth of
the road users have no occluder. A vehicle ahead in the ego lane may hide another vehicle, at the
speed of the ego vehicle.
"""

from dataclasses import dataclass, field, replace

import numpy as np

from track_range.simulation.world.motion import SpeedChanges, travelled_m
from track_range.simulation.world.scenarios.casting import drawn, road_user, scene_of
from track_range.simulation.world.scene import (
    AWAY_RAD,
    SIZE_HWL_M,
    STEP_S,
    TOWARDS_RAD,
    Obstacle,
    ObstacleKind,
    RoadUser,
    Scene,
)

FIRST_S, EVERY_S = 0.5, 2.0  # first reference time and the interval between them, s
N_PER_GROUP = 8  # number of road users, with their occluders, for each reference time
# largest number of random positions that are tried for one road user and its occluder
N_TRIALS = 40
# of the road users at their reference time; uniform on a logarithmic scale
DISTANCE_M = (6.0, 50.0)
RATIO = (0.3, 0.9)  # range of the occluder's distance relative to that of the road user
CAMERA_HEIGHT_M = 1.65  # height of the camera above the road, m
# half of the width of the strip around the ego vehicle's path that stays free of static objects, m
CORRIDOR_M = 1.8
# time before and after the reference time during which some of the people walk or ride, s
WALK_S = 1.0
# largest distance of objects from the middle of the ego lane, m: the houses are behind it
FARTHEST_ASIDE_M = 10.0
VIEW_SLOPE = 0.72  # largest x / z of a road user, in the view of a camera like KITTI's (0.86)
FREE_M = 0.35  # smallest distance between the bodies of two objects on the ground, m

USERS = (("Car", 0.5), ("Van", 0.12), ("Truck", 0.08), ("Pedestrian", 0.17), ("Cyclist", 0.13))
OCCLUDERS = (
    ("none", 0.13),
    ("pole", 0.24),
    ("sign", 0.17),
    ("fence", 0.2),
    ("bush", 0.1),
    ("vehicle", 0.16),
)
"""Types of the occluders, as for the road users (`USERS`), with their fractions."""

LEAD_FRACTION = 0.6  # fraction of drives with a vehicle ahead that hides another one
Disc = tuple[float, float, float]  # x, z and radius of a circle on the ground, m


def reference_times_s(seconds: float) -> list[float]:
    """The reference times of a drive of the given length."""
    return np.arange(FIRST_S, max(seconds, FIRST_S + 0.1), EVERY_S).tolist()


def occlusion(seed: int, seconds: float) -> Scene:
    """The scene of the scenario."""
    rng = np.random.default_rng([seed, 31])
    ego: SpeedChanges = ((0.0, float(rng.uniform(4, 11))),)
    contents = _Contents(rng)
    if rng.uniform() < LEAD_FRACTION:
        contents.add_leading(ego)
    for time_s in reference_times_s(seconds):
        for _ in range(N_PER_GROUP):
            contents.add_one(time_s, travelled_m(ego, time_s))
    surroundings = str(rng.choice(["town", "city", "country"], p=[0.5, 0.25, 0.25]))
    scene = scene_of(seed, rng, contents.users, ego, surroundings, (1.5, 0.4))
    return replace(scene, obstacles=tuple(contents.obstacles))


@dataclass(frozen=True, slots=True)
class _Target:
    """A road user to be hidden, at its reference time."""

    kitti_type: str
    x_m: float
    z_m: float
    heading_rad: float
    distance_m: float  # z of its nearest point in the camera's frame
    width_m: float  # its extent across the view


@dataclass(slots=True)
class _Contents:
    """Road users and obstacles of the scene, without overlap, and the circles on the ground that
    they occupy.
    """

    rng: np.random.Generator
    users: list[RoadUser] = field(default_factory=list)
    obstacles: list[Obstacle] = field(default_factory=list)
    occupied: list[Disc] = field(default_factory=list)

    def add_leading(self, ego: SpeedChanges) -> None:
        """Two vehicles ahead in the ego lane at the ego speed; the nearer one hides a part of the
        farther one.
        """
        near_m, ratio = float(self.rng.uniform(9, 18)), float(self.rng.uniform(0.4, 0.75))
        for types, z_m in (
            (("Car", "Car", "Van"), near_m),
            (("Car", "Van", "Truck"), near_m / ratio + 3.0),
        ):
            x_m = float(self.rng.uniform(-0.35, 0.35))
            self.users.append(road_user(str(self.rng.choice(types)), x_m, z_m, speed_changes=ego))

    def add_one(self, time_s: float, camera_z_m: float) -> None:
        """Add a road user and its occluder for a reference time; nothing if there is no room."""
        (kitti_type,), (occluder_type,) = (
            drawn(self.rng, fractions, 1) for fractions in (USERS, OCCLUDERS)
        )
        for _ in range(N_TRIALS):
            target = self._random_target(kitti_type, camera_z_m)
            placed = (
                ([], None)
                if occluder_type == "none"
                else self._occluder(occluder_type, target, camera_z_m)
            )
            is_moving = kitti_type in ("Pedestrian", "Cyclist") and self.rng.uniform() < 0.5
            speed_mps = float(self.rng.uniform(0.8, 1.6)) if is_moving else 0.0
            path = _path(target, speed_mps)
            if placed is None or not self._is_free(path, placed[0]):
                continue
            discs, occluder = placed
            self.occupied += path + discs
            if isinstance(occluder, Obstacle):
                self.obstacles.append(occluder)
            elif occluder is not None:
                self.users.append(occluder)
            self.users.append(_moving(target, speed_mps, time_s))
            return

    def _random_target(self, kitti_type: str, camera_z_m: float) -> _Target:
        rng, (_, width, length) = self.rng, SIZE_HWL_M[kitti_type]
        distance_m = float(np.exp(rng.uniform(*np.log(DISTANCE_M))))
        farthest_m = min(VIEW_SLOPE * distance_m, FARTHEST_ASIDE_M - 1.5)
        x_m = float(rng.uniform(CORRIDOR_M, max(farthest_m, CORRIDOR_M + 0.1))) * _sign(rng)
        if rng.uniform() < 0.45:
            heading_rad = (AWAY_RAD if x_m > 0 else TOWARDS_RAD) + float(rng.normal(0, 0.06))
        else:
            heading_rad = float(rng.uniform(-np.pi, np.pi))
        cos, sin = abs(np.cos(heading_rad)), abs(np.sin(heading_rad))
        across_m, along_m = float(length * cos + width * sin), float(length * sin + width * cos)
        return _Target(
            kitti_type,
            x_m,
            camera_z_m + distance_m + along_m / 2,
            heading_rad,
            distance_m,
            across_m,
        )

    def _occluder(
        self, occluder_type: str, target: _Target, camera_z_m: float
    ) -> tuple[list[Disc], Obstacle | RoadUser | None] | None:
        """Circles on the ground and the occluder on the ray to a random point of the target; None =
        impossible.
        """
        rng, ratio = self.rng, float(self.rng.uniform(*RATIO))
        is_middle = rng.uniform() < 0.55
        aside = (
            float(rng.normal(0, 0.1))
            if is_middle
            else 0.42 * float(rng.uniform(0.4, 1.0)) * _sign(rng)
        )
        if occluder_type == "vehicle":
            aside = float(rng.uniform(0.35, 0.9)) * _sign(rng)
        x_m = ratio * (target.x_m + aside * target.width_m)
        z_m = camera_z_m + ratio * target.distance_m
        if z_m - camera_z_m < 2.2:
            return None
        covered_m = float(rng.uniform(0.3, 0.95)) * SIZE_HWL_M[target.kitti_type][0]
        low_m = float(np.clip(CAMERA_HEIGHT_M - (CAMERA_HEIGHT_M - covered_m) * ratio, 0.45, 2.2))
        match occluder_type:
            case "pole":
                wide_m = float(np.exp(rng.uniform(*np.log((0.07, 0.4)))))
                high_m = low_m if rng.uniform() < 0.2 else float(rng.uniform(2.2, 6.0))
                return [(x_m, z_m, wide_m / 2)], self._obstacle(
                    "pole", (high_m, wide_m, wide_m), x_m, z_m
                )
            case "sign":
                heading_rad, raised_m = (
                    TOWARDS_RAD + float(rng.normal(0, 0.15)),
                    float(rng.uniform(0.3, 2.1)),
                )
                factor = float(rng.uniform(0.65, 1.5))
                sign = road_user(
                    "TrafficSign", x_m, z_m, heading_rad, raised_m=raised_m, size_factor=factor
                )
                return [(x_m, z_m, 0.4)], sign
            case "bush":
                wide_m = float(np.clip(rng.uniform(0.35, 1.1) * target.width_m * ratio, 0.7, 3.0))
                size_hwl_m = (low_m, float(np.clip(0.5 * wide_m, 0.3, 1.2)), wide_m)
                bush = self._obstacle("bush", size_hwl_m, x_m, z_m, float(rng.normal(0, 0.3)))
                return _discs_along(x_m, z_m, wide_m, 0.0), bush
            case "fence":
                long_m, heading_rad = float(rng.uniform(1.8, 6.0)), float(rng.uniform(-1.3, 1.3))
                fence = self._obstacle("fence", (low_m, 0.08, long_m), x_m, z_m, heading_rad)
                return _discs_along(x_m, z_m, long_m, heading_rad), fence
            case _:
                kitti_type = str(rng.choice(["Car", "Van"], p=[0.85, 0.15]))
                heading_rad = float(rng.choice([AWAY_RAD, TOWARDS_RAD, rng.uniform(-np.pi, np.pi)]))
                return [(x_m, z_m, _radius_m(kitti_type))], road_user(
                    kitti_type, x_m, z_m, heading_rad
                )

    def _obstacle(
        self,
        kind: ObstacleKind,
        size_hwl_m: tuple[float, float, float],
        x_m: float,
        z_m: float,
        heading: float = 0.0,
    ) -> Obstacle:
        return Obstacle(len(self.obstacles), kind, size_hwl_m, (x_m, z_m), heading)

    def _is_free(self, path: list[Disc], occluder: list[Disc]) -> bool:
        """Whether a road user and its occluder are beside the ego vehicle's path and touch no other
        object.
        """
        x, _, radius = np.array(path + occluder).T
        if (np.abs(x) - radius < CORRIDOR_M).any() or (np.abs(x) > FARTHEST_ASIDE_M).any():
            return False
        return _are_apart(path, occluder) and _are_apart(path + occluder, self.occupied)


def _are_apart(discs: list[Disc], others: list[Disc]) -> bool:
    if not discs or not others:
        return True
    (x, z, radius), (other_x, other_z, other_radius) = (
        np.array(discs).T[:, :, None],
        np.array(others).T[:, None],
    )
    return bool((np.hypot(x - other_x, z - other_z) > radius + other_radius + FREE_M).all())


def _radius_m(kitti_type: str) -> float:
    _, width, length = SIZE_HWL_M[kitti_type]
    return float(np.hypot(width, length)) / 2


def _path(target: _Target, speed_mps: float) -> list[Disc]:
    """Circles along the path of a road user around its reference time."""
    distances_m = speed_mps * WALK_S * np.linspace(-1, 1, 5) if speed_mps else np.zeros(1)
    cos, sin = float(np.cos(target.heading_rad)), float(np.sin(target.heading_rad))
    radius_m = _radius_m(target.kitti_type)
    return [
        (target.x_m + along_m * cos, target.z_m - along_m * sin, radius_m)
        for along_m in distances_m.tolist()
    ]


def _moving(target: _Target, speed_mps: float, time_s: float) -> RoadUser:
    """The road user that is at its position at the reference time `time_s` and moves `WALK_S`
    before and after it.
    """
    x_m, z_m = target.x_m, target.z_m
    changes: SpeedChanges = ()
    if speed_mps:
        from_s, to_s = time_s - WALK_S, time_s + WALK_S
        changes = (
            (from_s, 0.0),
            (from_s + STEP_S, speed_mps),
            (to_s - STEP_S, speed_mps),
            (to_s, 0.0),
        )
        before_m = travelled_m(changes, time_s)
        x_m -= before_m * float(np.cos(target.heading_rad))
        z_m += before_m * float(np.sin(target.heading_rad))
    return road_user(target.kitti_type, x_m, z_m, target.heading_rad, speed_changes=changes)


def _discs_along(x_m: float, z_m: float, long_m: float, heading_rad: float) -> list[Disc]:
    """Circles along a fence or bush of a given length."""
    n = max(2, int(np.ceil(long_m / 0.8)))
    along = (np.arange(n) + 0.5) / n * long_m - long_m / 2
    cos, sin = float(np.cos(heading_rad)), float(np.sin(heading_rad))
    return [(x_m + along_m * cos, z_m - along_m * sin, 0.3) for along_m in along.tolist()]


def _sign(rng: np.random.Generator) -> float:
    return 1.0 if rng.uniform() < 0.5 else -1.0
