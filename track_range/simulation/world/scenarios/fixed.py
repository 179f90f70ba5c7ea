"""A camera on a pole beside a two-way road: vehicles at different speeds in both directions, a car that
brakes and waits, a parked one, people on the pavement and a cyclist.
"""

from dataclasses import replace

import numpy as np

from track_range.simulation.world.motion import SpeedChanges
from track_range.simulation.world.road_shape import STEADY, STRAIGHT
from track_range.simulation.world.scenarios import casting
from track_range.simulation.world.scene import AWAY_RAD, SIZE_HWL_M, TOWARDS_RAD, RoadUser, Scene
from track_range.stereo.geometry.mounting import Mounting

# part of the road that is seen, in which vehicles of one lane keep this gap, m
_SEEN_M, _GAP_M = (5.0, 105.0), 9.0
_TYPES = (("Car", 0.66), ("Van", 0.12), ("Truck", 0.1), ("Bus", 0.06), ("Motorcycle", 0.06))
_PLACE_M = 4.6  # of the pole, to the right of the middle of the right lane


def fixed(seed: int, seconds: float) -> Scene:
    """A two-way road seen from a pole of 5 to 7 m."""
    rng = np.random.default_rng([seed, 18])
    mounting = Mounting(
        yaw_deg=float(rng.uniform(4, 14)),
        pitch_deg=float(rng.uniform(11, 15)),
        roll_deg=float(rng.normal(0, 1.0)),
        y_m=-_PLACE_M,
        z_m=float(rng.uniform(5, 7)),
    )
    waiting: SpeedChanges = ((0, 9), (2.0, 9), (4.5, 0), (8.0, 0), (11.0, 10))
    users = [
        *_lane(rng, 0.0, AWAY_RAD, seconds),
        *_lane(rng, -3.5, TOWARDS_RAD, seconds),
        casting.road_user("Car", -7.4, 18.0, TOWARDS_RAD, speed_changes=waiting),
        casting.road_user("Car", -7.4, 62.0, AWAY_RAD),
        casting.road_user("Pedestrian", -10.5, 22.0, AWAY_RAD, speed_mps=1.4),
        casting.road_user("Cyclist", 2.3, 14.0, AWAY_RAD, speed_mps=4.8),
    ]
    scene = casting.scene_of(seed, rng, users, ((0.0, 0.0),), "city", STRAIGHT)
    return replace(scene, mounting=mounting, camera_height_m=mounting.z_m or 0.0, wobble=STEADY)


def _lane(
    rng: np.random.Generator, x_m: float, heading_rad: float, seconds: float
) -> list[RoadUser]:
    """Vehicles of one lane at 25 to 90 km/h, which do not come closer than a gap where they are
    seen.
    """
    users: list[RoadUser] = []
    enter_m = _SEEN_M[0] if heading_rad == AWAY_RAD else _SEEN_M[1]
    free_s = (-np.inf, -np.inf)  # when the lane is free at both ends after the last vehicle
    time_s, last_mps, last_length_m = -4.0, 1.0, 0.0
    while True:
        (kitti_type,) = casting.drawn(rng, _TYPES, 1)
        speed_mps = float(rng.uniform(7, 25))
        length_m = SIZE_HWL_M[kitti_type][2]
        gap_s = (_GAP_M + (length_m + last_length_m) / 2) / min(speed_mps, last_mps)
        span_s = (_SEEN_M[1] - _SEEN_M[0]) / speed_mps
        time_s = max(time_s + float(rng.uniform(1.0, 3.0)), free_s[0] + gap_s)
        time_s = max(time_s, free_s[1] + gap_s - span_s)
        if time_s > seconds:
            return users
        free_s, last_mps, last_length_m = (time_s, time_s + span_s), speed_mps, length_m
        along = 1.0 if heading_rad == AWAY_RAD else -1.0
        start_m = enter_m - along * speed_mps * time_s
        users.append(casting.road_user(kitti_type, x_m, start_m, heading_rad, speed_mps=speed_mps))
