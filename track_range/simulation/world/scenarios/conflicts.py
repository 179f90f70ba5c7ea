"""Scenarios after the shapes of Euro NCAP's tests of collision warnings, and their harmless twins.

rear-stationary   a standing vehicle in the lane              curve-parked    parked cars straight ahead, in a bend
rear-slower       a vehicle at a third to a half of the speed following       a vehicle ahead at a time gap of 2 s
rear-braking      a vehicle ahead at 1.6 to 2.4 s brakes      oncoming        oncoming traffic in its lane, in bends
crossing-adult    a person crosses from either side           overhead-sign   a gantry with a sign above the lane
crossing-child    a child crosses from behind parked cars

The left column ends in a contact 5.5 to 7.5 s after the start; the seed varies speeds, the lateral overlap (at least
half of the narrower one for vehicles, the middle half of the ego vehicle's width for people), the time of contact, the
kind of vehicle, the road and other traffic. The ego vehicle does not brake before the contact. In the crash, the ego
vehicle takes the speed of what it hits along the road within `CRASH_S`, and both brake to a standstill; a person stops
where the contact happens. `contacts.py` has the exact time.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

import numpy as np

from track_range.simulation.settings import ScenarioName
from track_range.simulation.world.contacts import CAMERA_TO_FRONT_M, EGO_HWL_M, first_contact
from track_range.simulation.world.motion import SpeedChanges, speed_at_mps, travelled_m
from track_range.simulation.world.road_shape import RoadShape
from track_range.simulation.world.scenarios.casting import (
    Flow,
    Part,
    earlier,
    oncoming,
    parked,
    random_road,
    scene_of,
    signs,
    walkers,
)
from track_range.simulation.world.scene import AWAY_RAD, SIZE_HWL_M, TOWARDS_RAD, VIEW_M, RoadUser, Scene

CONTACT_S = (5.5, 7.5)
"""Earliest and latest time of contact, s."""

CRASH_S, CRASH_DECELERATION_MPS2 = 0.1, 6.0
"""Time in which the ego vehicle takes the speed of what it hits, s, and deceleration after it, m/s^2."""

CHILD_FACTOR = 0.68
"""Height of a child relative to an adult: 1.2 m, a child of seven, as Euro NCAP's child dummy."""

WALK_M = 18.0
"""Distance that a person on the pavement walks at most during a drive, m."""

_KINDS = (("Car", 0.55), ("Van", 0.15), ("Truck", 0.12), ("Bus", 0.08), ("Motorcycle", 0.1))
_LANE_M = 3.5


def _rear_stationary(seed: int, seconds: float) -> Scene:
    rng = np.random.default_rng([seed, 21])
    ego_mps, contact_s = float(rng.uniform(9, 16)), _contact_s(rng)
    return _rear(
        seed, rng, seconds, ego_mps=ego_mps, target=((0.0, 0.0),), contact_s=contact_s, roads=("city", "country")
    )


def _rear_slower(seed: int, seconds: float) -> Scene:
    rng = np.random.default_rng([seed, 22])
    ego_mps, contact_s = float(rng.uniform(14, 23)), _contact_s(rng)
    target = ((0.0, ego_mps * float(rng.uniform(0.33, 0.5))),)
    return _rear(seed, rng, seconds, ego_mps=ego_mps, target=target, contact_s=contact_s, roads=("country", "highway"))


def _rear_braking(seed: int, seconds: float) -> Scene:
    rng = np.random.default_rng([seed, 23])
    ego_mps, contact_s = float(rng.uniform(11, 18)), _contact_s(rng)
    gap_m, deceleration = ego_mps * float(rng.uniform(1.6, 2.4)), float(rng.uniform(2.5, 4.5))
    stop_s = ego_mps / deceleration
    closed_m = ego_mps * stop_s / 2
    taken_s = np.sqrt(2 * gap_m / deceleration) if gap_m < closed_m else stop_s + (gap_m - closed_m) / ego_mps
    brake_s = contact_s - float(taken_s)
    target = ((0.0, ego_mps), (brake_s, ego_mps), (brake_s + stop_s, 0.0))
    roads = ("city", "country", "highway")
    return _rear(seed, rng, seconds, ego_mps=ego_mps, target=target, contact_s=contact_s, roads=roads)


