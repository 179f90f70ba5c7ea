"""Scenarios of ordinary traffic; each seed gives a different drive.

town       a straight street without pitch or roll                  highway   three lanes, guard rails, 108 km/h
city       a winding street, stop and go, buses, lights, signs      cut-in    a car cuts in closely ahead, and brakes
crossing   of the demo: people and a cyclist cross the road          queue     stop and go, bumper to bumper
empty      a country road without road users                        night     the city at night, by headlights
winding    a street with a bend of 15 to 60 degrees, parked cars

The town is `scene.make_scene`.
"""

from dataclasses import replace

import numpy as np

from track_range.simulation.world.motion import LaneChange, SpeedChanges, travelled_m
from track_range.simulation.world.road_shape import RoadShape
from track_range.simulation.world.scenarios import casting
from track_range.simulation.world.scene import TOWARDS_RAD, VIEW_M, Scene

# between centres of standing cars, and of each car after the one ahead
QUEUE_SPACING_M, QUEUE_DELAY_S = 6.7, 0.8
COMFORTABLE_MPS2 = 2.5  # lateral acceleration of the ego car in the middle of a bend
_TRUCKS = (("Truck", 0.45), ("Van", 0.25), ("Car", 0.2), ("Bus", 0.1))
_FAST = (("Car", 0.85), ("Motorcycle", 0.15))


def city(seed: int, seconds: float) -> Scene:
    """A winding street with stop and go, buses, lights and signs."""
    rng = np.random.default_rng([seed, 11])
    ego: SpeedChanges = ((0, 9), (2.5, 11), (5, 11), (7.5, 6), (9, 7), (12, 11), (20, 9))
    driven_m = travelled_m(ego, seconds)
    until_m, crossing_m = driven_m + VIEW_M, driven_m + 12.0
    users = [
        casting.road_user("Car", 0.1, 19.0, speed_changes=casting.earlier(ego, 0.9)),
        casting.road_user("Motorcycle", -0.2, 34.0, speed_changes=casting.earlier(ego, 1.6)),
        casting.road_user("Bus", 3.6, 27.0, speed_mps=8.0),
        casting.road_user("Cyclist", 4.7, 15.0, speed_mps=4.5),
        *casting.lane(rng, x_m=3.5, speed_mps=8.0, spacing_m=26.0, from_m=52.0, until_m=until_m),
        *casting.oncoming(
            rng, x_m=-3.5, speed_mps=10.0, spacing_m=34.0, until_m=until_m, seconds=seconds
        ),
        *casting.parked(rng, until_m=until_m, fraction=0.5, free_m=(crossing_m,)),
        *casting.walkers(rng, until_m=until_m),
        *casting.signs("city", until_m=until_m),
        *casting.lights(crossing_m),
    ]
    return casting.scene_of(seed, rng, users, ego, "city", (5.0, 1.0))


def winding(seed: int, seconds: float) -> Scene:
    """A street with one bend of 15 to 60 degrees to either side, parked cars and traffic."""
    rng = np.random.default_rng([seed, 17])
    ego_mps = float(rng.uniform(6, 12))
    ego: SpeedChanges = (
        (0, ego_mps),
        (0.25 * seconds, ego_mps),
        (0.4 * seconds, ego_mps * float(rng.uniform(0.75, 1.0))),
        (0.6 * seconds, ego_mps * float(rng.uniform(0.75, 1.0))),
        (0.8 * seconds, ego_mps * float(rng.uniform(0.9, 1.15))),
    )
    driven_m = travelled_m(ego, seconds)
    until_m = driven_m + VIEW_M
    turn_rad = float(np.radians(np.exp(rng.uniform(*np.log((17, 60))))) * rng.choice([-1, 1]))
    # as sharp as is comfortable at this speed, and within the drive
    comfortable_m = ego_mps**2 * np.tan(abs(turn_rad) / 2) / COMFORTABLE_MPS2
    road = RoadShape(
        swing_m=float(rng.uniform(0, 1.5)),
        swing_phase_rad=float(rng.uniform(0, 2 * np.pi)),
        hill_m=float(rng.uniform(0.2, 1.0)),
        hill_phase_rad=float(rng.uniform(0, 2 * np.pi)),
        bend_rad=turn_rad,
        bend_at_m=driven_m * float(rng.uniform(0.4, 0.6)),
        bend_half_m=min(max(comfortable_m, 9.0), driven_m / 6),
    )
    users = [
        casting.road_user("Car", 0.1, 24.0, speed_changes=casting.earlier(ego, 2.0)),
        *casting.lane(
            rng, x_m=3.5, speed_mps=ego_mps, spacing_m=40.0, from_m=16.0, until_m=until_m
        ),
        *casting.oncoming(
            rng,
            x_m=-3.5,
            speed_mps=float(rng.uniform(7, 11)),
            spacing_m=float(rng.uniform(30, 45)),
            until_m=until_m,
            seconds=seconds,
        ),
        *casting.parked(rng, until_m=until_m, fraction=float(rng.uniform(0.4, 0.7))),
        *casting.walkers(rng, until_m=until_m),
        *casting.signs("city", until_m=until_m),
    ]
    return casting.scene_of(seed, rng, users, ego, "city", road)


