"""Scenarios of ordinary traffic; each seed gives a different drive.

town       a straight street without pitch or roll                  highway   three lanes, guard rails, 108 km/h
city       a winding street, stop and go, buses, lights, signs      cut-in    a car cuts in closely ahead, and brakes
crossing   the demo's: people and a cyclist cross the road          queue     stop and go, bumper to bumper
empty      a country road without road users                        night     the city at night, by headlights
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

import numpy as np

from track_range.simulation.settings import ScenarioName
from track_range.simulation.world.motion import LaneChange, SpeedChanges, travelled_m
from track_range.simulation.world.scenarios.casting import (
    Flow,
    Part,
    earlier,
    lights,
    oncoming,
    parked,
    random_road,
    scene_of,
    signs,
    walkers,
)
from track_range.simulation.world.scene import TOWARDS_RAD, VIEW_M, Scene, make_scene

QUEUE_SPACING_M, QUEUE_DELAY_S = 6.7, 0.8
"""Distance between the centres of cars in a standing queue, and delay of each car relative to the one ahead."""

_TRUCKS = (("Truck", 0.45), ("Van", 0.25), ("Car", 0.2), ("Bus", 0.1))
_FAST = (("Car", 0.85), ("Motorcycle", 0.15))


def _town(seed: int, seconds: float) -> Scene:
    return make_scene(seed, seconds=seconds)


def _city(seed: int, seconds: float) -> Scene:
    rng = np.random.default_rng([seed, 11])
    ego: SpeedChanges = ((0, 9), (2.5, 11), (5, 11), (7.5, 6), (9, 7), (12, 11), (20, 9))
    way_m = travelled_m(ego, seconds)
    until_m = way_m + VIEW_M
    crossing_m = way_m + 12.0
    parts = [
        Part(kind="Car", x_m=0.1, z_m=19.0, speed_changes=earlier(ego, 0.9)),
        Part(kind="Motorcycle", x_m=-0.2, z_m=34.0, speed_changes=earlier(ego, 1.6)),
        Part(kind="Bus", x_m=3.6, z_m=27.0, speed_mps=8.0),
        Part(kind="Cyclist", x_m=4.7, z_m=15.0, speed_mps=4.5),
        *Flow(x_m=3.5, speed_mps=8.0, spacing_m=26.0, from_m=52.0, until_m=until_m).parts(rng),
        *oncoming(rng, x_m=-3.5, speed_mps=10.0, spacing_m=34.0, until_m=until_m + 10 * seconds),
        *parked(rng, until_m=until_m, fraction=0.5, free_m=(crossing_m,)),
        *walkers(rng, until_m=until_m, x_m=9.4),
        *signs(until_m=until_m, x_m=7.9),
        *lights(crossing_m),
    ]
    return scene_of(seed, rng, parts, ego, surroundings="city", road=random_road(rng, swing_m=5.0, hill_m=1.0))


def _night(seed: int, seconds: float) -> Scene:
    return replace(_city(seed, seconds), is_night=True)


def _highway(seed: int, seconds: float) -> Scene:
    rng = np.random.default_rng([seed, 12])
    ego: SpeedChanges = ((0, 29), (4, 31), (10, 30), (20, 29))
    until_m = travelled_m(ego, seconds) + VIEW_M
    behind_m = -4.0 * seconds
    parts = [
        Part(kind="Car", x_m=0.1, z_m=34.0, speed_changes=((0, 28.5), (5, 30.5), (10, 30), (20, 29))),
        Part(kind="Van", x_m=0.0, z_m=72.0, speed_changes=ego),
        *Flow(x_m=3.62, speed_mps=24.0, spacing_m=38.0, kinds=_TRUCKS, from_m=16.0, until_m=until_m).parts(rng),
        *Flow(x_m=-3.62, speed_mps=33.0, spacing_m=45.0, kinds=_FAST, from_m=behind_m, until_m=VIEW_M).parts(rng),
        *oncoming(rng, x_m=-8.5, speed_mps=31.0, spacing_m=55.0, until_m=until_m + 31 * seconds),
        *oncoming(rng, x_m=-12.0, speed_mps=25.0, spacing_m=60.0, until_m=until_m + 25 * seconds),
        *signs(until_m=until_m, x_m=10.6, spacing_m=90.0),
    ]
    return scene_of(
        seed, rng, parts, ego, surroundings="highway", road=random_road(rng, swing_m=9.0, hill_m=2.2, longer=1.6)
    )


def _cut_in(seed: int, seconds: float) -> Scene:
    rng = np.random.default_rng([seed, 13])
    ego: SpeedChanges = ((0, 26), (3.5, 26), (6, 20.5), (9, 20.5), (12, 24))
    until_m = travelled_m(ego, seconds) + VIEW_M
    cutting = LaneChange(1.5, 4.0, -3.6)
    parts = [
        Part(
            kind="Car",
            x_m=3.62,
            z_m=17.0,
            speed_changes=((0, 24.5), (3.5, 24.5), (6, 20), (20, 23)),
            lane_change=cutting,
        ),
        Part(kind="Car", x_m=0.0, z_m=62.0, speed_changes=((0, 24), (5, 21), (20, 23))),
        Part(kind="Truck", x_m=3.62, z_m=38.0, speed_mps=21.5),
        *Flow(x_m=3.62, speed_mps=21.5, spacing_m=40.0, kinds=_TRUCKS, from_m=78.0, until_m=until_m).parts(rng),
        *Flow(x_m=-3.62, speed_mps=29.0, spacing_m=50.0, kinds=_FAST, from_m=-6.0 * seconds, until_m=VIEW_M).parts(rng),
        *oncoming(rng, x_m=-8.5, speed_mps=29.0, spacing_m=55.0, until_m=until_m + 29 * seconds),
        *signs(until_m=until_m, x_m=10.6, spacing_m=90.0),
    ]
    return scene_of(
        seed, rng, parts, ego, surroundings="highway", road=random_road(rng, swing_m=5.0, hill_m=1.5, longer=1.6)
    )


def _crossing(seed: int, seconds: float) -> Scene:
    rng = np.random.default_rng([seed, 14])
    ego: SpeedChanges = ((0, 9), (1.2, 9), (4.0, 0), (8.5, 0), (11, 8))
    until_m = travelled_m(ego, seconds) + VIEW_M
    line_m = travelled_m(ego, 6.0) + 6.5
    people = [
        (5.2, line_m, np.pi, 1.3),
        (6.4, line_m + 1.1, np.pi, 1.35),
        (-6.0, line_m + 2.2, 0.0, 1.25),
        (-8.0, line_m + 3.3, 0.0, 1.5),
        (8.2, line_m + 4.4, np.pi, 1.2),
    ]
    rides: SpeedChanges = ((4.0, 0), (5.0, 3.4), (8.4, 3.4), (9.2, 0))
    shift_m = float(rng.uniform(-0.8, 0.8))
    parts = [
        *(
            Part(kind="Pedestrian", x_m=x_m + shift_m, z_m=z_m, heading_rad=heading, speed_mps=speed)
            for x_m, z_m, heading, speed in people
        ),
        Part(kind="Cyclist", x_m=-7.2, z_m=line_m + 6.2, heading_rad=0.0, speed_changes=rides),
        Part(kind="Car", x_m=0.0, z_m=line_m + 22.0, speed_mps=9.5),
        Part(kind="Car", x_m=-3.5, z_m=line_m + 16.0, heading_rad=TOWARDS_RAD, speed_changes=((0, 4), (2, 0), (9, 0))),
        *parked(rng, until_m=until_m, fraction=0.55, free_m=(line_m, line_m + 6)),
        *walkers(rng, until_m=until_m, x_m=9.4),
        *lights(line_m + 9.0),
        *signs(until_m=until_m, x_m=7.9, first_m=line_m - 3.0),
    ]
    return scene_of(seed, rng, parts, ego, surroundings="city", road=random_road(rng, swing_m=2.0, hill_m=0.6))


def _queue(seed: int, seconds: float) -> Scene:
    rng = np.random.default_rng([seed, 15])
    ego: SpeedChanges = ((0, 3), (2, 0), (3.5, 0), (5, 4.5), (7.5, 4.5), (9.5, 0), (11, 0), (13, 4), (20, 4))
    until_m = travelled_m(ego, seconds) + VIEW_M
    parts: list[Part] = []
    for x_m, delay_s, first_m in ((0.0, 0.0, 9.5), (3.5, 1.3, 5.5)):
        number, z_m = 1, first_m
        while z_m < VIEW_M:
            changes = earlier(ego, QUEUE_DELAY_S * number - delay_s)
            kind = "Van" if rng.uniform() < 0.15 else "Car"
            parts.append(Part(kind=kind, x_m=x_m + float(rng.normal(0, 0.1)), z_m=z_m, speed_changes=changes))
            number += 1
            z_m += QUEUE_SPACING_M + travelled_m(changes, QUEUE_DELAY_S)  # which the next has done already
    parts += oncoming(rng, x_m=-3.5, speed_mps=8.0, spacing_m=32.0, until_m=until_m + 8 * seconds)
    parts += [*walkers(rng, until_m=until_m, x_m=9.4), *signs(until_m=until_m, x_m=7.9), *lights(34.0)]
    return scene_of(seed, rng, parts, ego, surroundings="city", road=random_road(rng, swing_m=3.0, hill_m=0.5))


def _empty(seed: int, seconds: float) -> Scene:
    rng = np.random.default_rng([seed, 16])
    ego: SpeedChanges = ((0, 20), (5, 24), (10, 22), (20, 20))
    parts = signs(until_m=travelled_m(ego, seconds) + VIEW_M, x_m=3.9, spacing_m=70.0)
    return scene_of(seed, rng, parts, ego, surroundings="country", road=random_road(rng, swing_m=7.0, hill_m=3.0))


TRAFFIC: dict[ScenarioName, Callable[[int, float], Scene]] = {
    "town": _town,
    "highway": _highway,
    "city": _city,
    "cut-in": _cut_in,
    "crossing": _crossing,
    "queue": _queue,
    "empty": _empty,
    "night": _night,
}
"""Function of each scenario that creates its scene from seed and length in seconds."""
