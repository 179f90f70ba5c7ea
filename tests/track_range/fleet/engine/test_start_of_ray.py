"""Start of Ray on this machine: a second try, then one sentence."""

import sys
from types import ModuleType

import pytest

from tests.track_range.fleet.stub_clips import process_stub, stub_clips
from track_range.fleet.engine.cluster import connected
from track_range.fleet.engine.fleet_run import run_fleet
from track_range.fleet.errors import FleetError
from track_range.fleet.output.state import read_state
from track_range.fleet.settings import FleetSettings
from track_range.fleet.storage.location import Location


@pytest.fixture
def ray(monkeypatch):
    """Ray whose first `n_failing` starts exceed its time limit, as on a busy machine; `n_starts`
    counts them."""
    module = ModuleType("ray")
    module.n_starts, module.n_failing = 0, 0

    def init(**_options):
        module.n_starts += 1
        if module.n_starts <= module.n_failing:
            raise Exception("The current node timed out during startup.\nThis could happen")

    module.__spec__, module.init, module.shutdown = object(), init, lambda: None
    module.cluster_resources = lambda: {"memory": 64e9}
    monkeypatch.setitem(sys.modules, "ray", module)
    return module


def settings_of(tmp_path):
    return FleetSettings.of(
        {"recordings": (str(tmp_path),), "out": str(tmp_path / "out"), "workers": 1}
    )


def test_second_try(ray, tmp_path):
    ray.n_failing = 1
    with connected(settings_of(tmp_path)) as n_workers:
        assert (n_workers, ray.n_starts) == (1, 2)


def test_one_sentence(ray, tmp_path):
    ray.n_failing = 9
    with pytest.raises(FleetError, match="timed out during startup") as caught:
        run_fleet(
            settings_of(tmp_path), {}, stub_clips(tmp_path / "clips", "a"), process=process_stub
        )
    assert ray.n_starts == 2
    assert "repeat" in str(caught.value)
    state = read_state(Location.of(tmp_path / "out"))
    assert (state.state, state.reason) == ("failed", str(caught.value))


def test_state_after_an_unexpected_error(ray, tmp_path):
    ray.cluster_resources = lambda: 1 / 0
    with pytest.raises(ZeroDivisionError):
        run_fleet(
            settings_of(tmp_path), {}, stub_clips(tmp_path / "clips", "a"), process=process_stub
        )
    state = read_state(Location.of(tmp_path / "out"))
    assert (state.state, "ZeroDivisionError" in state.reason) == ("failed", True)
