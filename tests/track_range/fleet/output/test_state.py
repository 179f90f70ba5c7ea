"""Whether the driver of a fleet is at work, from fleet.json."""

import os
import time

import pytest

from track_range.fleet.output.state import FleetState

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
    state = FleetState(state="running", pid=pid, heartbeat_s=time.time() - age_s, **({"host": host} if host else {}))
    assert state.is_alive is is_alive


def test_finished_driver():
    assert not FleetState(state="finished").is_alive
