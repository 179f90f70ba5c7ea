"""StageClock: time spent in each stage of a run."""

import time
from collections.abc import Collection
from contextlib import AbstractContextManager
from threading import Lock

from track_range.ranging.methods.method import FIRST_STAGES, LAST_STAGES
from track_range.ranging.registry import methods

_WALL_TIMED = ("detect",)  # stages that work in threads of a library, measured in wall-clock time


def stage_names(optional: Collection[str] = ()) -> tuple[str, ...]:
    """Names of the stages of a run in their order; each ranging method is a stage, an optional one
    if it is named.
    """
    return (*FIRST_STAGES, *(method.name for method in methods(optional)), *LAST_STAGES)


class StageClock:
    """Time spent in each stage, summed over all threads.

    Stages are measured in processor time of their thread, so that waiting for a core (stages have a
    lower priority than inference) does not count. Inference, which has its own threads, is measured
    in wall-clock time.
    """

    def __init__(self, methods: Collection[str] = ()) -> None:
        """Start at zero; `methods` are those of the run."""
        self.busy_s = dict.fromkeys(stage_names(methods), 0.0)  # seconds so far, by stage
        self._lock = Lock()

    def stage(self, name: str) -> AbstractContextManager[None]:
        """Add the time of the with-block to a stage."""
        return _Stage(self, name)

    def add(self, name: str, seconds: float) -> None:
        """Add seconds that were measured elsewhere to a stage."""
        with self._lock:
            self.busy_s[name] = self.busy_s.get(name, 0.0) + seconds


class _Stage(AbstractContextManager[None]):
    """The time of one with-block."""

    __slots__ = ("_clock", "_name", "_now_s", "_start_s")

    def __init__(self, clock: StageClock, name: str) -> None:
        self._clock, self._name = clock, name
        self._now_s = time.perf_counter if name in _WALL_TIMED else time.thread_time

    def __enter__(self) -> None:
        self._start_s = self._now_s()

    def __exit__(self, *_: object) -> None:
        self._clock.add(self._name, self._now_s() - self._start_s)
