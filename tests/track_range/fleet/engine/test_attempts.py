"""Which clips are attempted again."""

from collections import deque
from types import SimpleNamespace

import pytest

from track_range.fleet.engine import driver
from track_range.fleet.engine.driver import Attempts, Driver, Slot, time_limit_s
from track_range.fleet.engine.plan import ClipTask
from track_range.fleet.inputs.clip import Clip


def failed(attempts, clip, *kinds):
    for kind in kinds:
        attempts.add(clip, kind)
    return attempts


@pytest.mark.parametrize("kind", ["crash", "memory", "timeout", "fetch"])
def test_one_repetition(kind):
    attempts = failed(Attempts(), "a", kind)
    assert attempts.is_repeated("a")
    assert attempts.n_failed("a") == 1
    assert not failed(attempts, "a", kind).is_repeated("a")


@pytest.mark.parametrize("kind", ["input", "internal"])
def test_application_errors_are_final(kind):
    assert not failed(Attempts(), "a", kind).is_repeated("a")


def test_four_attempts_if_others_crashed_too():
    attempts = failed(failed(Attempts(), "b", "crash"), "a", "crash", "crash", "crash")
    assert attempts.is_repeated("a")
    assert not failed(attempts, "a", "crash").is_repeated("a")


@pytest.mark.parametrize("kind", ["timeout", "memory"])
def test_limits_are_not_excused_by_crashes(kind):
    attempts = failed(failed(Attempts(), "b", "crash"), "a", kind, kind)
    assert not attempts.is_repeated("a")


@pytest.fixture
def fleet(monkeypatch):
    """A driver without workers, whose journal is empty."""
    monkeypatch.setattr(driver, "journal_rows", lambda out, names: {})
    driver_ = Driver.__new__(Driver)
    driver_._todo, driver_._attempts, driver_._out = deque(), Attempts(), None
    driver_._plan = SimpleNamespace(settings_hash="hash")
    return driver_


def lost(fleet, name, **state):
    task = ClipTask(Clip(name, "left.mp4"))
    fleet._lost(Slot(0, task, verdict=state.pop("verdict", None)), **state)
    return fleet._attempts.n_failed(name)


def test_lost_node_is_not_counted(fleet):
    assert lost(fleet, "a", is_node_lost=True) == 0
    assert [task.clip.name for task in fleet._todo] == ["a"]


def test_lost_node_does_not_excuse_others(fleet):
    lost(fleet, "b", is_node_lost=True)
    assert not failed(fleet._attempts, "a", "crash", "crash").is_repeated("a")


def test_timeout_on_lost_node_is_counted(fleet):
    assert lost(fleet, "a", verdict=("timeout", "the clip took too long."), is_node_lost=True) == 1


def test_death_of_a_worker_is_counted(fleet):
    assert lost(fleet, "a") == 1
    assert failed(fleet._attempts, "b", "crash", "crash").is_repeated("b")


def test_time_limit_grows_with_length_and_frames():
    assert time_limit_s(60.0, 0.0) == 60.0
    assert time_limit_s(60.0, 10.0, fetch_bytes=5e6) == 665.0
    assert time_limit_s(60.0, 10.0, n_frames=90) == 660.0
    assert time_limit_s(60.0, 10.0, n_frames=300) == 1860.0
