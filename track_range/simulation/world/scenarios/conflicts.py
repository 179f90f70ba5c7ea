"""Scenarios after the shapes of Euro NCAP's tests of collision warnings, and their harmless twins.

rear-stationary   a standing vehicle in the lane              curve-parked    parked cars straight ahead, in a bend
rear-slower       a vehicle at a third to a half of the speed following       a vehicle ahead at a time gap of 2 s
rear-braking      a vehicle ahead at 1.6 to 2.4 s brakes      oncoming        oncoming traffic in its lane, in bends
crossing-adult    a person crosses from either side           overhead-sign   a gantry with a sign above the lane
crossing-child    a child crosses from behind parked cars
crossing-car      a vehicle comes out of a side road          yielding        vehicles stop at side roads

The left column ends in a contact 5.5 to 7.5 s after the start; the seed varies speeds, the lateral
overlap (at least half of the narrower one for vehicles, the middle half of the ego vehicle's width
for people), the time of contact, the type of vehicle, the road and other traffic. The ego vehicle
does not brake before the contact. In the crash, the ego vehicle takes the speed of what it hits
along the road within `CRASH_S`, and both brake to a standstill; a person stops where the contact
happens. `contacts.py` has the exact time.
"""

from dataclasses import replace

import numpy as np

from track_range.simulation.world.contacts import CAMERA_TO_FRONT_M, EGO_HWL_M, first_contact
from track_range.simulation.world.motion import SpeedChanges, speed_at_mps, travelled_m
from track_range.simulation.world.road_shape import RoadShape
from track_range.simulation.world.scenarios import casting
from track_range.simulation.world.scene import (
    AWAY_RAD,
    SIZE_HWL_M,
    TOWARDS_RAD,
    VIEW_M,
    RoadUser,
    Scene,
)

# earliest and latest contact; sizes, which vary too, shift it by some hundredths of a second
CONTACT_S = (5.5, 7.5)
# until the ego vehicle has the speed of what it hits, and after it
CRASH_S, CRASH_DECELERATION_MPS2 = 0.1, 6.0
# height of a child relative to an adult: 1.2 m, a child of seven, as Euro NCAP's child dummy
CHILD_FACTOR = 0.68
WALK_M = 18.0  # distance that a person on the pavement walks at most during a drive, m

_TYPES, _FRACTIONS = ("Car", "Van", "Truck", "Bus", "Motorcycle"), (0.55, 0.15, 0.12, 0.08, 0.1)


def rear_stationary(seed: int, seconds: float) -> Scene:
    """The ego vehicle runs into a standing vehicle."""
    rng = np.random.default_rng([seed, 21])
    ego_mps, contact_s = float(rng.uniform(9, 16)), float(rng.uniform(*CONTACT_S))
    return _rear(seed, rng, seconds, ego_mps, ((0.0, 0.0),), contact_s, ("city", "country"))


def rear_slower(seed: int, seconds: float) -> Scene:
    """The ego vehicle runs into a vehicle at a third to a half of its speed."""
    rng = np.random.default_rng([seed, 22])
    ego_mps, contact_s = float(rng.uniform(14, 23)), float(rng.uniform(*CONTACT_S))
    target = ((0.0, ego_mps * float(rng.uniform(0.33, 0.5))),)
    return _rear(seed, rng, seconds, ego_mps, target, contact_s, ("country", "highway"))


def rear_braking(seed: int, seconds: float) -> Scene:
    """The ego vehicle runs into a vehicle that brakes to a standstill."""
    rng = np.random.default_rng([seed, 23])
    ego_mps, contact_s = float(rng.uniform(11, 18)), float(rng.uniform(*CONTACT_S))
    gap_m, deceleration = ego_mps * float(rng.uniform(1.6, 2.4)), float(rng.uniform(2.5, 4.5))
    stop_s = ego_mps / deceleration
    closed_m = ego_mps * stop_s / 2
    taken_s = (
        np.sqrt(2 * gap_m / deceleration)
        if gap_m < closed_m
        else stop_s + (gap_m - closed_m) / ego_mps
    )
    brake_s = contact_s - float(taken_s)
    target = ((0.0, ego_mps), (brake_s, ego_mps), (brake_s + stop_s, 0.0))
    return _rear(seed, rng, seconds, ego_mps, target, contact_s, ("city", "country", "highway"))


