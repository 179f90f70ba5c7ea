"""LiveReader: iterates over the frames of a camera or stream; gives the newest frame and drops older ones."""

from __future__ import annotations

import math
import threading
import time
from collections.abc import Generator

from track_range.foundation.files.input_files import counted
from track_range.recording.frame import TIME_EPSILON_S, VideoError, VideoFrame
from track_range.recording.live.address import LiveAddress
from track_range.recording.live.stream import SILENCE_S, LiveStream
from track_range.recording.utc import UtcStart

_CAMERA_DELAY_S, _STREAM_DELAY_S = 0.1, 2.0
"""Largest delay, s, between exposure and arrival of the frames of a camera and of a network stream; assumed."""


class LiveReader:
    """Frames of a camera or stream, read once: the iteration starts with the newest frame and closes the connection.

    Args:
        address: the camera or stream.
        start_s: time in s to skip at the beginning.
        duration_s: length of the part to read; None = until the stream ends or the run is stopped.

    Attributes:
        path: the address.
        width_px, height_px, is_grey, fps: see `VideoReader`.
        first_time_s: time of `time.monotonic` at which the reading started.
        n_frames: None = unknown.
        busy_s: CPU time spent on converting frames.
        is_closed: whether the connection has been closed.

    Raises:
        VideoError: the source cannot be opened. While iterating: the connection is lost, or the image size changes.
    """

    n_frames: int | None = None

    def __init__(self, address: LiveAddress, *, start_s: float = 0.0, duration_s: float | None = None) -> None:
        self.path = address
        self.stream = LiveStream(address)
        self.width_px, self.height_px = self.stream.width_px, self.stream.height_px
        self.is_grey, self.fps = self.stream.is_grey, self.stream.fps
        self._start_s, self._duration_s = start_s, math.inf if duration_s is None else duration_s
        self.busy_s, self.is_closed = 0.0, False
        self._utc_from_monotonic_s = time.time() - time.monotonic()
        self.first_time_s = self.stream.waiting_s()[0][1]
        self._first_index = 0

    @property
    def utc(self) -> UtcStart:
        """Time of this machine's clock at which the reading started."""
        delay_s = _CAMERA_DELAY_S if self.path.is_camera else _STREAM_DELAY_S
        return UtcStart(self.first_time_s + self._utc_from_monotonic_s, "clock of this computer", delay_s)

    @property
    def notes(self) -> tuple[str, ...]:
        """Messages for the user; empty until the reading has ended."""
        stream = self.stream
        if not self.is_closed:
            return ()
        n_dropped = stream.n_received - stream.n_taken
        received = counted(stream.n_received, "frame")
        ended = (f"{self.path}: the source ended the stream after {received}.",) if stream.has_ended else ()
        if not n_dropped:
            return ended
        return (
            *ended,
            f"{self.path}: {received} received, {stream.n_taken} processed, {n_dropped} dropped (busy or unpaired).",
        )

    def begin(self) -> None:
        """Start reading: times count from the newest waiting frame."""
        waiting = self.stream.waiting_s()
        self.first_time_s = waiting[-1][1] if waiting else time.monotonic()

    def is_after_start(self, time_s: float) -> bool:
        """Whether a time is at or after the start of the part to read."""
        return time_s - self.first_time_s >= self._start_s - TIME_EPSILON_S

    def is_after_end(self, time_s: float) -> bool:
        """Whether a time is at or after the end of the part to read."""
        return time_s - self.first_time_s >= self._start_s + self._duration_s - TIME_EPSILON_S

    def take(self, index: int) -> VideoFrame | None:
        """The frame with this index; None = it has been dropped in the meantime."""
        began_s = time.thread_time()
        frame = self.stream.take(index)
        self.busy_s += time.thread_time() - began_s
        return frame

    def close(self) -> None:
        """Close the connection."""
        self.stream.close()
        self.is_closed = True

    def __iter__(self) -> Generator[VideoFrame, None, None]:
        self.begin()
        try:
            yield from self._newest()
        finally:
            self.close()

    def _newest(self) -> Generator[VideoFrame, None, None]:
        arrival = threading.Event()
        self.stream.notify(arrival)
        while True:
            arrival.clear()  # cleared first: a frame that arrives meanwhile sets it again
            is_over, newest = self.stream.is_over, self.stream.waiting_s()[-1:]
            if not newest and is_over:
                self.stream.check()
                return
            if not newest and not arrival.wait(SILENCE_S):
                raise VideoError(f"{self.path}: connection lost, no frame for {SILENCE_S:.0f} s; check the camera.")
            for index, time_s in newest:
                if self.is_after_end(time_s):
                    return
                frame = self.take(index)
                if frame is not None and self.is_after_start(time_s):
                    yield frame
