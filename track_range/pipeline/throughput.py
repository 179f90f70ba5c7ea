"""StageClock: time spent in each stage of a run; FrameMeter: its results per second, and latency of a live run."""

from __future__ import annotations

import time
from collections import deque
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from threading import Lock
from typing import Protocol

import numpy as np

from track_range.pipeline.frame_result import FrameResult
from track_range.ranging.registry import methods

_WALL_TIMED = ("detect",)  # stages that work in threads of a library, measured in wall-clock time


def stage_names() -> tuple[str, ...]:
    """Names of the stages of a run in their order; each ranging method is a stage."""
    return ("read", "lanes", "detect", "track", *(method.name for method in methods()), "fuse", "write")


class StageClock:
    """Time spent in each stage, summed over all threads.

    Stages are measured in processor time of their thread, so that waiting for a core (stages have a lower priority than
    inference) does not count. Inference, which has its own threads, is measured in wall-clock time.
    """

    def __init__(self) -> None:
        self.busy_s = dict.fromkeys(stage_names(), 0.0)  # seconds so far, by stage
        self._lock = Lock()

    @contextmanager
    def stage(self, name: str) -> Iterator[None]:
        """Add the time of the with-block to a stage."""
        now_s = time.perf_counter if name in _WALL_TIMED else time.thread_time
        start_s = now_s()
        try:
            yield
        finally:
            self.add(name, now_s() - start_s)

    def add(self, name: str, seconds: float) -> None:
        """Add seconds that were measured elsewhere to a stage."""
        with self._lock:
            self.busy_s[name] = self.busy_s.get(name, 0.0) + seconds


_WINDOW_S = 2.0  # time window in seconds over which the rate of results is averaged


class LiveOrigin(Protocol):
    """A reader of a camera."""

    @property
    def first_time_s(self) -> float:
        """Time of the first frame on the clock of the meter, in seconds; frame times count from it."""
        ...


class FrameMeter:
    """Rate of the results of a run and, if it is live, the latency from the camera's image to each result.

    `live` is the reader of the left camera, None = the run reads files; `now_s` is the clock of its timestamps.
    """

    def __init__(self, live: LiveOrigin | None = None, *, now_s: Callable[[], float] = time.monotonic) -> None:
        self._live, self._now_s = live, now_s
        self._stamps_s: deque[float] = deque()
        self.latency_s: list[float] = []  # of each frame of a live run
        self._n_frames, self._first_index, self._last_index = 0, 0, 0

    def add(self, result: FrameResult) -> None:
        """Count a result that has become available now."""
        now_s = self._now_s()
        self._stamps_s.append(now_s)
        while self._stamps_s[0] < now_s - _WINDOW_S:
            self._stamps_s.popleft()
        self._first_index = self._first_index if self._n_frames else result.index
        self._n_frames, self._last_index = self._n_frames + 1, result.index
        if self._live is not None:
            self.latency_s.append(now_s - self._live.first_time_s - result.time_s)

    @property
    def rate_hz(self) -> float:
        """Results per second; NaN = not known yet."""
        span_s = self._stamps_s[-1] - self._stamps_s[0] if self._stamps_s else 0.0
        return (len(self._stamps_s) - 1) / span_s if span_s > 0 else float("nan")

    @property
    def n_dropped(self) -> int:
        """Number of frames between the first and the last one that the run did not process."""
        return self._last_index - self._first_index + 1 - self._n_frames if self._n_frames else 0

    def captions(self) -> tuple[str, ...]:
        """Short texts for the corner of the overlay: frame rate, latency, dropped frames."""
        rate = () if np.isnan(self.rate_hz) else (f"{self.rate_hz:.1f} fps",)
        if not self.latency_s:
            return rate
        dropped = (f"{self.n_dropped} dropped",) if self.n_dropped else ()
        return (*rate, f"latency {1000 * self.latency_s[-1]:.0f} ms", *dropped)

    @property
    def notes(self) -> tuple[str, ...]:
        """Messages for the user after a live run."""
        if not self.latency_s:
            return ()
        median_ms, longest_ms = 1000 * np.median(self.latency_s), 1000 * max(self.latency_s)
        return (f"Latency from image to result: median {median_ms:.0f} ms, maximum {longest_ms:.0f} ms.",)