def crossing_adult(seed: int, seconds: float) -> Scene:
    """The ego vehicle hits a person who crosses from either side."""
    rng = np.random.default_rng([seed, 24])
    ego_mps, contact_s = float(rng.uniform(6, 14)), float(rng.uniform(*CONTACT_S))
    side = 1 if rng.uniform() < 0.5 else -1
    person = _crossing_person(rng, side, ego_mps, contact_s, speed_mps=float(rng.uniform(1.3, 2.1)))
    until_m = ego_mps * seconds + VIEW_M
    users = [
        person,
        *(_oncoming_traffic(rng, until_m, seconds) if side > 0 else ()),
        *_pavements(rng, person.start_xz_m[1], until_m, 0.5, (-12.0, 0.0, 6.0)),
    ]
    return _with_crash(
        casting.scene_of(seed, rng, users, ((0.0, ego_mps),), "city", (3.0, 0.8)), seconds
    )


def crossing_child(seed: int, seconds: float) -> Scene:
    """The ego vehicle hits a child who crosses from behind parked cars."""
    rng = np.random.default_rng([seed, 25])
    ego_mps, contact_s = float(rng.uniform(6, 11)), float(rng.uniform(*CONTACT_S))
    side = 1 if rng.uniform() < 0.7 else -1
    speed_mps = float(rng.uniform(1.25, 1.55))
    child = _crossing_person(
        rng, side, ego_mps, contact_s, speed_mps=speed_mps, size_factor=CHILD_FACTOR
    )
    z_m, until_m = child.start_xz_m[1], ego_mps * seconds + VIEW_M
    nearest = "Van" if rng.uniform() < 0.4 else "Car"
    hiding = [
        casting.road_user(kitti_type, 6.4 * side, z_m + by_m, AWAY_RAD if side > 0 else TOWARDS_RAD)
        for kitti_type, by_m in ((nearest, -3.6), ("Car", -10.0), ("Car", 3.8))
    ]
    others = _pavements(rng, z_m, until_m, 0.6, (-12.0, -4.0, 4.0))
    traffic = _oncoming_traffic(rng, until_m, seconds) if side > 0 else []
    users = [child, *hiding, *traffic, *others]
    return _with_crash(
        casting.scene_of(seed, rng, users, ((0.0, ego_mps),), "city", (3.0, 0.8)), seconds
    )


def crossing_car(seed: int, seconds: float) -> Scene:
    """The ego vehicle hits a vehicle that comes out of a side road, across or half along it."""
    rng = np.random.default_rng([seed, 33])
    ego_mps, contact_s = float(rng.uniform(9, 15)), float(rng.uniform(*CONTACT_S))
    kitti_type, angle_rad, side = _from_side_road(rng)
    speed_mps = float(rng.uniform(4, 9))
    across_mps, along_mps = speed_mps * np.cos(angle_rad), speed_mps * np.sin(angle_rad)
    _, width_m, length_m = SIZE_HWL_M[kitti_type]
    half_m = (length_m * abs(np.sin(angle_rad)) + width_m * np.cos(angle_rad)) / 2
    z_m = (ego_mps - along_mps) * contact_s + CAMERA_TO_FRONT_M + half_m
    hit_m = float(rng.uniform(-0.25, 0.25)) * EGO_HWL_M[1] + side * length_m / 4
    heading_rad = np.pi - angle_rad if side > 0 else angle_rad
    vehicle = casting.road_user(
        kitti_type,
        hit_m + side * across_mps * contact_s,
        z_m,
        -heading_rad,
        speed_mps=speed_mps,
    )
    until_m = ego_mps * seconds + VIEW_M
    crossing_m = z_m + along_mps * contact_s
    users = [
        vehicle,
        *_pavements(rng, crossing_m, until_m, 0.5, (-12.0, -6.0, 0.0, 6.0, 12.0)),
    ]
    scene = casting.scene_of(seed, rng, users, ((0.0, ego_mps),), "city", (2.0, 0.8))
    return _with_crash(scene, seconds)


