"""StreamClock: one clock for the images of several live streams: this machine's, `time.monotonic`.

A camera's stamps are that clock already (Linux), and are taken as they are. A network stream counts from a time of its
own, and its images arrive with varying delay; the one with the least delay gives the offset of its clock:

    time_s = stamp_s + min(arrived_s - stamp_s)         over the last images, so that a drifting clock is followed
"""

from __future__ import annotations

from collections import deque

SAME_CLOCK_S = 10.0
"""Stamps so near to the time at which their images arrive are of this machine's own clock."""

_REMEMBERED = 300  # images: 10 s at 30 Hz, in which clocks that differ by 50 ppm drift by half a millisecond


class StreamClock:
    """The times of one stream's images; they increase strictly.

    Attributes:
        is_shared: whether the stamps are this machine's own clock's; None = no image yet.
    """

    def __init__(self) -> None:
        """No image yet."""
        self.is_shared: bool | None = None
        self._offsets_s: deque[float] = deque(maxlen=_REMEMBERED)
        self._last_s = float("-inf")

    def time_s(self, stamp_s: float | None, arrived_s: float) -> float | None:
        """The time of an image with this stamp (None = it has none); None = not later than the one before."""
        if stamp_s is None:
            time_s = arrived_s
        else:
            if self.is_shared is None:
                self.is_shared = abs(arrived_s - stamp_s) < SAME_CLOCK_S
            self._offsets_s.append(arrived_s - stamp_s)
            time_s = stamp_s + (0.0 if self.is_shared else min(self._offsets_s))
        if time_s <= self._last_s:
            return None
        self._last_s = time_s
        return time_s
