"""The names of the simulation's scenarios, apart from `scenarios` so that the command line starts without numpy."""

from typing import Literal, get_args

ScenarioName = Literal["town", "highway", "city", "cut-in", "crossing", "queue", "empty", "night"]

SCENARIO_NAMES: tuple[ScenarioName, ...] = get_args(ScenarioName)
"""In the order in which help texts list them."""
