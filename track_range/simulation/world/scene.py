"""Scene: a road and its road users, with exact position, size, heading and type at any time.

World axes are the left camera's axes at time 0, shifted to the road: x right, y down, z forward, y = 0 on the asphalt.
A road user at `start` with heading `rotation_y` (KITTI's: 0 along x, -pi/2 along z) moves in a straight line:
    x(t) = x0 + speed cos(rotation_y) t        z(t) = z0 - speed sin(rotation_y) t
unless its speed or lane changes. The camera, `camera_height_m` above the road, moves along z with the ego speed. On a
winding road (`road_shape.py`), x counts from the centre of the ego lane. The town's road from above:

    wall | pavement | parked | oncoming | ego lane | right lane | parked | pavement | wall
       -11        -7.6     -5.25      -1.75       1.75        5.25     7.6        11      x in m
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Literal

import numpy as np

from track_range.foundation.arrays import FloatArray
from track_range.simulation.world import road_shape
from track_range.simulation.world.motion import (
    LaneChange,
    SpeedChanges,
    Time,
    speed_at_mps,
    travelled_m,
)
from track_range.stereo.geometry.mounting import Mounting

AWAY_RAD = -np.pi / 2  # heading along z: seen from behind
TOWARDS_RAD = np.pi / 2  # heading against z: oncoming

SIZE_HWL_M = {
    "Car": (1.53, 1.70, 4.10),
    "Van": (2.20, 1.92, 5.08),
    "Truck": (3.30, 2.55, 9.00),
    "Pedestrian": (1.75, 0.55, 0.45),
    "Cyclist": (1.74, 0.60, 1.76),
    "Bus": (3.10, 2.55, 11.50),
    "Motorcycle": (1.60, 0.75, 2.10),
    "TrafficSign": (0.75, 0.75, 0.06),
    "TrafficLight": (0.90, 0.32, 0.30),
}
"""Mean sizes by type (means of KITTI's labels; a person without the swing of arms and legs; the
last four, which KITTI lacks, as built: a city bus, a motorcycle with its rider, a sign's plate, a
light's housing)."""

STEP_S = 1e-3  # time step for numerical derivatives
SIZE_SPREAD = 0.08  # largest relative deviation of height, width and length from the mean


@dataclass(frozen=True, slots=True, kw_only=True)
class RoadUser:
    """One object of the scene."""

    track_id: int  # id from 0 as in KITTI, unique in the scene; it also determines the appearance
    kitti_type: str  # a key of `SIZE_HWL_M`
    size_hwl_m: tuple[float, float, float]  # height, width, length of the 3-D box
    # centre of the box on the road at time 0: right of the ego lane's centre, and z
    start_xz_m: tuple[float, float]
    rotation_y_rad: float  # heading as KITTI's rotation_y, relative to the road's direction
    speed_mps: float = 0.0  # speed along the heading
    # (time, speed) pairs, used instead of `speed_mps`; empty = constant speed
    speed_changes: SpeedChanges = ()
    lane_change: LaneChange | None = None  # a lateral move; None = none
    raised_m: float = 0.0  # height of the 3-D box above the road

    def on_road_m(self, time_s: Time) -> tuple[Time, Time]:
        """Position at one or more times: distance to the right of the ego lane's centre, and z."""
        distance_m = travelled_m(self.speed_changes or ((0.0, self.speed_mps),), time_s)
        moved_m = self.lane_change.moved_m(time_s) if self.lane_change else 0.0
        x_m, z_m = self.start_xz_m
        cos, sin = float(np.cos(self.rotation_y_rad)), float(np.sin(self.rotation_y_rad))
        return x_m + distance_m * cos + moved_m, z_m - distance_m * sin

    def heading_rad(self, time_s: Time) -> FloatArray | float:
        """Heading at one or more times, including the rotation during a lane change."""
        if self.lane_change is None:
            return self.rotation_y_rad
        before, after = (self.on_road_m(time_s + step_s) for step_s in (-STEP_S, STEP_S))
        across, ahead = after[0] - before[0], after[1] - before[1]
        return np.where(ahead == 0, self.rotation_y_rad, np.arctan2(-ahead, across))


ObstacleKind = Literal["pole", "fence", "bush"]


@dataclass(frozen=True, slots=True)
class Obstacle:
    """A static object beside the road that is no road user and has no labels."""

    # number from 0, unique among the obstacles of the scene; it also determines the appearance
    number: int
    kind: ObstacleKind
    size_hwl_m: tuple[float, float, float]  # height, width, length of its 3-D box
    # centre of the box on the road: distance to the right of the ego lane's centre, and z
    at_xz_m: tuple[float, float]
    # direction of its length as KITTI's rotation_y, relative to the road's direction
    rotation_y_rad: float = 0.0


@dataclass(frozen=True, slots=True, kw_only=True)
class Scene:
    """Road users on a road, and a camera that moves along it."""

    seed: int  # random seed of textures and noise
    road_users: tuple[RoadUser, ...]  # the objects; the rows of all arrays have this order
    ego_speed_mps: float = 10.0  # speed of the camera along the road
    # (time, speed) pairs, used instead of `ego_speed_mps`; empty = constant speed
    ego_speed_changes: SpeedChanges = ()
    camera_height_m: float = 1.65  # height of the left camera above the road
    camera_pitch_rad: float = 0.0  # pitch of the left camera relative to the ego car, positive = up
    # of the left camera in the ego car, whose reference point is above the ego lane's centre
    mounting: Mounting = road_shape.AHEAD
    road: road_shape.RoadShape = road_shape.STRAIGHT
    wobble: road_shape.Wobble = road_shape.STEADY
    surroundings: str = "town"  # a key of `surroundings.SURROUNDINGS`
    is_night: bool = False  # whether headlights and lamps light the scene instead of the sun
    obstacles: tuple[Obstacle, ...] = ()

    def __post_init__(self) -> None:
        ids = [user.track_id for user in self.road_users]
        if len(set(ids)) != len(ids):
            raise ValueError(f"road_users: expected unique track ids, got {sorted(ids)}")

    def with_car_sizes(self, factor: float) -> Scene:
        """The scene with all cars `factor` times as high, wide and long."""
        users = []
        for user in self.road_users:
            height, width, length = user.size_hwl_m
            size_hwl_m = (factor * height, factor * width, factor * length)
            users.append(replace(user, size_hwl_m=size_hwl_m) if user.kitti_type == "Car" else user)
        return replace(self, road_users=tuple(users))

    def ego_z_m(self, time_s: Time) -> Time:
        """Z of the camera at one or more times."""
        return travelled_m(self.ego_speed_changes or ((0.0, self.ego_speed_mps),), time_s)

    def speed_mps(self, time_s: float) -> float:
        """Speed of the camera along the road at a time."""
        along_z_mps = speed_at_mps(self.ego_speed_changes or ((0.0, self.ego_speed_mps),), time_s)
        return along_z_mps * self.road.stretch(self.ego_z_m(time_s))

    def pose(self, time_s: float) -> road_shape.CameraPose:
        """Pose of the left camera at a time."""
        pitch_rad, roll_rad = self.wobble.pitch_roll_rad(time_s)
        pitch_roll_rad = (pitch_rad + self.camera_pitch_rad, roll_rad)
        z_m = self.ego_z_m(time_s)
        return road_shape.pose_on_road(
            self.road,
            z_m,
            height_m=self.camera_height_m,
            pitch_roll_rad=pitch_roll_rad,
            mounting=self.mounting,
        )

    def location_m(self, time_s: float) -> FloatArray:
        """(N, 3) bottom centres of the 3-D boxes in the left camera's frame at a time."""
        raised_m = np.array([user.raised_m for user in self.road_users])
        return self._location_m(time_s, self._on_road_m(time_s), raised_m)

    def size_hwl_m(self) -> FloatArray:
        """(N, 3) height, width, length."""
        return np.array([user.size_hwl_m for user in self.road_users], np.float64).reshape(-1, 3)

    def rotation_y_rad(self, time_s: float = 0.0) -> FloatArray:
        """(N,) headings as rotations about y in the left camera's frame, without pitch and roll."""
        _, z = self._on_road_m(time_s)
        camera_rad = self.road.yaw_rad(np.array(self.ego_z_m(time_s))) - np.radians(
            self.mounting.yaw_deg
        )
        return np.asarray(self._headings_rad(time_s) + self.road.yaw_rad(z) - camera_rad)

    def rotations(self, time_s: float) -> FloatArray:
        """(N, 3, 3) rotations from the frames of road users to the left camera's, with slope and
        camera rotation.
        """
        _, z = self._on_road_m(time_s)
        return self._rotations(time_s, z, self._headings_rad(time_s))

    def obstacle_poses(self, time_s: float) -> tuple[FloatArray, FloatArray]:
        """(M, 3) bottom centres of the obstacles and (M, 3, 3) rotations to the left camera's frame
        at a time.
        """
        on_road_m = (
            np.array([obstacle.at_xz_m for obstacle in self.obstacles], np.float64).reshape(-1, 2).T
        )
        headings = np.array([obstacle.rotation_y_rad for obstacle in self.obstacles], np.float64)
        location_m = self._location_m(time_s, on_road_m, np.zeros(len(headings)))
        return location_m, self._rotations(time_s, on_road_m[1], headings)

    def _location_m(self, time_s: float, on_road_m: FloatArray, raised_m: FloatArray) -> FloatArray:
        """(N, 3) positions in the left camera's frame of (2, N) positions across and along the
        road.
        """
        pose = self.pose(time_s)
        across, z = on_road_m
        world = np.stack([self.road.x_m(z, across), self.road.y_m(z) - raised_m, z], axis=1)
        return np.asarray((world - pose.position_m) @ pose.camera_from_world.T)

    def _rotations(self, time_s: float, z_m: FloatArray, headings_rad: FloatArray) -> FloatArray:
        level = road_shape.yaw_rotation(headings_rad + self.road.yaw_rad(z_m))
        return np.asarray(
            self.pose(time_s).camera_from_world
            @ road_shape.slope_rotation(self.road.climb_rad(z_m))
            @ level
        )

    def _headings_rad(self, time_s: float) -> FloatArray:
        return np.array([user.heading_rad(time_s) for user in self.road_users], np.float64)

    def _on_road_m(self, time_s: float) -> FloatArray:
        """(2, N) positions across and along the road."""
        return (
            np.array([user.on_road_m(time_s) for user in self.road_users], np.float64)
            .reshape(-1, 2)
            .T
        )


TownUser = tuple[str, float, float, float, float]  # KITTI type, x and z at time 0, heading, speed
CROSSING_Z_M = 62.0  # position of a pedestrian who crosses the road, where there are no parked cars

TRAFFIC: tuple[TownUser, ...] = (
    ("Car", 0.1, 22.0, AWAY_RAD, 9.0),  # the ego car closes in on it
    ("Van", 0.0, 68.0, AWAY_RAD, 10.5),  # draws away, largely hidden by the car before it
    ("Car", 3.3, 9.5, AWAY_RAD, 12.5),  # draws away fast, from near
    ("Truck", 3.6, 36.0, AWAY_RAD, 12.0),
    ("Car", 3.5, 62.0, AWAY_RAD, 12.5),
    ("Cyclist", 4.85, 20.0, AWAY_RAD, 4.5),  # is overtaken
)

PEOPLE: tuple[TownUser, ...] = (
    ("Pedestrian", 0.2, CROSSING_Z_M, np.pi, 1.0),  # crosses to the left between two oncoming cars
    ("Pedestrian", 8.6, 14.5, AWAY_RAD, 1.4),
    ("Pedestrian", 9.4, 34.0, TOWARDS_RAD, 1.3),
    ("Pedestrian", 8.5, 44.0, 0.4, 0.0),  # waits
    ("Pedestrian", -8.6, 26.0, TOWARDS_RAD, 1.2),
    ("Pedestrian", -9.4, 26.4, TOWARDS_RAD, 1.2),
    ("Pedestrian", -8.7, 40.0, AWAY_RAD, 1.5),
)

# of the first, at time 0; between them
ONCOMING_FROM_M, ONCOMING_SPACING_M, ONCOMING_SPEED_MPS = 74.0, 48.0, 11.0
# distance between parking spaces, and fraction of them that are occupied
PARKED_SPACING_M, PARKED_FRACTION = 7.5, 0.6
VIEW_M = 110.0  # distance beyond the last camera position up to which scenes contain objects


def make_scene(seed: int = 0, seconds: float = 6.0) -> Scene:
    """A town road with traffic in both directions, parked cars and people; the seed varies
    positions and sizes.

    Every scene starts with the same vehicles and people (`TRAFFIC`, `PEOPLE`), placed so that there
    are no collisions for ten seconds; oncoming and parked cars continue for the whole drive.
    """
    rng = np.random.default_rng([seed, 1])
    until_m = 10.0 * seconds + VIEW_M
    oncoming = _oncoming(rng, until_m + ONCOMING_SPEED_MPS * seconds)
    users = []
    for track_id, (kitti_type, x_m, z_m, heading_rad, speed_mps) in enumerate(
        [*TRAFFIC, *PEOPLE, *oncoming, *_parked(rng, until_m)]
    ):
        height, width, length = np.array(SIZE_HWL_M[kitti_type]) * (
            1 + SIZE_SPREAD * rng.uniform(-1, 1, 3)
        )
        dx_m, dz_m = rng.uniform(-1, 1, 2) * (0.08, 0.5)
        users.append(
            RoadUser(
                track_id=track_id,
                kitti_type=kitti_type,
                size_hwl_m=(float(height), float(width), float(length)),
                start_xz_m=(x_m + float(dx_m), z_m + float(dz_m)),
                rotation_y_rad=heading_rad,
                speed_mps=speed_mps * float(rng.uniform(0.98, 1.02))
                if kitti_type == "Pedestrian"
                else speed_mps,
            )
        )
    return Scene(seed=seed, road_users=tuple(users))


def _oncoming(rng: np.random.Generator, until_m: float) -> list[TownUser]:
    """Cars and some trucks at equal distances in the left lane, all at the same speed."""
    positions_m = np.arange(ONCOMING_FROM_M, until_m, ONCOMING_SPACING_M)
    is_truck = rng.uniform(size=len(positions_m)) < 0.3
    return [
        ("Truck" if truck else "Car", -3.5, float(z_m), TOWARDS_RAD, ONCOMING_SPEED_MPS)
        for truck, z_m in zip(is_truck, positions_m, strict=True)
    ]


def _parked(rng: np.random.Generator, until_m: float) -> list[TownUser]:
    """Cars and vans parked along both kerbs at slightly varying angles."""
    users: list[TownUser] = []
    for x_m, heading_rad in ((6.55, AWAY_RAD), (-6.55, TOWARDS_RAD)):
        positions_m = np.arange(12.0, until_m, PARKED_SPACING_M)
        positions_m = positions_m[np.abs(positions_m - CROSSING_Z_M) > PARKED_SPACING_M / 2]
        for z_m in positions_m[rng.uniform(size=len(positions_m)) < PARKED_FRACTION]:
            kitti_type = "Van" if rng.uniform() < 0.2 else "Car"
            users.append(
                (kitti_type, x_m, float(z_m), heading_rad + float(rng.normal(0, 0.02)), 0.0)
            )
    return users