def _crossing_adult(seed: int, seconds: float) -> Scene:
    rng = np.random.default_rng([seed, 24])
    ego_mps, contact_s = float(rng.uniform(6, 14)), _contact_s(rng)
    side = 1 if rng.uniform() < 0.5 else -1
    person = _crossing_person(rng, side, ego_mps=ego_mps, contact_s=contact_s, speed_mps=float(rng.uniform(1.3, 2.1)))
    until_m = ego_mps * seconds + VIEW_M
    traffic = _oncoming_traffic(rng, until_m, seconds) if side > 0 else []
    free_m = tuple(person.z_m + by_m for by_m in (-12.0, 0.0, 6.0))
    others = [
        *parked(rng, until_m=until_m, fraction=0.5, free_m=free_m),
        *_walkers_except_at(person.z_m, rng, until_m),
        *signs(until_m=until_m, x_m=7.9),
    ]
    scene = _street(seed, rng, [person, *traffic, *others], ego_mps)
    return _with_crash(scene, seconds)


def _crossing_child(seed: int, seconds: float) -> Scene:
    rng = np.random.default_rng([seed, 25])
    ego_mps, contact_s = float(rng.uniform(6, 11)), _contact_s(rng)
    side = 1 if rng.uniform() < 0.7 else -1
    child = _crossing_person(rng, side, ego_mps=ego_mps, contact_s=contact_s, speed_mps=float(rng.uniform(1.25, 1.55)))
    child = replace(child, size_factor=CHILD_FACTOR)
    until_m = ego_mps * seconds + VIEW_M
    heading_rad = AWAY_RAD if side > 0 else TOWARDS_RAD
    hiding = [
        Part(kind=kind, x_m=6.4 * side, z_m=child.z_m + by_m, heading_rad=heading_rad)
        for kind, by_m in (("Van" if rng.uniform() < 0.4 else "Car", -3.6), ("Car", -10.0), ("Car", 3.8))
    ]
    others = [
        *parked(rng, until_m=until_m, fraction=0.6, free_m=tuple(child.z_m + by_m for by_m in (-12.0, -4.0, 4.0))),
        *_walkers_except_at(child.z_m, rng, until_m),
        *signs(until_m=until_m, x_m=7.9),
    ]
    traffic = _oncoming_traffic(rng, until_m, seconds) if side > 0 else []
    return _with_crash(_street(seed, rng, [child, *hiding, *traffic, *others], ego_mps), seconds)


def _curve_parked(seed: int, seconds: float) -> Scene:
    rng = np.random.default_rng([seed, 26])
    ego_mps = float(rng.uniform(7, 11))
    until_m = ego_mps * seconds + VIEW_M
    parked_m = float(rng.uniform(3.6, 6.2))
    parts = []
    for x_m, heading_rad in ((parked_m, AWAY_RAD), (-6.3, TOWARDS_RAD)):
        for z_m in np.arange(float(rng.uniform(6, 14)), until_m, 7.5).tolist():
            kind = str(rng.choice(["Car", "Van"], p=[0.8, 0.2]))
            if rng.uniform() < 0.85:
                parts.append(Part(kind=kind, x_m=x_m + float(rng.normal(0, 0.1)), z_m=z_m, heading_rad=heading_rad))
    parts += [*walkers(rng, until_m=until_m, x_m=9.6), *signs(until_m=until_m, x_m=7.9)]
    road = RoadShape(
        swing_m=float(rng.uniform(8, 13)),
        swing_length_m=float(rng.uniform(170, 230)),
        swing_phase_rad=float(rng.uniform(0, 2 * np.pi)),
        hill_m=0.5,
        hill_phase_rad=float(rng.uniform(0, 2 * np.pi)),
    )
    return scene_of(seed, rng, parts, ((0.0, ego_mps),), surroundings="city", road=road)


def _oncoming(seed: int, seconds: float) -> Scene:
    rng = np.random.default_rng([seed, 27])
    ego_mps, other_mps = float(rng.uniform(11, 22)), float(rng.uniform(10, 24))
    until_m = ego_mps * seconds + VIEW_M
    flow = Flow(
        x_m=-3.5,
        speed_mps=other_mps,
        spacing_m=float(rng.uniform(28, 50)),
        heading_rad=TOWARDS_RAD,
        kinds=(("Car", 0.6), ("Truck", 0.15), ("Van", 0.1), ("Bus", 0.05), ("Motorcycle", 0.1)),
        from_m=30.0,
        until_m=until_m + other_mps * seconds,
    )
    parts = [*flow.parts(rng), *signs(until_m=until_m, x_m=3.9, spacing_m=70.0)]
    road = random_road(rng, swing_m=9.0, hill_m=2.0)
    return scene_of(seed, rng, parts, ((0.0, ego_mps),), surroundings="country", road=road)


