r"""VideoPair: the frames of two videos, paired by time; the first pairs can be read before the main pass.

pairs -> read_ahead() -> alignment, checks
               \-> buffer of at most `max_ahead_bytes` -> iteration: buffered pairs first (freed one by one), the rest
"""

from abc import ABC, abstractmethod
from collections import deque
from collections.abc import Callable, Generator
from contextlib import closing
from typing import Generic, TypeVar

from track_range.recording.video.frame import VideoFrame
from track_range.recording.video.video import Video

V = TypeVar("V", bound=Video)

Pair = tuple[VideoFrame, VideoFrame]


class VideoPair(ABC, Generic[V]):
    """Pairs of frames of two videos; the first pairs may be read before the iteration, and are not
    decoded twice.

    The buffer always holds one pair. If more than `max_ahead_bytes` are needed, it is dropped and
    reading restarts: recorded videos from their start, live videos with the next pair. Times differ
    by at most `tolerance_s`.
    """

    is_live: bool = False

    def __init__(self, left: V, right: V, *, tolerance_s: float, max_ahead_bytes: int) -> None:
        self.left: V = left
        self.right: V = right
        self.tolerance_s = tolerance_s
        self._max_bytes = max_ahead_bytes
        self._unread: Generator[Pair, None, None] | None = None
        self._n_bytes = 0  # of the buffer
        self._ahead: deque[Callable[[], Pair]] = deque()

    @property
    @abstractmethod
    def notes(self) -> tuple[str, ...]:
        """Messages for the user; complete only after the last pair."""

    @abstractmethod
    def pairs(self) -> Generator[Pair, None, None]:
        """The pairs, read from the start of recorded videos, or from the newest frames of live
        videos.
        """

    def read_ahead(self) -> Generator[Pair, None, None]:
        """The first pairs, until the caller stops, before the iteration; a later call starts with
        them again.
        """
        yield from (unpacked() for unpacked in tuple(self._ahead))
        unread, is_full = self._unread or self.pairs(), False
        self._unread = unread
        try:
            for pair in unread:
                n_bytes, unpacked = self._packed(pair)
                self._n_bytes += n_bytes
                is_full |= bool(self._ahead) and self._n_bytes > self._max_bytes
                if is_full:
                    self._ahead.clear()
                else:
                    self._ahead.append(unpacked)
                yield pair
        finally:
            if is_full:
                unread.close()
                self._unread, self._n_bytes = None, 0

    def _packed(self, pair: Pair) -> tuple[int, Callable[[], Pair]]:
        """Size of a pair in memory with its images in the smaller format, and a function that
        returns it.
        """
        left, right = (frame.packed() for frame in pair)
        return sum(frame.n_packed_bytes for frame in pair), lambda: (left(), right())

    def __iter__(self) -> Generator[Pair, None, None]:
        unread, self._unread = self._unread or self.pairs(), None
        with closing(unread):
            while self._ahead:
                yield self._ahead.popleft()()
            yield from unread

    def restart(self) -> None:
        """Free the buffer, and read from the start again."""
        self._ahead.clear()
        if self._unread is not None:
            self._unread.close()
        self._unread, self._n_bytes = None, 0

    def close(self) -> None:
        """Stop reading, free the buffer, and close both videos."""
        self.restart()
        self.left.close()
        self.right.close()
