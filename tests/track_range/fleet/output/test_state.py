"""Whether the driver of a fleet is at work, from fleet.json."""

import os
import time

import pytest

from track_range.fleet.output.state import FleetState, duration_text

THIS_PROCESS = -1


@pytest.mark.parametrize(
    ("host", "pid", "age_s", "is_alive"),
    [
        ("", THIS_PROCESS, 0, True),
        ("", THIS_PROCESS, 120, True),
        ("", THIS_PROCESS, 3600, False),  # the number is that of another process by now
        ("", 2**22 + 1, 0, False),
        ("elsewhere", 1, 30, True),
        ("elsewhere", 1, 120, False),
    ],
)
def test_driver_at_work(host, pid, age_s, is_alive):
    pid = os.getpid() if pid == THIS_PROCESS else pid
    state = FleetState(
        state="running",
        pid=pid,
        heartbeat_s=time.time() - age_s,
        **({"host": host} if host else {}),
    )
    assert state.is_alive is is_alive


@pytest.mark.parametrize(
    ("counts", "sentence"),
    [
        ({"done": 6}, "6 of 8 clips done: 6 in this run, which took 5 min (72 clips per hour)."),
        (
            {"skipped": 7, "failed": 1},
            "7 of 8 clips done, 1 failed: 0 in this run, which took 5 min, and 7 in earlier runs.",
        ),
    ],
)
def test_sentence_of_a_run(counts, sentence):
    state = FleetState(state="finished", total=8, started_s=0.0, heartbeat_s=300.0, **counts)
    assert state.sentence() == sentence
    assert ("left" in state.text()) is (counts == {"done": 6})


@pytest.mark.parametrize(
    ("seconds", "text"),
    [
        (0, "0 s"),
        (0.6, "0.6 s"),
        (0.01, "0.1 s"),
        (94, "94 s"),
        (180, "3 min"),
        (12_000, "3 h 20 min"),
    ],
)
def test_durations(seconds, text):
    assert duration_text(seconds) == text


def test_finished_driver():
    assert not FleetState(state="finished").is_alive
