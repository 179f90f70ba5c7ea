"""LiveReader: a camera or a stream read as a video is, but as it happens: always the newest image."""

from __future__ import annotations

import math
import time
from collections.abc import Generator

from track_range.video.frame import TIME_EPSILON_S, VideoError, VideoFrame, counted
from track_range.video.live.address import LiveAddress
from track_range.video.live.stream import SILENCE_S, LiveStream


class LiveReader:
    """Read as a `VideoReader` is, but once: iterating starts at what comes now, and ends the connection in the end.

    Args:
        address: the camera or stream.
        start_s: so much is let pass first.
        duration_s: how much is read then; None = until it ends, or the run is stopped.

    Attributes:
        path: the address.
        width_px, height_px, is_grey, fps: as of `VideoReader`.
        first_time_s: time at which the present reading began, of `time.monotonic`.
        n_frames: None: unknown.
        busy_s: processor time spent on handing images on.
        is_closed: whether the connection has been ended.

    Raises:
        VideoError: it cannot be opened. While iterating: it broke off, or its images change their size.
    """

    n_frames: int | None = None

    def __init__(self, address: LiveAddress, *, start_s: float = 0.0, duration_s: float | None = None) -> None:
        self.path = address
        self.stream = LiveStream(address)
        self.width_px, self.height_px = self.stream.width_px, self.stream.height_px
        self.is_grey, self.fps = self.stream.is_grey, self.stream.fps
        self._start_s, self._duration_s = start_s, math.inf if duration_s is None else duration_s
        self.busy_s, self.is_closed = 0.0, False
        self.first_time_s = self.stream.waiting_s()[0][1]
        self._first_index = 0

    @property
    def notes(self) -> tuple[str, ...]:
        """Sentences for the user, once it is over."""
        stream = self.stream
        if not self.is_closed:
            return ()
        n_dropped = stream.n_received - stream.n_taken
        received = counted(stream.n_received, "frame")
        ended = (f"{self.path}: the stream ended by itself after {received}.",) if stream.has_ended else ()
        if not n_dropped:
            return ended
        return (
            *ended,
            f"{self.path}: {received} received, {stream.n_taken} processed, {n_dropped} dropped (busy or unpaired).",
        )

    def begin(self) -> None:
        """Start a reading: times count from the newest image that waits."""
        waiting = self.stream.waiting_s()
        self.first_time_s = waiting[-1][1] if waiting else time.monotonic()

    def is_wanted(self, time_s: float) -> bool:
        """Whether a frame of this time is in the part to be read, which may yet begin."""
        return time_s - self.first_time_s >= self._start_s - TIME_EPSILON_S

    def is_past(self, time_s: float) -> bool:
        """Whether a frame of this time comes after the part to be read."""
        return time_s - self.first_time_s >= self._start_s + self._duration_s - TIME_EPSILON_S

    def take(self, index: int) -> VideoFrame | None:
        """The image of this index; None = it has been dropped meanwhile."""
        began_s = time.thread_time()
        frame = self.stream.take(index)
        self.busy_s += time.thread_time() - began_s
        return frame

    def close(self) -> None:
        """End the connection."""
        self.stream.close()
        self.is_closed = True

    def __iter__(self) -> Generator[VideoFrame, None, None]:
        self.begin()
        try:
            yield from self._newest()
        finally:
            self.close()

    def _newest(self) -> Generator[VideoFrame, None, None]:
        news = self.stream.news()
        while True:
            news.clear()  # cleared first: a frame that arrives meanwhile sets it again
            is_over, newest = self.stream.is_over, self.stream.waiting_s()[-1:]
            if not newest and is_over:
                self.stream.check()
                return
            if not newest and not news.wait(SILENCE_S):
                raise VideoError(f"{self.path}: broke off: no image for {SILENCE_S:.0f} s.")
            for index, time_s in newest:
                if self.is_past(time_s):
                    return
                frame = self.take(index)
                if frame is not None and self.is_wanted(time_s):
                    yield frame
