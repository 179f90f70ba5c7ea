"""StreamClock: converts the timestamps of live streams to one clock, `time.monotonic` of this machine.

Timestamps of cameras (Linux) already use that clock and stay as they are. Those of a network stream have an arbitrary
origin, and its frames arrive with varying delay; the frame with the shortest delay gives the offset of the clock:

    time_s = stamp_s + min(arrived_s - stamp_s)         over the most recent frames, to follow clock drift
"""

from __future__ import annotations

from collections import deque

SAME_CLOCK_S = 10.0
"""Largest difference, s, between timestamp and arrival time of a stream that uses this machine's clock."""

_N_OFFSETS = 300
"""Number of recent frames for the offset: 10 s at 30 Hz, in which clocks that differ by 50 ppm drift by 0.5 ms."""


class StreamClock:
    """Converts the timestamps of one stream to strictly increasing times.

    Attributes:
        is_shared: whether the timestamps use this machine's clock; None = no frame yet.
    """

    def __init__(self) -> None:
        self.is_shared: bool | None = None
        self._offsets_s: deque[float] = deque(maxlen=_N_OFFSETS)
        self._last_s = float("-inf")

    def time_s(self, stamp_s: float | None, arrived_s: float) -> float | None:
        """The time of a frame; None if it is not later than the previous one.

        Args:
            stamp_s: timestamp of the frame; None = none.
            arrived_s: arrival time of the frame.
        """
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
