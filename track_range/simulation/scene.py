"""A road and who is on it: every road user's place, size, heading and class at any time, exactly.

World axes are the left camera's axes at time 0, put on the road: x right, y down, z forward, y = 0 on the asphalt.
A road user at `start` with heading `rotation_y` (KITTI's: 0 looks along x, -pi/2 along z) moves straight on:
    x(t) = x0 + speed cos(rotation_y) t        z(t) = z0 - speed sin(rotation_y) t
and the camera, `camera_height_m` above the road, moves along z with the ego speed. The road from above:

    wall | pavement | parked | oncoming | ego lane | right lane | parked | pavement | wall
       -11        -7.6     -5.25      -1.75       1.75        5.25     7.6        11      x in m
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from detection.detections import FloatArray

AWAY_RAD = -np.pi / 2
"""Heading along z: seen from behind."""

TOWARDS_RAD = np.pi / 2
"""Heading against z: oncoming."""

WALL_X_M = 11.0

SIZE_HWL_M = {
    "Car": (1.53, 1.70, 4.10),
    "Van": (2.20, 1.92, 5.08),
    "Truck": (3.30, 2.55, 9.00),
    "Pedestrian": (1.75, 0.55, 0.45),
    "Cyclist": (1.74, 0.60, 1.76),
}
"""Mean sizes by KITTI type (means of KITTI's labels; a person without the swing of arms and legs)."""

SIZE_SPREAD = 0.08
"""How far height, width and length may be from the mean, as a share of it."""


@dataclass(frozen=True, slots=True, kw_only=True)
class RoadUser:
    """One object of the scene.

    Attributes:
        track_id: its identity, from 0 as in KITTI, unique in its scene; its looks follow from it too.
        kitti_type: Car, Van, Truck, Pedestrian or Cyclist.
        size_hwl_m: height, width, length of its 3-D box.
        start_xz_m: centre of the box on the road at time 0, world axes.
        rotation_y_rad: heading, KITTI's rotation_y.
        speed_mps: along the heading.
    """

    track_id: int
    kitti_type: str
    size_hwl_m: tuple[float, float, float]
    start_xz_m: tuple[float, float]
    rotation_y_rad: float
    speed_mps: float = 0.0


@dataclass(frozen=True, slots=True, kw_only=True)
class Scene:
    """Road users on a straight road, seen from a camera that moves along it.

    Attributes:
        seed: all textures and noise follow from it.
        road_users: the objects; rows of every array below are in this order.
        ego_speed_mps: speed of the camera along z.
        camera_height_m: of the left camera above the road.
    """

    seed: int
    road_users: tuple[RoadUser, ...]
    ego_speed_mps: float = 10.0
    camera_height_m: float = 1.65

    def __post_init__(self) -> None:
        ids = [user.track_id for user in self.road_users]
        if len(set(ids)) != len(ids):
            raise ValueError(f"track ids must be unique, {sorted(ids)} got")

    def ego_z_m(self, time_s: float) -> float:
        """How far the camera has come since time 0."""
        return self.ego_speed_mps * time_s

    def location_m(self, time_s: float) -> FloatArray:
        """(N, 3) bottom centres of the 3-D boxes in the left camera's frame at that time."""
        start_m = np.array([user.start_xz_m for user in self.road_users], np.float64).reshape(-1, 2)
        moved_m = np.array([user.speed_mps for user in self.road_users]) * time_s
        heading_rad = self.rotation_y_rad()
        x = start_m[:, 0] + moved_m * np.cos(heading_rad)
        z = start_m[:, 1] - moved_m * np.sin(heading_rad) - self.ego_z_m(time_s)
        return np.stack([x, np.full_like(x, self.camera_height_m), z], axis=1)

    def size_hwl_m(self) -> FloatArray:
        """(N, 3) height, width, length."""
        return np.array([user.size_hwl_m for user in self.road_users], np.float64).reshape(-1, 3)

    def rotation_y_rad(self) -> FloatArray:
        """(N,) headings."""
        return np.array([user.rotation_y_rad for user in self.road_users], np.float64)


Placing = tuple[str, float, float, float, float]
"""KITTI type, x, z at time 0, heading, speed."""

CROSSING_Z_M = 62.0
"""Where somebody crosses the road; nobody parks there."""

TRAFFIC: tuple[Placing, ...] = (
    ("Car", 0.1, 22.0, AWAY_RAD, 9.0),  # the ego car closes in on it
    ("Van", 0.0, 68.0, AWAY_RAD, 10.5),  # draws away, largely hidden by the car before it
    ("Car", 3.3, 9.5, AWAY_RAD, 12.5),  # draws away fast, from near
    ("Truck", 3.6, 36.0, AWAY_RAD, 12.0),
    ("Car", 3.5, 62.0, AWAY_RAD, 12.5),
    ("Cyclist", 4.85, 20.0, AWAY_RAD, 4.5),  # is overtaken
)

PEOPLE: tuple[Placing, ...] = (
    ("Pedestrian", 0.2, CROSSING_Z_M, np.pi, 1.0),  # crosses to the left between two oncoming cars
    ("Pedestrian", 8.6, 14.5, AWAY_RAD, 1.4),
    ("Pedestrian", 9.4, 34.0, TOWARDS_RAD, 1.3),
    ("Pedestrian", 8.5, 44.0, 0.4, 0.0),  # waits
    ("Pedestrian", -8.6, 26.0, TOWARDS_RAD, 1.2),
    ("Pedestrian", -9.4, 26.4, TOWARDS_RAD, 1.2),
    ("Pedestrian", -8.7, 40.0, AWAY_RAD, 1.5),
)

ONCOMING_FROM_M, ONCOMING_SPACING_M, ONCOMING_SPEED_MPS = 74.0, 48.0, 11.0
PARKED_SPACING_M = 7.5
PARKED_SHARE = 0.6
"""Of the places along the kerb, how many are taken."""

VIEW_M = 110.0
"""Scenes are filled this far beyond the last place of the camera."""


def make_scene(seed: int = 0, *, seconds: float = 6.0) -> Scene:
    """A town road with traffic both ways, parked cars and people; the seed moves and sizes everything a little.

    The same vehicles and people start every scene (`TRAFFIC`, `PEOPLE`), placed so that nobody runs into anybody for
    ten seconds; oncoming and parked cars line the way for as long as the drive lasts.
    """
    rng = np.random.default_rng([seed, 1])
    until_m = 10.0 * seconds + VIEW_M
    placings = [*TRAFFIC, *PEOPLE, *_oncoming(rng, until_m + ONCOMING_SPEED_MPS * seconds), *_parked(rng, until_m)]
    users = []
    for track_id, (kitti_type, x_m, z_m, heading_rad, speed_mps) in enumerate(placings):
        height, width, length = np.array(SIZE_HWL_M[kitti_type]) * (1 + SIZE_SPREAD * rng.uniform(-1, 1, 3))
        dx_m, dz_m = rng.uniform(-1, 1, 2) * (0.08, 0.5)
        users.append(
            RoadUser(
                track_id=track_id,
                kitti_type=kitti_type,
                size_hwl_m=(float(height), float(width), float(length)),
                start_xz_m=(x_m + float(dx_m), z_m + float(dz_m)),
                rotation_y_rad=heading_rad,
                speed_mps=speed_mps * float(rng.uniform(0.98, 1.02)) if kitti_type == "Pedestrian" else speed_mps,
            )
        )
    return Scene(seed=seed, road_users=tuple(users))


def _oncoming(rng: np.random.Generator, until_m: float) -> list[Placing]:
    """Cars, and now and then a truck, one after the other in the left lane at one speed."""
    places_m = np.arange(ONCOMING_FROM_M, until_m, ONCOMING_SPACING_M)
    is_truck = rng.uniform(size=len(places_m)) < 0.3
    return [
        ("Truck" if truck else "Car", -3.5, float(z_m), TOWARDS_RAD, ONCOMING_SPEED_MPS)
        for truck, z_m in zip(is_truck, places_m, strict=True)
    ]


def _parked(rng: np.random.Generator, until_m: float) -> list[Placing]:
    """Cars and vans along both kerbs, a little askew."""
    placings: list[Placing] = []
    for x_m, heading_rad in ((6.55, AWAY_RAD), (-6.55, TOWARDS_RAD)):
        places_m = np.arange(12.0, until_m, PARKED_SPACING_M)
        places_m = places_m[np.abs(places_m - CROSSING_Z_M) > PARKED_SPACING_M / 2]
        for z_m in places_m[rng.uniform(size=len(places_m)) < PARKED_SHARE]:
            kitti_type = "Van" if rng.uniform() < 0.2 else "Car"
            placings.append((kitti_type, x_m, float(z_m), heading_rad + float(rng.normal(0, 0.02)), 0.0))
    return placings
