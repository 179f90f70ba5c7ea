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


@contextmanager
def killed_workers(out: Path, n: int, *, interval_s: float = 1.0) -> Iterator[list[int]]:
    """Context in which random workers of the fleet are killed; yields the list of the processes
    killed so far.

    The first clip to be interrupted is spared until a second one has been: if workers die with one
    clip only, it fails after two attempts (`engine.driver`).
    """
    stop = threading.Event()
    killed: list[int] = []
    interrupted: set[str] = set()

    def kill() -> None:
        generator = random.Random(3)  # noqa: S311
        while len(killed) < n and not stop.wait(interval_s):
            state = read_state(Location.of(out))
            workers = () if state is None else state.workers
            clips = {
                worker["pid"]: worker["clip"]
                for worker in workers
                if worker["clip"] and worker["pid"]
            }
            pids = [
                pid for pid, clip in clips.items() if pid not in killed and interrupted != {clip}
            ]
            if pids:
                killed.append(generator.choice(sorted(pids)))
                interrupted.add(clips[killed[-1]])
                with suppress(ProcessLookupError):
                    os.kill(killed[-1], signal.SIGKILL)

    thread = threading.Thread(target=kill)
    thread.start()
    try:
        yield killed
    finally:
        stop.set()
        thread.join()