def _overhead_sign(seed: int, seconds: float) -> Scene:
    rng = np.random.default_rng([seed, 28])
    ego_mps = float(rng.uniform(16, 30))
    until_m = ego_mps * seconds + VIEW_M
    gantries = [
        Part(
            kind="TrafficSign",
            x_m=float(rng.normal(0, 0.6)),
            z_m=float(z_m),
            heading_rad=TOWARDS_RAD,
            raised_m=float(rng.uniform(5.0, 5.8)),
            size_factor=float(rng.uniform(3.2, 4.4)),
        )
        for z_m in np.arange(float(rng.uniform(35, 60)), until_m, float(rng.uniform(60, 90)))
    ]
    flow = Flow(
        x_m=3.62, speed_mps=ego_mps, spacing_m=45.0, kinds=(("Car", 0.7), ("Truck", 0.3)), from_m=20.0, until_m=until_m
    )
    parts = [*gantries, *flow.parts(rng), *_fast_oncoming(rng, until_m, seconds)]
    road = random_road(rng, swing_m=6.0, hill_m=2.0, longer=1.6)
    return scene_of(seed, rng, parts, ((0.0, ego_mps),), surroundings="highway", road=road)


def _following(seed: int, seconds: float) -> Scene:
    rng = np.random.default_rng([seed, 29])
    surroundings = str(rng.choice(["city", "country", "highway"]))
    mean_mps = float(rng.uniform(9, 14) if surroundings == "city" else rng.uniform(14, 28))
    ego = _slow_changes(rng, mean_mps, seconds)
    kind = str(rng.choice([name for name, _ in _KINDS], p=[fraction for _, fraction in _KINDS]))
    lead = earlier(ego, 2.0)
    z_m = travelled_m(ego, 2.0) + CAMERA_TO_FRONT_M + SIZE_HWL_M[kind][2] / 2
    parts = [Part(kind=kind, x_m=float(rng.normal(0, 0.2)), z_m=z_m, speed_changes=lead)]
    until_m = travelled_m(ego, seconds) + VIEW_M
    return _on_road(seed, rng, [*parts, *_other_traffic(rng, surroundings, until_m, seconds)], ego, surroundings)


CONFLICTS: dict[ScenarioName, Callable[[int, float], Scene]] = {
    "rear-stationary": _rear_stationary,
    "rear-slower": _rear_slower,
    "rear-braking": _rear_braking,
    "crossing-adult": _crossing_adult,
    "crossing-child": _crossing_child,
}
"""The scenarios that end in a contact, in the order of `scenario_names`."""

TWINS: dict[ScenarioName, Callable[[int, float], Scene]] = {
    "curve-parked": _curve_parked,
    "oncoming": _oncoming,
    "overhead-sign": _overhead_sign,
    "following": _following,
}
"""The harmless twins."""


def _contact_s(rng: np.random.Generator) -> float:
    """A random time of contact; sizes, which vary too, shift it by some hundredths of a second."""
    return float(rng.uniform(*CONTACT_S))


def _rear(
    seed: int,
    rng: np.random.Generator,
    seconds: float,
    *,
    ego_mps: float,
    target: SpeedChanges,
    contact_s: float,
    roads: tuple[str, ...],
) -> Scene:
    """A scene in which the ego vehicle runs into the rear of a vehicle with the given speeds."""
    kind = str(rng.choice([name for name, _ in _KINDS], p=[fraction for _, fraction in _KINDS]))
    _, width_m, length_m = SIZE_HWL_M[kind]
    narrower_m = min(width_m, EGO_HWL_M[1])
    most_m = (width_m + EGO_HWL_M[1]) / 2 - 0.5 * narrower_m
    x_m = float(np.clip(rng.normal(0, 0.35), -most_m, most_m))
    z_m = ego_mps * contact_s + CAMERA_TO_FRONT_M + length_m / 2 - travelled_m(target, contact_s)
    surroundings = str(rng.choice(roads))
    until_m = ego_mps * seconds + VIEW_M
    parts = [Part(kind=kind, x_m=x_m, z_m=z_m, speed_changes=target)]
    parts += _other_traffic(rng, surroundings, until_m, seconds)
    return _with_crash(_on_road(seed, rng, parts, ((0.0, ego_mps),), surroundings), seconds)


def _crossing_person(
    rng: np.random.Generator, side: int, *, ego_mps: float, contact_s: float, speed_mps: float
) -> Part:
    """A person who walks from the right (`side` 1) or left (-1) and meets the front of the ego vehicle."""
    hit_m = float(rng.uniform(-0.25, 0.25)) * EGO_HWL_M[1]
    z_m = ego_mps * contact_s + CAMERA_TO_FRONT_M + SIZE_HWL_M["Pedestrian"][1] / 2
    x_m = hit_m + side * speed_mps * contact_s
    return Part(kind="Pedestrian", x_m=x_m, z_m=z_m, heading_rad=np.pi if side > 0 else 0.0, speed_mps=speed_mps)


