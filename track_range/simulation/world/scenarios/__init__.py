"""The scenarios by name: ordinary traffic, drives that end in a contact with their harmless twins, and occlusion."""

from __future__ import annotations

from collections.abc import Callable

from track_range.simulation.settings import SCENARIO_NAMES, ScenarioName
from track_range.simulation.world.scenarios.conflicts import CONFLICTS, TWINS
from track_range.simulation.world.scenarios.occlusion import occlusion
from track_range.simulation.world.scenarios.traffic import TRAFFIC
from track_range.simulation.world.scene import Scene

_MAKERS: dict[ScenarioName, Callable[[int, float], Scene]] = {
    **TRAFFIC,
    **CONFLICTS,
    **TWINS,
    "occlusion": occlusion,
}

SCENARIOS: dict[str, Callable[[int, float], Scene]] = {name: _MAKERS[name] for name in SCENARIO_NAMES}
"""Function of each scenario that creates its scene from seed and length in seconds."""


def make_scenario(name: str, *, seed: int = 0, seconds: float = 10.0) -> Scene:
    """The scene of a scenario for a drive of the given length; the same seed gives the same scene.

    Raises:
        ValueError: an unknown scenario.
    """
    if name not in SCENARIOS:
        raise ValueError(f"scenario {name}: expected one of {', '.join(SCENARIOS)}")
    return SCENARIOS[name](seed, seconds)
