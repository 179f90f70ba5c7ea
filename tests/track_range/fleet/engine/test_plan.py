"""Options of the runs of a fleet."""

import pytest

from track_range.fleet.engine.plan import fleet_plan
from track_range.fleet.settings import FleetSettings
from track_range.foundation.errors import UsageError

SETTINGS = FleetSettings(recordings=("x",), out="out")


@pytest.mark.parametrize("value", ["auto", "off", False, "1", "0", "72.5"])
def test_ego_speed_for_all_clips(value):
    fleet_plan(SETTINGS, {"ego_speed": value})


@pytest.mark.parametrize("value", ["speed.csv", "on", "", "nan", True])
def test_ego_speed_of_one_clip(value):
    with pytest.raises(UsageError, match="ego-speed"):
        fleet_plan(SETTINGS, {"ego_speed": value})
