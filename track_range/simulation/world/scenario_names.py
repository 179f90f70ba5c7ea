"""The names of the scenarios; not in `scenarios`, so that the command line can import them without numpy."""

from typing import Literal, get_args

ScenarioName = Literal[
    "town",
    "highway",
    "city",
    "cut-in",
    "crossing",
    "queue",
    "empty",
    "night",
    "rear-stationary",
    "rear-slower",
    "rear-braking",
    "crossing-adult",
    "crossing-child",
    "curve-parked",
    "oncoming",
    "overhead-sign",
    "following",
    "occlusion",
]

SCENARIO_NAMES: tuple[ScenarioName, ...] = get_args(ScenarioName)
"""The names of the scenarios, in the order of the help texts."""
