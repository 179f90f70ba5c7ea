"""Which clips are attempted again."""

import pytest

from track_range.fleet.engine.driver import Attempts, failure_of_lost_worker, time_limit_s


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


TIMEOUT = ("timeout", "the clip took too long.")


@pytest.mark.parametrize(
    ("verdict", "is_node_lost", "kind"),
    [
        (None, True, None),  # neither counted, nor an excuse of other clips
        (TIMEOUT, True, "timeout"),
        (TIMEOUT, False, "timeout"),
        (None, False, "crash"),
    ],
)
def test_failures_of_lost_workers(verdict, is_node_lost, kind):
    failure = failure_of_lost_worker(verdict, is_node_lost=is_node_lost)
    assert (failure and failure[0]) == kind


def test_time_limit_grows_with_length_and_frames():
    assert time_limit_s(60.0, 0.0) == 60.0
    assert time_limit_s(60.0, 10.0, fetch_bytes=5e6) == 665.0
    assert time_limit_s(60.0, 10.0, n_frames=90) == 660.0
    assert time_limit_s(60.0, 10.0, n_frames=300) == 1860.0
