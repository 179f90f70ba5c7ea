"""Which clips are attempted again."""

import pytest

from track_range.fleet.engine.attempts import Attempts
from track_range.fleet.engine.limits import Limits


def failed(attempts, clip, *kinds, node="n1"):
    for kind in kinds:
        attempts.add(clip, kind, node)
    return attempts


@pytest.mark.parametrize("kind", ["crash", "memory", "timeout", "fetch"])
def test_one_repetition(kind):
    attempts = failed(Attempts(), "a", kind)
    assert attempts.is_repeated("a")
    assert attempts.number("a") == 2
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


def test_lost_node_is_not_counted():
    attempts = failed(Attempts(), "a", "crash", "crash", node="lost")
    attempts.forget_node("lost")
    assert attempts.n_failed("a") == 0
    assert attempts.is_repeated("a")


def test_lost_node_does_not_excuse_others():
    attempts = failed(failed(Attempts(), "b", "crash", node="lost"), "a", "crash", "crash")
    attempts.forget_node("lost")
    assert not attempts.is_repeated("a")


def test_timeout_on_lost_node_is_counted():
    attempts = failed(Attempts(), "a", "timeout", node="lost")
    attempts.forget_node("lost")
    assert attempts.n_failed("a") == 1


def test_time_limit_grows_with_length_and_frames():
    limits = Limits(time_factor=60.0, memory_bytes=1)
    assert limits.time_s(0.0) == 60.0
    assert limits.time_s(10.0, fetch_bytes=5e6) == 665.0
    assert limits.time_s(10.0, n_frames=90) == 660.0
    assert limits.time_s(10.0, n_frames=300) == 1860.0