def yielding(seed: int, seconds: float) -> Scene:
    """Vehicles come out of side roads, and brake to a standstill at their mouths."""
    rng = np.random.default_rng([seed, 34])
    ego_mps = float(rng.uniform(9, 15))
    until_m = ego_mps * seconds + VIEW_M
    users, free_m = [], []
    for passing_s in np.arange(float(rng.uniform(3, 5)), seconds + 2, 4.0).tolist():
        kitti_type, angle_rad, side = _from_side_road(rng)
        speed_mps, deceleration = float(rng.uniform(3, 7)), float(rng.uniform(1.5, 3.0))
        stop_s = speed_mps / deceleration
        brake_s = passing_s - float(rng.uniform(0.5, 2.5)) - stop_s
        stopping = ((0.0, speed_mps), (brake_s, speed_mps), (brake_s + stop_s, 0.0))
        driven_m = travelled_m(stopping, brake_s + stop_s)
        # its front is beside the lane, 0.7 to 1.7 m from the ego vehicle
        stop_m = EGO_HWL_M[1] / 2 + float(rng.uniform(0.7, 1.7)) + SIZE_HWL_M[kitti_type][2] / 2
        heading_rad = np.pi - angle_rad if side > 0 else angle_rad
        z_m = ego_mps * passing_s + CAMERA_TO_FRONT_M
        users.append(
            casting.road_user(
                kitti_type,
                side * (stop_m + driven_m * float(np.cos(angle_rad))),
                z_m - driven_m * float(np.sin(angle_rad)),
                -heading_rad,
                speed_changes=stopping,
            )
        )
        free_m += [z_m + by_m for by_m in (-12.0, -6.0, 0.0, 6.0, 12.0)]
    users += [
        *casting.parked(rng, until_m=until_m, fraction=0.5, free_m=free_m),
        *casting.signs("city", until_m=until_m),
    ]
    return casting.scene_of(seed, rng, users, ((0.0, ego_mps),), "city", (2.0, 0.8))


def curve_parked(seed: int, seconds: float) -> Scene:
    """A winding street with parked cars that are straight ahead in its bends."""
    rng = np.random.default_rng([seed, 26])
    ego_mps = float(rng.uniform(7, 11))
    until_m = ego_mps * seconds + VIEW_M
    parked_m = float(rng.uniform(3.6, 6.2))
    users = []
    for x_m, heading_rad in ((parked_m, AWAY_RAD), (-6.3, TOWARDS_RAD)):
        for z_m in np.arange(float(rng.uniform(6, 14)), until_m, 7.5).tolist():
            kitti_type = str(rng.choice(["Car", "Van"], p=[0.8, 0.2]))
            if rng.uniform() < 0.85:
                users.append(
                    casting.road_user(kitti_type, x_m + float(rng.normal(0, 0.1)), z_m, heading_rad)
                )
    users += [
        *casting.walkers(rng, until_m=until_m, x_m=9.6),
        *casting.signs("city", until_m=until_m),
    ]
    road = RoadShape(
        swing_m=float(rng.uniform(8, 13)),
        swing_length_m=float(rng.uniform(170, 230)),
        swing_phase_rad=float(rng.uniform(0, 2 * np.pi)),
        hill_m=0.5,
        hill_phase_rad=float(rng.uniform(0, 2 * np.pi)),
    )
    return casting.scene_of(seed, rng, users, ((0.0, ego_mps),), "city", road)


def oncoming_traffic(seed: int, seconds: float) -> Scene:
    """A winding country road with oncoming traffic in the oncoming lane."""
    rng = np.random.default_rng([seed, 27])
    ego_mps, other_mps = float(rng.uniform(11, 22)), float(rng.uniform(10, 24))
    until_m = ego_mps * seconds + VIEW_M
    traffic = casting.oncoming(
        rng,
        x_m=-3.5,
        speed_mps=other_mps,
        spacing_m=float(rng.uniform(28, 50)),
        types=(("Car", 0.6), ("Truck", 0.15), ("Van", 0.1), ("Bus", 0.05), ("Motorcycle", 0.1)),
        until_m=until_m,
        seconds=seconds,
    )
    users = [*traffic, *casting.signs("country", until_m=until_m)]
    return casting.scene_of(seed, rng, users, ((0.0, ego_mps),), "country", (9.0, 2.0))


