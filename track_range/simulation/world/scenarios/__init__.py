"""The scenarios by name: ordinary traffic, drives that end in a contact with their harmless twins,
and occlusion.
"""

from collections.abc import Callable

from track_range.simulation.world.scenarios import conflicts, traffic
from track_range.simulation.world.scenarios.fixed import fixed
from track_range.simulation.world.scenarios.occlusion import occlusion
from track_range.simulation.world.scene import Scene, make_scene

# scenes from a seed and a length in seconds
SCENARIOS: dict[str, Callable[[int, float], Scene]] = {
    "town": make_scene,
    "highway": traffic.highway,
    "city": traffic.city,
    "cut-in": traffic.cut_in,
    "crossing": traffic.crossing,
    "queue": traffic.queue,
    "empty": traffic.empty,
    "night": traffic.night,
    "rear-stationary": conflicts.rear_stationary,
    "rear-slower": conflicts.rear_slower,
    "rear-braking": conflicts.rear_braking,
    "crossing-adult": conflicts.crossing_adult,
    "crossing-child": conflicts.crossing_child,
    "crossing-car": conflicts.crossing_car,
    "yielding": conflicts.yielding,
    "curve-parked": conflicts.curve_parked,
    "oncoming": conflicts.oncoming_traffic,
    "overhead-sign": conflicts.overhead_sign,
    "following": conflicts.following,
    "occlusion": occlusion,
    "winding": traffic.winding,
    "fixed": fixed,
}


def make_scenario(name: str, *, seed: int = 0, seconds: float = 10.0) -> Scene:
    """The scene of a scenario, the same for the same seed and length of the drive; ValueError if it
    is unknown.
    """
    if name not in SCENARIOS:
        raise ValueError(f"scenario {name}: expected one of {', '.join(SCENARIOS)}")
    return SCENARIOS[name](seed, seconds)
