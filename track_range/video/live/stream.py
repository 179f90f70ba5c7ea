"""LiveStream: the newest images of a camera or a network stream, read in a thread that never waits for the run.

camera --> thread: demux, decode --> [ the last few images ] --> whoever takes one; older ones are dropped and counted
"""

from __future__ import annotations

import threading
import time
from collections import deque
from contextlib import suppress
from dataclasses import dataclass

import av
import numpy as np
from av.container import InputContainer
from av.video.stream import VideoStream

from track_range.run.prefetch import lower_thread_priority
from track_range.video.frame import VideoError, VideoFrame, counted, is_neutral
from track_range.video.live.address import LiveAddress
from track_range.video.live.clock import StreamClock
from track_range.video.threads import LIVE_FRAMES

_OPEN_S, SILENCE_S = 10.0, 5.0
"""So long may a stream take to open, and be silent; then it is given up."""

_FALLBACK_RATE_HZ = 25.0


@dataclass(frozen=True, slots=True)
class _Held:
    """An image that waits, not yet converted: most conversions of a slow run would be for nothing."""

    index: int
    time_s: float
    frame: av.VideoFrame


class LiveStream:
    """An open camera or stream.

    Attributes:
        address: what was opened.
        fps: nominal rate.
        clock: where the images' times come from.
        width_px, height_px: size of the images.
        is_grey: the first one has no colour.
        n_received: images decoded so far.
        n_taken: images handed on.
        ended_by: why the stream is over, in FFmpeg's words; empty = it ended as a file does, or runs still.
        has_ended: whether it ended as a file does, and was not closed.

    Raises:
        VideoError: it cannot be opened, holds no video, or no image comes.
    """

    def __init__(self, address: LiveAddress) -> None:
        self.address = address
        self.clock = StreamClock()
        self.n_received = self.n_taken = 0
        self.ended_by, self.has_ended, self._is_over = "", False, False
        self._held: deque[_Held] = deque(maxlen=LIVE_FRAMES)
        self._lock = threading.Lock()
        self._news: list[threading.Event] = []
        self._is_unwanted = threading.Event()
        container = _opened(address)
        stream = container.streams.video[0]
        rate_hz = stream.average_rate or stream.guessed_rate
        self.fps = float(rate_hz) if rate_hz else _FALLBACK_RATE_HZ
        first = self.news()
        self._thread = threading.Thread(target=self._read, args=(container, stream), name="live", daemon=True)
        self._thread.start()
        if not (first.wait(_OPEN_S) and self._held):
            self.close()
            raise VideoError(f"{address}: no frame received ({self.ended_by or 'timeout'}): check the camera.")
        image = self._held[-1].frame.to_ndarray(format="bgr24").astype(np.uint8, copy=False)
        self.height_px, self.width_px = image.shape[:2]
        self.is_grey = is_neutral(image)

    @property
    def is_over(self) -> bool:
        """Whether no more images will come."""
        return self._is_over

    def news(self) -> threading.Event:
        """A new event that is set whenever an image has come, or the stream is over."""
        event = threading.Event()
        self.listen(event)
        return event

    def listen(self, event: threading.Event) -> None:
        """Set this event, too, from now on."""
        self._news.append(event)

    def waiting_s(self) -> list[tuple[int, float]]:
        """(index, time) of the images that wait, oldest first."""
        with self._lock:
            return [(held.index, held.time_s) for held in self._held]

    def take(self, index: int) -> VideoFrame | None:
        """The image of this index, converted; those before it are dropped. None = it has been dropped itself.

        Raises:
            VideoError: its size is not the first one's.
        """
        with self._lock:
            while self._held and self._held[0].index < index:
                self._held.popleft()
            held = self._held.popleft() if self._held and self._held[0].index == index else None
        if held is None:
            return None
        self.n_taken += 1
        if (held.frame.width, held.frame.height) != (self.width_px, self.height_px):
            raise VideoError(
                f"{self.address}: its images change from {self.width_px}x{self.height_px} to "
                f"{held.frame.width}x{held.frame.height}: let the camera keep one size."
            )
        image = held.frame.to_ndarray(format="bgr24").astype(np.uint8, copy=False)
        return VideoFrame(held.index, held.time_s, image)

    def check(self) -> None:
        """Whether the stream ended as it should, once it is over.

        Raises:
            VideoError: it broke off.
        """
        if self.ended_by:
            raise VideoError(f"{self.address}: broke off after {counted(self.n_received, 'frame')} ({self.ended_by}).")

    def close(self) -> None:
        """End the thread, and with it the connection."""
        self._is_unwanted.set()
        self._thread.join(_OPEN_S + SILENCE_S)

    def _read(self, container: InputContainer, stream: VideoStream) -> None:
        lower_thread_priority()
        try:
            with container:
                self._receive(container, stream)
            self.has_ended = not self._is_unwanted.is_set()
        except av.FFmpegError as error:
            self.ended_by = "" if self._is_unwanted.is_set() else _reason(error)
        self._is_over = True
        self._tell()

    def _receive(self, container: InputContainer, stream: VideoStream) -> None:
        stream.thread_type = "SLICE"  # threads by frame would hold images back
        for packet in container.demux(stream):
            if self._is_unwanted.is_set():
                return
            with suppress(av.error.InvalidDataError):  # whoever joins a stream meets images whose start was before
                for frame in packet.decode():
                    self._keep(frame)

    def _keep(self, frame: av.VideoFrame) -> None:
        stamp_s = None if frame.pts is None or frame.time_base is None else float(frame.pts * frame.time_base)
        index, self.n_received = self.n_received, self.n_received + 1
        time_s = self.clock.time_s(stamp_s, time.monotonic())
        if time_s is None or frame.is_corrupt:
            return
        with self._lock:
            self._held.append(_Held(index, time_s, frame))
        self._tell()

    def _tell(self) -> None:
        for event in self._news:
            event.set()


def _opened(address: LiveAddress) -> InputContainer:
    try:
        container = av.open(
            address.url, mode="r", format=address.format, options=address.options, timeout=(_OPEN_S, SILENCE_S)
        )
    except (av.FFmpegError, ValueError) as error:
        what = "camera" if address.is_camera else "stream"
        reason = _reason(error, silence_s=_OPEN_S)
        raise VideoError(f"{address}: this {what} cannot be opened ({reason}).") from error
    if not container.streams.video:
        container.close()
        raise VideoError(f"{address}: holds no video.")
    return container


def _reason(error: Exception, *, silence_s: float = SILENCE_S) -> str:
    if isinstance(error, av.error.ExitError):
        return f"no answer for {silence_s:.0f} s"
    return getattr(error, "strerror", None) or str(error)
