"""LivePair: two live streams, paired by time; gives the newest pair of frames.

left   |  a    b    c    d   |    each waiting left frame is paired with the nearest right frame; the newest pair
right  |    A    B    C      |    within the tolerance is used, here (c, C), and all earlier frames are dropped
"""

from __future__ import annotations

import threading
from collections.abc import Generator

import numpy as np

from track_range.foundation.files.input_files import counted
from track_range.recording.frame import VideoError, VideoFrame
from track_range.recording.live.reader import LiveReader
from track_range.recording.live.stream import SILENCE_S

_SHARED_CLOCK_INTERVALS = 0.25
"""Largest time difference within a pair, in frame intervals, if both streams use the same clock."""

_ARRIVAL_INTERVALS = 0.5
"""Largest time difference within a pair, in frame intervals, if only arrival times are known; every frame then finds a
partner."""


class LivePair:
    """Pairs of frames of two live streams; the iteration starts with the newest frames.

    Attributes:
        left, right: the readers.
        tolerance_s: largest time difference within a pair.

    Raises:
        VideoError: while iterating: a connection is lost, or no frames are close enough in time.
    """

    def __init__(self, left: LiveReader, right: LiveReader) -> None:
        self.left, self.right = left, right
        self._is_shared = all(reader.stream.clock.is_shared for reader in (left, right))
        intervals = _SHARED_CLOCK_INTERVALS if self._is_shared else _ARRIVAL_INTERVALS
        self.tolerance_s = intervals / max(left.fps, right.fps)
        self._differences_s: list[float] = []
        self._n_pairs = 0

    @property
    def notes(self) -> tuple[str, ...]:
        """Messages for the user; empty until the reading has ended."""
        if not self.left.is_closed or not self._differences_s or self._is_shared:
            return ()
        median_ms = 1000 * np.median(self._differences_s)
        return (
            f"Left and right frames of the network streams are paired by arrival time, "
            f"{counted(self._n_pairs, 'pair')} with a median difference of {median_ms:.0f} ms: stereo distances of "
            "moving objects are less accurate.",
        )

    def close(self) -> None:
        """Close both connections."""
        for reader in (self.left, self.right):
            reader.close()

    def __iter__(self) -> Generator[tuple[VideoFrame, VideoFrame], None, None]:
        self.left.begin()
        arrival = threading.Event()
        readers = (self.left, self.right)
        for reader in readers:
            reader.stream.notify(arrival)
        while True:
            arrival.clear()  # cleared first: a frame that arrives meanwhile sets it again
            is_over = any(reader.stream.is_over for reader in readers)
            newest = self._newest()
            if newest is not None and self.left.is_after_end(newest[1]):
                return
            if newest is not None:
                yield from self._read_pair(*newest)
            elif is_over:
                self._check()
                return
            elif not arrival.wait(SILENCE_S):
                raise VideoError(
                    f"{self.left.path} and {self.right.path}: no frame for {SILENCE_S:.0f} s; check the cameras."
                )

    def _newest(self) -> tuple[int, float, int, float] | None:
        """Index and time of the left frame, then of the right frame, of the newest waiting pair; None = no pair."""
        left, right = self.left.stream.waiting_s(), self.right.stream.waiting_s()
        if not left or not right:
            return None
        right_s = np.array([time_s for _, time_s in right])
        for index, time_s in reversed(left):
            nearest = int(np.argmin(np.abs(right_s - time_s)))
            if abs(right_s[nearest] - time_s) <= self.tolerance_s:
                return index, time_s, *right[nearest]
        return None

    def _read_pair(
        self, left_index: int, left_s: float, right_index: int, right_s: float
    ) -> Generator[tuple[VideoFrame, VideoFrame], None, None]:
        left, right = self.left.take(left_index), self.right.take(right_index)
        if left is None or right is None or not self.left.is_after_start(left_s):
            return
        self._n_pairs += 1
        self._differences_s.append(abs(right_s - left_s))
        yield left, right

    def _check(self) -> None:
        for reader in (self.left, self.right):
            reader.stream.check()
        if not self._n_pairs:
            raise VideoError(
                f"{self.left.path} and {self.right.path}: expected pairs of frames at most "
                f"{1000 * self.tolerance_s:.0f} ms apart, found none; synchronise the cameras."
            )