def overhead_sign(seed: int, seconds: float) -> Scene:
    """A highway with signs on gantries above the ego lane."""
    rng = np.random.default_rng([seed, 28])
    ego_mps = float(rng.uniform(16, 30))
    until_m = ego_mps * seconds + VIEW_M
    users = [
        casting.road_user(
            "TrafficSign",
            float(rng.normal(0, 0.6)),
            float(z_m),
            TOWARDS_RAD,
            raised_m=float(rng.uniform(5.0, 5.8)),
            size_factor=float(rng.uniform(3.2, 4.4)),
        )
        for z_m in np.arange(float(rng.uniform(35, 60)), until_m, float(rng.uniform(60, 90)))
    ]
    types = (("Car", 0.7), ("Truck", 0.3))
    users += casting.lane(
        rng, x_m=3.62, speed_mps=ego_mps, spacing_m=45.0, types=types, from_m=20.0, until_m=until_m
    )
    users += _fast_oncoming(rng, until_m, seconds)
    return casting.scene_of(seed, rng, users, ((0.0, ego_mps),), "highway", (6.0, 2.0))


def following(seed: int, seconds: float) -> Scene:
    """A vehicle ahead at a time gap of 2 s, whose slowly changing speed the ego vehicle follows."""
    rng = np.random.default_rng([seed, 29])
    surroundings = str(rng.choice(["city", "country", "highway"]))
    mean_mps = float(rng.uniform(9, 14) if surroundings == "city" else rng.uniform(14, 28))
    ego = _slow_changes(rng, mean_mps, seconds)
    kitti_type = str(rng.choice(_TYPES, p=_FRACTIONS))
    z_m = travelled_m(ego, 2.0) + CAMERA_TO_FRONT_M + SIZE_HWL_M[kitti_type][2] / 2
    lead = casting.road_user(
        kitti_type, float(rng.normal(0, 0.2)), z_m, speed_changes=casting.earlier(ego, 2.0)
    )
    until_m = travelled_m(ego, seconds) + VIEW_M
    users = [lead, *_other_traffic(rng, surroundings, until_m, seconds)]
    return casting.scene_of(seed, rng, users, ego, surroundings, (4.0, 1.2))


def _rear(
    seed: int,
    rng: np.random.Generator,
    seconds: float,
    ego_mps: float,
    target: SpeedChanges,
    contact_s: float,
    roads: tuple[str, ...],
) -> Scene:
    """A scene in which the ego vehicle runs into the rear of a vehicle with the given speeds."""
    kitti_type = str(rng.choice(_TYPES, p=_FRACTIONS))
    _, width_m, length_m = SIZE_HWL_M[kitti_type]
    most_m = (width_m + EGO_HWL_M[1]) / 2 - 0.5 * min(width_m, EGO_HWL_M[1])
    x_m = float(np.clip(rng.normal(0, 0.35), -most_m, most_m))
    z_m = ego_mps * contact_s + CAMERA_TO_FRONT_M + length_m / 2 - travelled_m(target, contact_s)
    surroundings = str(rng.choice(roads))
    users = [
        casting.road_user(kitti_type, x_m, z_m, speed_changes=target),
        *_other_traffic(rng, surroundings, ego_mps * seconds + VIEW_M, seconds),
    ]
    return _with_crash(
        casting.scene_of(seed, rng, users, ((0.0, ego_mps),), surroundings, (4.0, 1.2)), seconds
    )


def _crossing_person(
    rng: np.random.Generator,
    side: int,
    ego_mps: float,
    contact_s: float,
    *,
    speed_mps: float,
    size_factor: float = 1.0,
) -> RoadUser:
    """A person who walks from the right (`side` 1) or left (-1) and meets the front of the ego
    vehicle.
    """
    hit_m = float(rng.uniform(-0.25, 0.25)) * EGO_HWL_M[1]
    z_m = ego_mps * contact_s + CAMERA_TO_FRONT_M + SIZE_HWL_M["Pedestrian"][1] / 2
    x_m, heading_rad = hit_m + side * speed_mps * contact_s, np.pi if side > 0 else 0.0
    return casting.road_user(
        "Pedestrian", x_m, z_m, heading_rad, speed_mps=speed_mps, size_factor=size_factor
    )


def _from_side_road(rng: np.random.Generator) -> tuple[str, float, int]:
    """Type of a vehicle, the angle from straight across the road to its direction, positive =
    along the drive, rad, and the side that it comes from, 1 = right.
    """
    kitti_type = str(rng.choice(("Car", "Van", "Truck", "Motorcycle"), p=(0.65, 0.15, 0.1, 0.1)))
    return kitti_type, float(rng.uniform(-0.3, 0.9)), 1 if rng.uniform() < 0.5 else -1


