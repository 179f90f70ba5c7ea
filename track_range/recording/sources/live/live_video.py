"""LiveVideo: the newest frames of a camera or a network stream, read in a thread that never waits
for the consumer.

camera --> thread: demux, decode --> queue of the newest frames --> consumer; older frames are
dropped and counted
"""

from __future__ import annotations

import errno
import math
import threading
import time
from collections import deque
from collections.abc import Generator
from contextlib import suppress

import av
import numpy as np
from av.container import InputContainer
from av.video.stream import VideoStream

from track_range.foundation.files.images import MAX_PIXELS
from track_range.foundation.files.input_files import counted
from track_range.foundation.prefetch import lower_thread_priority
from track_range.recording.sources.live.address import LiveAddress
from track_range.recording.video.clock import ASSUMED_RATE, has_clock
from track_range.recording.video.frame import (
    TIME_EPSILON_S,
    VideoError,
    VideoFrame,
    bgr_image,
    is_neutral,
    stated_pixel_aspect,
)
from track_range.recording.video.threads import LIVE_FRAMES
from track_range.recording.video.utc import UtcStart
from track_range.recording.video.video import Video

_OPEN_S, SILENCE_S = 10.0, 5.0  # timeouts for opening a stream, and for its next frame, s
_SIZE_LIMIT = {"max_pixels": str(MAX_PIXELS)}  # FFmpeg's option for the largest size of an image
_FALLBACK_RATE_HZ = 25.0  # of a stream that does not declare one
_CAMERA_DELAY_S, _STREAM_DELAY_S = 0.1, 2.0  # largest delay from exposure to arrival; assumed
# longest time and number of frame intervals for the rate of a stream without times
_RATE_S, _N_STEPS = 2.0, 4
# largest difference between timestamp and arrival of a stream on this machine's clock
_SAME_CLOCK_S = 10.0
# frames for the offset: 10 s at 30 Hz, in which clocks that differ by 50 ppm drift by 0.5 ms
_N_OFFSETS = 300


class StreamClock:
    """Converts the timestamps of one stream to strictly increasing times of `time.monotonic` of
    this machine.

    Timestamps of cameras (Linux) already use that clock and stay as they are. Timestamps of a
    network stream have an arbitrary origin, and its frames arrive with varying delay; the frame
    with the shortest delay gives the offset:

        time_s = stamp_s + min(arrived_s - stamp_s)         over the most recent frames, to follow clock drift
    """

    def __init__(self) -> None:
        # whether the timestamps use this machine's clock; None = no frame yet
        self.is_shared: bool | None = None
        self._offsets_s: deque[float] = deque(maxlen=_N_OFFSETS)
        self._last_s = float("-inf")

    def time_s(self, stamp_s: float | None, arrived_s: float) -> float | None:
        """The time of a frame with a timestamp, if any, and an arrival; None if it is not after the
        previous frame.
        """
        if stamp_s is None:
            time_s = arrived_s
        else:
            if self.is_shared is None:
                self.is_shared = abs(arrived_s - stamp_s) < _SAME_CLOCK_S
            self._offsets_s.append(arrived_s - stamp_s)
            time_s = stamp_s + (0.0 if self.is_shared else min(self._offsets_s))
        if time_s <= self._last_s:
            return None
        self._last_s = time_s
        return time_s


