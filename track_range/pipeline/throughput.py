"""FrameMeter: results of a run per second, and latency of a live run; PacedFrames makes a live
source of a recording.
"""

import math
import time
from collections import deque
from collections.abc import Callable, Generator, Sequence
from contextlib import closing
from threading import Event
from typing import Any, Protocol

import numpy as np

from track_range.pipeline.frame_result import FrameResult
from track_range.stereo.geometry.frames import Frame

_WINDOW_S = 2.0  # time window in seconds over which the rate of results is averaged
_N_RECENT = 300  # frames of which the progress line states the latency
# from which a frame is passed on although it is late: decoding alone may be too slow
_LONGEST_GAP_S = 1.0


class PacedFrames:
    """Frames of a recording at the pace of a camera: none before its time, and none after the next
    frame is due.

    frame                 0    1    2    3    4    5     `interval_s` apart
    the caller is ready   ^                    ^         and gets frame 0, then 4; frames 1 to 3 are dropped

    Iterated once; `stop` ends a wait. Frame times count from `first_time_s` of `time.monotonic`,
    NaN = not started.
    """

    def __init__(self, frames: Generator[Frame, None, None], interval_s: float) -> None:
        self._frames, self._interval_s, self._stopped = frames, interval_s, Event()
        self.first_time_s, self.n_dropped = math.nan, 0

    def __iter__(self) -> Generator[Frame, None, None]:
        last_s = -math.inf
        with closing(self._frames):
            for frame in self._frames:
                now_s = time.monotonic()
                if math.isnan(self.first_time_s):
                    self.first_time_s = now_s - frame.time_s
                late_s = now_s - self.first_time_s - frame.time_s
                if late_s >= self._interval_s and now_s - last_s < _LONGEST_GAP_S:
                    self.n_dropped += 1
                    continue
                if self._stopped.wait(max(0.0, -late_s)):
                    return
                last_s = time.monotonic()
                yield frame

    def stop(self) -> None:
        """End the iteration."""
        self._stopped.set()


def latency_ms(latencies_s: Sequence[float]) -> dict[str, float]:
    """Median `p50`, `p95` and `max` of latencies, in ms; empty if there are none."""
    if not latencies_s:
        return {}
    p50, p95, longest = 1000 * np.percentile(latencies_s, (50, 95, 100))
    return {
        "p50": round(float(p50), 1),
        "p95": round(float(p95), 1),
        "max": round(float(longest), 1),
    }


class LiveOrigin(Protocol):
    """A reader of a camera."""

    @property
    def first_time_s(self) -> float:
        """Time of the first frame on the clock of the meter, in seconds; frame times count from
        it.
        """
        ...


class FrameMeter:
    """Rate of the results of a run and, if it is live, the latency from the camera's image to each
    result.

    `live` is the reader of the left camera, None = the run reads files as fast as it can; `now_s`
    is the clock of its timestamps. Of the camera's frames, each `every`-th one is used.
    """

    def __init__(
        self,
        live: LiveOrigin | None = None,
        *,
        every: int = 1,
        now_s: Callable[[], float] = time.monotonic,
    ) -> None:
        self._live, self._every, self._now_s = live, every, now_s
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
        """Number of frames from the first to the last result that should have been used but were
        not processed.
        """
        if isinstance(self._live, PacedFrames):
            return self._live.n_dropped
        span = self._last_index - self._first_index
        return span // self._every + 1 - self._n_frames if self._n_frames else 0

    @property
    def status(self) -> str:
        """Latency and dropped frames so far, for the progress line; empty unless the run is
        live.
        """
        recent = latency_ms(self.latency_s[-_N_RECENT:])
        if not recent:
            return ""
        return (
            f"latency {recent['p50']:.0f} ms, p95 {recent['p95']:.0f} ms, {self.n_dropped} dropped"
        )

    def captions(self) -> tuple[str, ...]:
        """Short texts for the corner of the overlay: rate of processing, latency, dropped
        frames.
        """
        rate = () if np.isnan(self.rate_hz) else (f"processed at {self.rate_hz:.1f} fps",)
        if not self.latency_s:
            return rate
        dropped = (f"{self.n_dropped} dropped",) if self.n_dropped else ()
        return (*rate, f"latency {1000 * self.latency_s[-1]:.0f} ms", *dropped)

    def notes(self) -> tuple[str, ...]:
        """Messages for the user after a live run."""
        if not self.latency_s:
            return ()
        ms = latency_ms(self.latency_s)
        shown = (
            f"median {ms['p50']:.0f} ms, 95 % below {ms['p95']:.0f} ms, maximum {ms['max']:.0f} ms"
        )
        latency = f"Latency from image to result: {shown}."
        if not (isinstance(self._live, PacedFrames) and self._live.n_dropped):
            return (latency,)
        n_frames = self._n_frames + self._live.n_dropped
        dropped = (
            f"{self._live.n_dropped} of {n_frames} frames were dropped, because the machine is too "
            "slow."
        )
        return (latency, f"--realtime: {dropped}")

    def summary(self) -> dict[str, Any]:
        """Entries of a live run for summary.json; no entries for other runs."""
        return (
            {"latency_ms": latency_ms(self.latency_s), "frames_dropped": self.n_dropped}
            if self.latency_s
            else {}
        )