def night(seed: int, seconds: float) -> Scene:
    """The city at night."""
    return replace(city(seed, seconds), is_night=True)


def highway(seed: int, seconds: float) -> Scene:
    """Three lanes with guard rails at about 108 km/h."""
    rng = np.random.default_rng([seed, 12])
    ego: SpeedChanges = ((0, 29), (4, 31), (10, 30), (20, 29))
    until_m = travelled_m(ego, seconds) + VIEW_M
    behind_m = -4.0 * seconds
    users = [
        casting.road_user(
            "Car", 0.1, 34.0, speed_changes=((0, 28.5), (5, 30.5), (10, 30), (20, 29))
        ),
        casting.road_user("Van", 0.0, 72.0, speed_changes=ego),
        *casting.lane(
            rng,
            x_m=3.62,
            speed_mps=24.0,
            spacing_m=38.0,
            types=_TRUCKS,
            from_m=16.0,
            until_m=until_m,
        ),
        *casting.lane(
            rng,
            x_m=-3.62,
            speed_mps=33.0,
            spacing_m=45.0,
            types=_FAST,
            from_m=behind_m,
            until_m=VIEW_M,
        ),
        *casting.oncoming(
            rng, x_m=-8.5, speed_mps=31.0, spacing_m=55.0, until_m=until_m, seconds=seconds
        ),
        *casting.oncoming(
            rng, x_m=-12.0, speed_mps=25.0, spacing_m=60.0, until_m=until_m, seconds=seconds
        ),
        *casting.signs("highway", until_m=until_m),
    ]
    return casting.scene_of(seed, rng, users, ego, "highway", (9.0, 2.2))


def cut_in(seed: int, seconds: float) -> Scene:
    """A car cuts in closely ahead on a highway, and brakes."""
    rng = np.random.default_rng([seed, 13])
    ego: SpeedChanges = ((0, 26), (3.5, 26), (6, 20.5), (9, 20.5), (12, 24))
    until_m = travelled_m(ego, seconds) + VIEW_M
    braking: SpeedChanges = ((0, 24.5), (3.5, 24.5), (6, 20), (20, 23))
    users = [
        casting.road_user(
            "Car", 3.62, 17.0, speed_changes=braking, lane_change=LaneChange(1.5, 4.0, -3.6)
        ),
        casting.road_user("Car", 0.0, 62.0, speed_changes=((0, 24), (5, 21), (20, 23))),
        casting.road_user("Truck", 3.62, 38.0, speed_mps=21.5),
        *casting.lane(
            rng,
            x_m=3.62,
            speed_mps=21.5,
            spacing_m=40.0,
            types=_TRUCKS,
            from_m=78.0,
            until_m=until_m,
        ),
        *casting.lane(
            rng,
            x_m=-3.62,
            speed_mps=29.0,
            spacing_m=50.0,
            types=_FAST,
            from_m=-6.0 * seconds,
            until_m=VIEW_M,
        ),
        *casting.oncoming(
            rng, x_m=-8.5, speed_mps=29.0, spacing_m=55.0, until_m=until_m, seconds=seconds
        ),
        *casting.signs("highway", until_m=until_m),
    ]
    return casting.scene_of(seed, rng, users, ego, "highway", (5.0, 1.5))