def _walkers_except_at(z_m: float, rng: np.random.Generator, until_m: float) -> list[Part]:
    """People on the pavements who do not meet a person who crosses at `z_m`."""
    return [part for part in walkers(rng, until_m=until_m, x_m=9.4) if abs(part.z_m - z_m) > WALK_M]


def _other_traffic(rng: np.random.Generator, surroundings: str, until_m: float, seconds: float) -> list[Part]:
    """Oncoming and parked vehicles, people and signs, outside the ego lane."""
    if surroundings == "highway":
        return [*_fast_oncoming(rng, until_m, seconds), *signs(until_m=until_m, x_m=10.6, spacing_m=90.0)]
    traffic = _oncoming_traffic(rng, until_m, seconds)
    if surroundings == "country":
        return [*traffic, *signs(until_m=until_m, x_m=3.9, spacing_m=70.0)]
    return [
        *traffic,
        *parked(rng, until_m=until_m, fraction=0.5),
        *walkers(rng, until_m=until_m, x_m=9.4),
        *signs(until_m=until_m, x_m=7.9),
    ]


def _oncoming_traffic(rng: np.random.Generator, until_m: float, seconds: float) -> list[Part]:
    speed_mps, spacing_m = float(rng.uniform(9, 15)), float(rng.uniform(30, 60))
    return oncoming(rng, x_m=-_LANE_M, speed_mps=speed_mps, spacing_m=spacing_m, until_m=until_m + speed_mps * seconds)


def _fast_oncoming(rng: np.random.Generator, until_m: float, seconds: float) -> list[Part]:
    return oncoming(rng, x_m=-8.5, speed_mps=30.0, spacing_m=55.0, until_m=until_m + 30 * seconds)


def _street(seed: int, rng: np.random.Generator, parts: list[Part], ego_mps: float) -> Scene:
    road = random_road(rng, swing_m=3.0, hill_m=0.8)
    return scene_of(seed, rng, parts, ((0.0, ego_mps),), surroundings="city", road=road)


def _on_road(seed: int, rng: np.random.Generator, parts: list[Part], ego: SpeedChanges, surroundings: str) -> Scene:
    """The scene on a slightly winding road of the given surroundings."""
    longer = 1.6 if surroundings == "highway" else 1.0
    road = random_road(rng, swing_m=4.0, hill_m=1.2, longer=longer)
    return scene_of(seed, rng, parts, ego, surroundings=surroundings, road=road)


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
    """The scene with the ego vehicle and what it hits braking to a standstill from the first contact on."""
    contact = first_contact(scene, max(seconds, CONTACT_S[1] + 1))
    if contact is None:
        return scene
    at_s = contact.contact_s
    row = next(row for row, user in enumerate(scene.road_users) if user.track_id == contact.track_id)
    hit = scene.road_users[row]
    ego_mps = speed_at_mps(scene.ego_speed_changes, at_s)
    if hit.kitti_type == "Pedestrian":
        stopped, stop_mps = replace(hit, speed_changes=_stopping(_speeds(hit), at_s, 1e-3)), 0.0
    else:
        stop_mps = speed_at_mps(_speeds(hit), at_s)
        stopped = replace(hit, speed_changes=_stopping(_speeds(hit), at_s, stop_mps / CRASH_DECELERATION_MPS2))
    users = (*scene.road_users[:row], stopped, *scene.road_users[row + 1 :])
    slowed_mps = max(stop_mps - CRASH_DECELERATION_MPS2 * CRASH_S, 0.0)
    crash: SpeedChanges = ((at_s, ego_mps), (at_s + CRASH_S, slowed_mps))
    if slowed_mps > 0:
        crash += ((at_s + CRASH_S + slowed_mps / CRASH_DECELERATION_MPS2, 0.0),)
    before = tuple(change for change in scene.ego_speed_changes if change[0] < at_s)
    return replace(scene, road_users=users, ego_speed_changes=(*before, *crash))


def _speeds(user: RoadUser) -> SpeedChanges:
    return user.speed_changes or ((0.0, user.speed_mps),)


def _stopping(changes: SpeedChanges, at_s: float, within_s: float) -> SpeedChanges:
    """The speed changes with a stop from `at_s` on."""
    before = tuple(change for change in changes if change[0] < at_s)
    speed_mps = speed_at_mps(changes, at_s)
    return (*before, (at_s, speed_mps), (at_s + max(within_s, 1e-3), 0.0))