def _pavements(
    rng: np.random.Generator,
    crossing_m: float,
    until_m: float,
    fraction: float,
    free_m: tuple[float, ...],
) -> list[RoadUser]:
    """Parked cars except at `free_m` from a person who crosses, people who do not meet this person,
    and signs.
    """
    cars = casting.parked(
        rng, until_m=until_m, fraction=fraction, free_m=tuple(crossing_m + by_m for by_m in free_m)
    )
    people = [
        user
        for user in casting.walkers(rng, until_m=until_m)
        if abs(user.start_xz_m[1] - crossing_m) > WALK_M
    ]
    return [*cars, *people, *casting.signs("city", until_m=until_m)]


def _other_traffic(
    rng: np.random.Generator, surroundings: str, until_m: float, seconds: float
) -> list[RoadUser]:
    if surroundings == "highway":
        users = _fast_oncoming(rng, until_m, seconds)
    else:
        users = _oncoming_traffic(rng, until_m, seconds)
    if surroundings == "city":
        users += [
            *casting.parked(rng, until_m=until_m, fraction=0.5),
            *casting.walkers(rng, until_m=until_m),
        ]
    return [*users, *casting.signs(surroundings, until_m=until_m)]


def _oncoming_traffic(rng: np.random.Generator, until_m: float, seconds: float) -> list[RoadUser]:
    speed_mps, spacing_m = float(rng.uniform(9, 15)), float(rng.uniform(30, 60))
    return casting.oncoming(
        rng, x_m=-3.5, speed_mps=speed_mps, spacing_m=spacing_m, until_m=until_m, seconds=seconds
    )


def _fast_oncoming(rng: np.random.Generator, until_m: float, seconds: float) -> list[RoadUser]:
    return casting.oncoming(
        rng, x_m=-8.5, speed_mps=30.0, spacing_m=55.0, until_m=until_m, seconds=seconds
    )


def _slow_changes(rng: np.random.Generator, mean_mps: float, seconds: float) -> SpeedChanges:
    """Speeds that change by up to 12 % every 3 to 5 s, at most 1 m/s^2."""
    changes, time_s = [(-4.0, mean_mps)], 0.0
    while time_s < seconds + 4:
        before = changes[-1][1]
        speed_mps = mean_mps * float(rng.uniform(0.88, 1.12))
        changes.append((time_s, float(np.clip(speed_mps, before - 3, before + 3))))
        time_s += float(rng.uniform(3, 5))
    return tuple(changes)


def _with_crash(scene: Scene, seconds: float) -> Scene:
    """The scene with the ego vehicle and the object that it hits braking to a standstill from the
    first contact on.
    """
    contact = first_contact(scene, max(seconds, CONTACT_S[1] + 1))
    if contact is None:
        return scene
    at_s = contact.contact_s
    row = next(
        row for row, user in enumerate(scene.road_users) if user.track_id == contact.track_id
    )
    hit = scene.road_users[row]
    speeds = hit.speed_changes or ((0.0, hit.speed_mps),)
    ego_mps, hit_mps = speed_at_mps(scene.ego_speed_changes, at_s), speed_at_mps(speeds, at_s)
    is_person = hit.kitti_type == "Pedestrian"
    stop_s = max(1e-3 if is_person else hit_mps / CRASH_DECELERATION_MPS2, 1e-3)
    stopping = (
        *(change for change in speeds if change[0] < at_s),
        (at_s, hit_mps),
        (at_s + stop_s, 0.0),
    )
    stopped = replace(hit, speed_changes=stopping)
    slowed_mps = max((0.0 if is_person else hit_mps) - CRASH_DECELERATION_MPS2 * CRASH_S, 0.0)
    crash: SpeedChanges = ((at_s, ego_mps), (at_s + CRASH_S, slowed_mps))
    if slowed_mps > 0:
        crash += ((at_s + CRASH_S + slowed_mps / CRASH_DECELERATION_MPS2, 0.0),)
    before = tuple(change for change in scene.ego_speed_changes if change[0] < at_s)
    users = (*scene.road_users[:row], stopped, *scene.road_users[row + 1 :])
    return replace(scene, road_users=users, ego_speed_changes=(*before, *crash))