def crossing(seed: int, seconds: float) -> Scene:
    """The ego car stops for people and a cyclist who cross the road."""
    rng = np.random.default_rng([seed, 14])
    ego: SpeedChanges = ((0, 9), (1.2, 9), (4.0, 0), (8.5, 0), (11, 8))
    until_m = travelled_m(ego, seconds) + VIEW_M
    line_m = travelled_m(ego, 6.0) + 6.5
    people = (
        (5.2, line_m, np.pi, 1.3),
        (6.4, line_m + 1.1, np.pi, 1.35),
        (-6.0, line_m + 2.2, 0.0, 1.25),
        (-8.0, line_m + 3.3, 0.0, 1.5),
        (8.2, line_m + 4.4, np.pi, 1.2),
    )
    riding: SpeedChanges = ((4.0, 0), (5.0, 3.4), (8.4, 3.4), (9.2, 0))
    shift_m = float(rng.uniform(-0.8, 0.8))
    users = [
        *(
            casting.road_user("Pedestrian", x_m + shift_m, z_m, rad, speed_mps=mps)
            for x_m, z_m, rad, mps in people
        ),
        casting.road_user("Cyclist", -7.2, line_m + 6.2, 0.0, speed_changes=riding),
        casting.road_user("Car", 0.0, line_m + 22.0, speed_mps=9.5),
        casting.road_user(
            "Car", -3.5, line_m + 16.0, TOWARDS_RAD, speed_changes=((0, 4), (2, 0), (9, 0))
        ),
        *casting.parked(rng, until_m=until_m, fraction=0.55, free_m=(line_m, line_m + 6)),
        *casting.walkers(rng, until_m=until_m),
        *casting.lights(line_m + 9.0),
        *casting.signs("city", until_m=until_m, first_m=line_m - 3.0),
    ]
    return casting.scene_of(seed, rng, users, ego, "city", (2.0, 0.6))


def queue(seed: int, seconds: float) -> Scene:
    """Two lanes in stop and go, bumper to bumper."""
    rng = np.random.default_rng([seed, 15])
    ego: SpeedChanges = (
        (0, 3),
        (2, 0),
        (3.5, 0),
        (5, 4.5),
        (7.5, 4.5),
        (9.5, 0),
        (11, 0),
        (13, 4),
        (20, 4),
    )
    until_m = travelled_m(ego, seconds) + VIEW_M
    users = []
    for x_m, delay_s, first_m in ((0.0, 0.0, 9.5), (3.5, 1.3, 5.5)):
        number, z_m = 1, first_m
        while z_m < VIEW_M:
            changes = casting.earlier(ego, QUEUE_DELAY_S * number - delay_s)
            kitti_type = "Van" if rng.uniform() < 0.15 else "Car"
            users.append(
                casting.road_user(
                    kitti_type, x_m + float(rng.normal(0, 0.1)), z_m, speed_changes=changes
                )
            )
            number += 1
            # which the next has done already
            z_m += QUEUE_SPACING_M + travelled_m(changes, QUEUE_DELAY_S)
    users += casting.oncoming(
        rng, x_m=-3.5, speed_mps=8.0, spacing_m=32.0, until_m=until_m, seconds=seconds
    )
    users += [
        *casting.walkers(rng, until_m=until_m),
        *casting.signs("city", until_m=until_m),
        *casting.lights(34.0),
    ]
    return casting.scene_of(seed, rng, users, ego, "city", (3.0, 0.5))


def empty(seed: int, seconds: float) -> Scene:
    """A country road without road users."""
    rng = np.random.default_rng([seed, 16])
    ego: SpeedChanges = ((0, 20), (5, 24), (10, 22), (20, 20))
    users = casting.signs("country", until_m=travelled_m(ego, seconds) + VIEW_M)
    return casting.scene_of(seed, rng, users, ego, "country", (7.0, 3.0))
