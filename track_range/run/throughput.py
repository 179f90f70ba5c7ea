"""FrameMeter: how fast a run goes, and of a live one how late its results are and how many frames it left out."""

from __future__ import annotations

import time
from collections import deque
from collections.abc import Callable, Generator, Iterable
from typing import Protocol

import numpy as np

from track_range.run.frame_result import FrameResult

_OVER_S = 2.0  # the rate is that of so much time


class LiveOrigin(Protocol):
    """Whatever reads a camera."""

    @property
    def first_time_s(self) -> float:
        """When, by the meter's clock, the run's time began."""
        ...


class FrameMeter:
    """Watches the results of one run.

    Args:
        live: the left eye of a run that reads a camera; None = it reads files.
        now_s: the clock, the same as the camera's times.

    Attributes:
        latency_s: from the camera to the result, of each frame of a live run.
    """

    def __init__(self, live: LiveOrigin | None = None, *, now_s: Callable[[], float] = time.monotonic) -> None:
        self._live, self._now_s = live, now_s
        self._stamps_s: deque[float] = deque()
        self.latency_s: list[float] = []
        self._n_frames, self._first_index, self._last_index = 0, 0, 0

    def watched(self, results: Iterable[FrameResult]) -> Generator[FrameResult, None, None]:
        """The same results."""
        for result in results:
            self.see(result)
            yield result

    def see(self, result: FrameResult) -> None:
        """One more result."""
        now_s = self._now_s()
        self._stamps_s.append(now_s)
        while self._stamps_s[0] < now_s - _OVER_S:
            self._stamps_s.popleft()
        self._first_index = self._first_index if self._n_frames else result.frame.index
        self._n_frames, self._last_index = self._n_frames + 1, result.frame.index
        if self._live is not None:
            self.latency_s.append(now_s - self._live.first_time_s - result.frame.time_s)

    @property
    def rate_hz(self) -> float:
        """Results per second over the last two; NaN = not known yet."""
        span_s = self._stamps_s[-1] - self._stamps_s[0] if self._stamps_s else 0.0
        return (len(self._stamps_s) - 1) / span_s if span_s > 0 else float("nan")

    @property
    def n_left_out(self) -> int:
        """Frames between the first and the last one that the run did not see."""
        return self._last_index - self._first_index + 1 - self._n_frames if self._n_frames else 0

    def words(self) -> tuple[str, ...]:
        """For the corner of a picture."""
        rate = () if np.isnan(self.rate_hz) else (f"{self.rate_hz:.1f} fps",)
        if not self.latency_s:
            return rate
        left_out = (f"{self.n_left_out} dropped",) if self.n_left_out else ()
        return (*rate, f"{1000 * self.latency_s[-1]:.0f} ms behind", *left_out)

    @property
    def notes(self) -> tuple[str, ...]:
        """What the user should know of a live run, once it is over."""
        if not self.latency_s:
            return ()
        median_ms, longest_ms = 1000 * np.median(self.latency_s), 1000 * max(self.latency_s)
        return (f"Results came a median of {median_ms:.0f} ms after the camera's images, {longest_ms:.0f} ms at most.",)
