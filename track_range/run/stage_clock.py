"""StageClock: how much time each stage of a run takes."""

from __future__ import annotations

import time
from collections.abc import Iterator
from contextlib import contextmanager
from threading import Lock

from track_range.ranging.registry import methods

_WALL_TIMED = ("detect",)
"""Stages whose work is done in threads of their own; they are timed by the wall clock."""


def stage_names() -> tuple[str, ...]:
    """The stages of a run in their order; each ranging method is one."""
    return ("read", "lanes", "detect", "track", *(method.name for method in methods()), "fuse", "write")


class StageClock:
    """Seconds of work in each stage, counted in whichever thread does it.

    Processor time of the thread: waiting for a core, since a stage gives way to inference, is no cost of that stage.
    Inference, which has its own threads, is timed by the wall clock.

    Attributes:
        busy_s: seconds so far, by stage.
    """

    def __init__(self) -> None:
        """Start at zero."""
        self.busy_s = dict.fromkeys(stage_names(), 0.0)
        self._lock = Lock()

    @contextmanager
    def stage(self, name: str) -> Iterator[None]:
        """Add the time of the with-block to a stage."""
        now_s = time.perf_counter if name in _WALL_TIMED else time.thread_time
        began_s = now_s()
        try:
            yield
        finally:
            self.add(name, now_s() - began_s)

    def add(self, name: str, seconds: float) -> None:
        """Add time that was measured elsewhere to a stage."""
        with self._lock:
            self.busy_s[name] = self.busy_s.get(name, 0.0) + seconds
