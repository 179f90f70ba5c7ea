"""LivePair: two live streams paired by time: always the newest two images of one instant.

left   |  a    b    c    d   |    each left image that waits is paired with the nearest right one; the newest
right  |    A    B    C      |    pair that is near enough is taken, here (c, C), and all before it is dropped
"""

from __future__ import annotations

import threading
from collections.abc import Generator

import numpy as np

from track_range.video.frame import VideoError, VideoFrame, counted
from track_range.video.live.reader import LiveReader
from track_range.video.live.stream import SILENCE_S

_SHARED_CLOCK_INTERVALS, _ARRIVAL_INTERVALS = 0.25, 0.5
"""The largest difference of time within a pair, in frame intervals: where stamps can be compared, and where only
arrival times are known, which lets every image find a partner."""


class LivePair:
    """Pairs of images of two live streams; iterating starts with what comes now.

    Attributes:
        left, right: the readers.
        tolerance_s: the largest difference of time within a pair.

    Raises:
        VideoError: while iterating: one broke off, or their images come at different times.
    """

    def __init__(self, left: LiveReader, right: LiveReader) -> None:
        self.left, self.right = left, right
        self._is_shared = all(reader.stream.clock.is_shared for reader in (left, right))
        intervals = _SHARED_CLOCK_INTERVALS if self._is_shared else _ARRIVAL_INTERVALS
        self.tolerance_s = intervals / max(left.fps, right.fps)
        self._apart_s: list[float] = []
        self._n_pairs = 0

    @property
    def notes(self) -> tuple[str, ...]:
        """Sentences for the user, once it is over."""
        if not self.left.is_closed or not self._apart_s or self._is_shared:
            return ()
        return (
            f"Left and right come over a network and are paired by when they arrive, {counted(self._n_pairs, 'pair')} "
            f"a median of {1000 * np.median(self._apart_s):.0f} ms apart: what moves is ranged wrongly by as much.",
        )

    def close(self) -> None:
        """End both connections."""
        for reader in (self.left, self.right):
            reader.close()

    def __iter__(self) -> Generator[tuple[VideoFrame, VideoFrame], None, None]:
        self.left.begin()
        news = threading.Event()
        readers = (self.left, self.right)
        for reader in readers:
            reader.stream.listen(news)
        while True:
            news.clear()  # cleared first: a frame that arrives meanwhile sets it again
            is_over = any(reader.stream.is_over for reader in readers)
            found = self._newest()
            if found is not None and self.left.is_past(found[1]):
                return
            if found is not None:
                yield from self._taken(*found)
            elif is_over:
                self._check()
                return
            elif not news.wait(SILENCE_S):
                raise VideoError(f"{self.left.path} and {self.right.path}: no images for {SILENCE_S:.0f} s.")

    def _newest(self) -> tuple[int, float, int, float] | None:
        """Index and time of the left and the right image of the newest pair that waits."""
        left, right = self.left.stream.waiting_s(), self.right.stream.waiting_s()
        if not left or not right:
            return None
        right_s = np.array([time_s for _, time_s in right])
        for index, time_s in reversed(left):
            nearest = int(np.argmin(np.abs(right_s - time_s)))
            if abs(right_s[nearest] - time_s) <= self.tolerance_s:
                return index, time_s, *right[nearest]
        return None

    def _taken(
        self, left_index: int, left_s: float, right_index: int, right_s: float
    ) -> Generator[tuple[VideoFrame, VideoFrame], None, None]:
        left, right = self.left.take(left_index), self.right.take(right_index)
        if left is None or right is None or not self.left.is_wanted(left_s):
            return
        self._n_pairs += 1
        self._apart_s.append(abs(right_s - left_s))
        yield left, right

    def _check(self) -> None:
        for reader in (self.left, self.right):
            reader.stream.check()
        if not self._n_pairs:
            raise VideoError(
                f"{self.left.path} and {self.right.path}: no images of one instant, "
                f"{1000 * self.tolerance_s:.0f} ms apart at most."
            )
