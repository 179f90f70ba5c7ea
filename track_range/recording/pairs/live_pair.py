"""LivePair: two live streams, paired by time; gives the newest pair of frames.

left   |  a    b    c    d   |    each waiting left frame is paired with the nearest right frame; the newest pair
right  |    A    B    C      |    within the tolerance is used, here (c, C), and all earlier frames are dropped
"""

import threading
from collections.abc import Generator

import numpy as np

from track_range.foundation.files.input_files import counted
from track_range.recording.pairs.video_pair import Pair, VideoPair
from track_range.recording.sources.live.live_video import SILENCE_S, LiveVideo
from track_range.recording.video.frame import VideoError

# largest time difference within a pair, in frame intervals, if both use one clock
_SHARED_CLOCK_INTERVALS = 0.25
# largest time difference within a pair, in frame intervals, if only arrival times are known
_ARRIVAL_INTERVALS = 0.5


class LivePair(VideoPair[LiveVideo]):
    """Pairs of frames of two live streams; the iteration starts with the newest frames.

    While iterating, raises VideoError if a connection is lost, or no frames are close enough in
    time.
    """

    is_live = True

    def __init__(self, left: LiveVideo, right: LiveVideo) -> None:
        self._is_shared = all(video.clock.is_shared for video in (left, right))
        intervals = _SHARED_CLOCK_INTERVALS if self._is_shared else _ARRIVAL_INTERVALS
        super().__init__(
            left, right, tolerance_s=intervals / max(left.fps, right.fps), max_ahead_bytes=0
        )
        self._differences_s: list[float] = []

    @property
    def notes(self) -> tuple[str, ...]:
        """Messages for the user; empty until the reading has ended."""
        if not self.left.is_closed or not self._differences_s or self._is_shared:
            return ()
        median_ms = 1000 * np.median(self._differences_s)
        return (
            "Left and right frames of the network streams are paired by arrival time, "
            f"{counted(len(self._differences_s), 'pair')} with a median difference of "
            f"{median_ms:.0f} ms: stereo distances of moving objects are less accurate.",
        )

    def pairs(self) -> Generator[Pair, None, None]:
        """The pairs, from the newest frames on."""
        self.left.begin()
        arrival = threading.Event()
        for video in (self.left, self.right):
            video.notify(arrival)
        while True:
            arrival.clear()  # cleared first: a frame that arrives meanwhile sets it again
            is_over = self.left.is_over or self.right.is_over
            newest = self._newest()
            if newest is not None and self.left.is_after_end(newest[1]):
                return
            if newest is not None:
                left_index, left_s, right_index, right_s = newest
                left, right = self.left.take(left_index), self.right.take(right_index)
                if left is not None and right is not None and self.left.is_after_start(left_s):
                    self._differences_s.append(abs(right_s - left_s))
                    yield left, right
            elif is_over:
                for video in (self.left, self.right):
                    video.check()
                if not self._differences_s:
                    raise VideoError(
                        f"{self.left.path} and {self.right.path}: expected pairs of frames at most "
                        f"{1000 * self.tolerance_s:.0f} ms apart, found none; synchronise the "
                        "cameras."
                    )
                return
            elif not arrival.wait(SILENCE_S):
                raise VideoError(
                    f"{self.left.path} and {self.right.path}: no frame for {SILENCE_S:.0f} s; "
                    "check the cameras."
                )

    def _newest(self) -> tuple[int, float, int, float] | None:
        """Index and time of the left frame, then of the right frame, of the newest waiting pair;
        None = no pair.
        """
        left, right = self.left.waiting_s(), self.right.waiting_s()
        if not left or not right:
            return None
        right_s = np.array([time_s for _, time_s in right])
        for index, time_s in reversed(left):
            nearest = int(np.argmin(np.abs(right_s - time_s)))
            if abs(right_s[nearest] - time_s) <= self.tolerance_s:
                return index, time_s, *right[nearest]
        return None