class LiveVideo(Video):
    """An open camera or stream, read once: the iteration starts with the newest frame and closes
    the connection.

    The part to read begins after `start_s` and lasts `duration_s`; None = until the stream ends or
    the run is stopped. Each `every`-th frame is used, or of a right camera (`is_partner`) the
    frames that fit the left camera's frames.

    `n_received` frames were decoded so far, `n_taken` passed to the consumer; `ended_by` is
    FFmpeg's message if the connection was lost, `has_ended` whether the source ended the stream
    normally.

    Raises VideoError if the source cannot be opened, contains no video, or sends no frame; while
    iterating, if the connection is lost, or the image size changes.
    """

    is_live = True
    path: LiveAddress

    def __init__(
        self,
        address: LiveAddress,
        *,
        start_s: float = 0.0,
        duration_s: float | None = None,
        every: int = 1,
        is_partner: bool = False,
    ) -> None:
        self.path, self._every, self._is_partner = address, every, is_partner
        self._start_s, self._duration_s = start_s, math.inf if duration_s is None else duration_s
        self.clock = StreamClock()
        self.n_received = self.n_taken = 0
        self.ended_by, self.has_ended, self.is_over, self.is_closed = "", False, False, False
        self.busy_s = 0.0  # CPU time spent on converting frames
        # index, time and frame, which is converted only when it is used: a slow consumer drops most
        # of them
        self._waiting: deque[tuple[int, float, av.VideoFrame]] = deque(maxlen=LIVE_FRAMES)
        self._lock = threading.Lock()
        self._arrivals: list[threading.Event] = []
        self._is_closing = threading.Event()
        container = _opened(address)
        stream = container.streams.video[0]
        rate_hz = stream.average_rate or stream.guessed_rate
        self.fps = float(rate_hz) if rate_hz else _FALLBACK_RATE_HZ
        self._has_clock = has_clock(container, stream)
        first = threading.Event()
        self.notify(first)
        self._thread = threading.Thread(
            target=self._read, args=(container, stream), name="live", daemon=True
        )
        self._thread.start()
        first.wait(_OPEN_S)
        if not self._has_clock:
            self._wait_for_rate()
        if not self._waiting:
            self.close()
            raise VideoError(
                f"{address}: no frame received ({self.ended_by or 'timeout'}); check the camera."
            )
        image = bgr_image(self._waiting[-1][2])
        self.height_px, self.width_px = image.shape[:2]
        self.pixel_aspect = stated_pixel_aspect(stream.sample_aspect_ratio)
        self.is_grey = is_neutral(image)
        self.first_image = image
        self._utc_from_monotonic_s = time.time() - time.monotonic()
        # time of `time.monotonic` at which the reading started
        self.first_time_s = self.waiting_s()[0][1]

    def _wait_for_rate(self) -> None:
        """Take the rate of the arrivals; raises VideoError if the source is one image."""
        last_s = time.monotonic() + _RATE_S
        steps_s = np.zeros(0)
        while len(steps_s) < _N_STEPS and time.monotonic() < last_s and not self.is_over:
            time.sleep(_RATE_S / 100)
            # frames that arrived while the stream was opened come at once
            arrivals_s = np.array([time_s for _, time_s in self.waiting_s()])
            steps_s = np.diff(arrivals_s)[1:]
        if self.has_ended and self.n_received <= 1:  # FFmpeg drops it where it does not buffer
            self.close()
            raise VideoError(
                f"{self.path}: expected a stream, got a single image (a snapshot); give the "
                "address of the camera's video stream."
            )
        if len(steps_s):
            self.fps = float(1 / np.median(steps_s))

    @property
    def utc(self) -> UtcStart:
        """Time of this machine's clock at which the reading started."""
        delay_s = _CAMERA_DELAY_S if self.path.is_camera else _STREAM_DELAY_S
        return UtcStart(
            self.first_time_s + self._utc_from_monotonic_s, "clock of this computer", delay_s
        )

    @property
    def notes(self) -> tuple[str, ...]:
        """Messages for the user; empty until the reading has ended."""
        if not self.is_closed:
            return ()
        n_dropped = max(-(-self.n_received // self._every) - self.n_taken, 0)
        received, notes = counted(self.n_received, "frame"), []
        if self.has_ended:
            notes.append(f"{self.path}: the source ended the stream after {received}.")
        if n_dropped:
            processed = (
                f"{received} received, {self.n_taken} processed, {n_dropped} dropped (not paired, "
                "or processing too slow)"
            )
            processed += (
                "" if self._every == 1 else f", other frames left out by --every {self._every}"
            )
            notes.append(f"{self.path}: {processed}.")
        return tuple(notes)

    def notify(self, event: threading.Event) -> None:
        """Set this event whenever a frame arrives, and when the stream ends."""
        self._arrivals.append(event)

    def begin(self) -> None:
        """Start reading: times count from the newest waiting frame."""
        waiting = self.waiting_s()
        self.first_time_s = waiting[-1][1] if waiting else time.monotonic()

    def is_after_start(self, time_s: float) -> bool:
        """Whether a time is at or after the start of the part to read."""
        return time_s - self.first_time_s >= self._start_s - TIME_EPSILON_S

    def is_after_end(self, time_s: float) -> bool:
        """Whether a time is at or after the end of the part to read."""
        return time_s - self.first_time_s >= self._start_s + self._duration_s - TIME_EPSILON_S

    def waiting_s(self) -> list[tuple[int, float]]:
        """(index, time) of the waiting frames, oldest first."""
        with self._lock:
            return [(index, time_s) for index, time_s, _ in self._waiting]

    def take(self, index: int) -> VideoFrame | None:
        """The frame with the index; earlier frames are dropped. None = dropped; raises VideoError
        for another size.
        """
        began_s = time.thread_time()
        with self._lock:
            while self._waiting and self._waiting[0][0] < index:
                self._waiting.popleft()
            if not self._waiting or self._waiting[0][0] > index:
                return None
            _, time_s, stored = self._waiting.popleft()
        self.n_taken += 1
        width_px, height_px = stored.width, stored.height
        if (width_px, height_px) != (self.width_px, self.height_px):
            raise VideoError(
                f"{self.path}: expected images of {self.width_px}x{self.height_px} px, got "
                f"{width_px}x{height_px}; set the camera to a fixed image size."
            )
        frame = VideoFrame(index, time_s, bgr_image(stored))
        self.busy_s += time.thread_time() - began_s
        return frame

    def check(self) -> None:
        """Raise a VideoError if the connection was lost."""
        if self.ended_by:
            received = counted(self.n_received, "frame")
            raise VideoError(
                f"{self.path}: connection lost after {received} ({self.ended_by}); "
                "check the camera."
            )

    def close(self) -> None:
        """Stop the thread and close the connection."""
        self._is_closing.set()
        self._thread.join(_OPEN_S + SILENCE_S)
        self.is_closed = True

    def __iter__(self) -> Generator[VideoFrame, None, None]:
        try:
            yield from self.newest()
        finally:
            self.close()

    def ahead(self, name: str) -> Generator[VideoFrame, None, None]:
        """See `Video`; the thread of this source reads them."""
        return self.newest()

    def newest(self) -> Generator[VideoFrame, None, None]:
        """The frames, from the newest frame on; the connection stays open."""
        self.begin()
        arrival = threading.Event()
        self.notify(arrival)
        while True:
            arrival.clear()  # cleared first: a frame that arrives meanwhile sets it again
            is_over, newest = self.is_over, self.waiting_s()[-1:]
            if not newest and is_over:
                self.check()
                return
            if not newest and not arrival.wait(SILENCE_S):
                raise VideoError(
                    f"{self.path}: connection lost, no frame for {SILENCE_S:.0f} s; "
                    "check the camera."
                )
            for index, time_s in newest:
                if self.is_after_end(time_s):
                    return
                frame = self.take(index)
                if frame is not None and self.is_after_start(time_s):
                    yield frame

    def _read(self, container: InputContainer, stream: VideoStream) -> None:
        lower_thread_priority()
        try:
            with container:
                stream.codec_context.options = {**stream.codec_context.options, **_SIZE_LIMIT}
                stream.thread_type = "SLICE"  # frame threading would delay frames
                for packet in container.demux(stream):
                    if self._is_closing.is_set():
                        break
                    # the first packets may depend on an earlier keyframe
                    with suppress(av.error.InvalidDataError):
                        for frame in packet.decode():
                            self._enqueue(frame)
            self.has_ended = not self._is_closing.is_set()
        except av.FFmpegError as error:
            self.ended_by = "" if self._is_closing.is_set() else _reason(error)
        self.is_over = True
        for event in self._arrivals:
            event.set()

    def _enqueue(self, frame: av.VideoFrame) -> None:
        stamp_s = (
            None
            if not self._has_clock or frame.pts is None or frame.time_base is None
            else float(frame.pts * frame.time_base)
        )
        index, self.n_received = self.n_received, self.n_received + 1
        time_s = self.clock.time_s(stamp_s, time.monotonic())
        if time_s is None or frame.is_corrupt or (index % self._every and not self._is_partner):
            return
        with self._lock:
            self._waiting.append((index, time_s, frame))
        for event in self._arrivals:
            event.set()


def _opened(address: LiveAddress) -> InputContainer:
    try:
        container = av.open(
            address.url,
            mode="r",
            format="v4l2" if address.is_camera else None,
            options={
                **address.options,
                **_SIZE_LIMIT,
                **({} if address.is_camera else ASSUMED_RATE),
            },
            timeout=(_OPEN_S, SILENCE_S),
        )
    except (av.FFmpegError, ValueError) as error:
        noun = "camera" if address.is_camera else "stream"
        reason = _reason(error, timeout_s=_OPEN_S)
        check = (
            "choose a camera, such as 0 for /dev/video0"
            if address.is_camera
            else "check the address"
        )
        raise VideoError(f"{address}: the {noun} cannot be opened ({reason}); {check}.") from error
    if not container.streams.video:
        container.close()
        raise VideoError(f"{address}: the stream contains no video; check the address.")
    return container


def _reason(error: Exception, *, timeout_s: float = SILENCE_S) -> str:
    if isinstance(error, av.error.ExitError):
        return f"no answer for {timeout_s:.0f} s"
    if getattr(error, "errno", None) == errno.ENOTTY:
        return "it is another kind of device"
    return getattr(error, "strerror", None) or str(error)
