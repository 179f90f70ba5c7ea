"""Kills of workers while they are at work."""

from __future__ import annotations

import os
import random
import signal
import threading
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from pathlib import Path

from track_range.fleet.output.state import read_state
from track_range.fleet.storage.location import Location

_POLL_S = 0.05
_SETTLED_HEARTBEATS = (
    2  # states after a stop until one of them lists the clip of the stopped worker
)


@contextmanager
def killed_workers(out: Path, n: int, *, interval_s: float = 1.0) -> Iterator[list[int]]:
    """Context in which random workers of the fleet are killed; yields the list of the processes
    killed so far.

    The first clip to be interrupted is spared until a second one has been: if workers die with one
    clip only, it fails after two attempts (`engine.driver`). A worker is stopped before it is
    killed, and its clip is read from a later state: the state at the time of the choice may still
    list the clip before.
    """
    stop = threading.Event()
    killed: list[int] = []

    def kill() -> None:
        generator = random.Random(3)  # noqa: S311
        interrupted: set[str] = set()
        wait_s = interval_s
        while len(killed) < n and not stop.wait(wait_s):
            wait_s = _POLL_S
            clips, _ = _clips_of_workers(out)
            pids = [
                pid for pid, clip in clips.items() if pid not in killed and interrupted != {clip}
            ]
            if not pids:
                continue
            pid = generator.choice(sorted(pids))
            with suppress(ProcessLookupError):
                os.kill(pid, signal.SIGSTOP)
                clip = _clip_of_stopped(out, pid, stop)
                if clip and interrupted != {clip}:
                    os.kill(pid, signal.SIGKILL)
                    killed.append(pid)
                    interrupted.add(clip)
                    wait_s = interval_s
                else:
                    os.kill(pid, signal.SIGCONT)

    thread = threading.Thread(target=kill)
    thread.start()
    try:
        yield killed
    finally:
        stop.set()
        thread.join()


def _clips_of_workers(out: Path) -> tuple[dict[int, str], float]:
    """Clip by process number of the workers that have one, and the time of that state."""
    state = read_state(Location.of(out))
    if state is None:
        return {}, 0.0
    clips = {
        worker["pid"]: worker["clip"]
        for worker in state.workers
        if worker["clip"] and worker["pid"]
    }
    return clips, state.heartbeat_s


def _clip_of_stopped(out: Path, pid: int, stop: threading.Event) -> str:
    """Clip of a stopped worker, "" without one, or if the fleet ends."""
    clips, time_s = _clips_of_workers(out)
    for _ in range(_SETTLED_HEARTBEATS):
        earlier_s = time_s
        while time_s == earlier_s:
            if stop.wait(_POLL_S):
                return ""
            clips, time_s = _clips_of_workers(out)
    return clips.get(pid, "")
