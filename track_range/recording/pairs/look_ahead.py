r"""LookAhead: reads the first pairs of two videos before the main pass, and buffers them so that they are decoded once.

pairs -> read_ahead() -> alignment, checks
               \-> buffer of at most `max_bytes` -> iteration: buffered pairs first (freed one by one), then the rest

Live streams are not buffered: the iteration starts with the newest pair.
"""

from __future__ import annotations

from collections import deque
from collections.abc import Callable, Generator
from contextlib import closing

from track_range.recording.frame import VideoFrame
from track_range.recording.live.pair import LivePair
from track_range.recording.pairs.pairing import StereoVideo

Pair = tuple[VideoFrame, VideoFrame]


class LookAhead:
    """Pairs of two videos, the first of which may be read once before the iteration.

    Args:
        pairs: the two videos.
        max_bytes: size of the buffer, which always holds one pair. If more pairs do not fit, the buffer is dropped and
            the iteration restarts: recorded videos from their start, live ones with the next pair.
    """

    def __init__(self, pairs: StereoVideo | LivePair, *, max_bytes: int) -> None:
        self.pairs = pairs
        self._max_bytes = max_bytes
        self._unread: Generator[Pair, None, None] | None = None
        self._buffer: deque[tuple[Callable[[], VideoFrame], Callable[[], VideoFrame]]] = deque()
        self._n_bytes = 0
        self._is_full = False

    @property
    def n_buffered(self) -> int:
        """Number of pairs in the buffer."""
        return len(self._buffer)

    def read_ahead(self) -> Generator[Pair, None, None]:
        """The first pairs, until the caller stops; to be called at most once, before the iteration."""
        self._unread = iter(self.pairs)
        for left, right in self._unread:
            self._n_bytes += left.n_packed_bytes + right.n_packed_bytes
            self._is_full |= bool(self._buffer) and self._n_bytes > self._max_bytes
            if self._is_full:
                self._buffer.clear()
            else:
                self._buffer.append((left.packed(), right.packed()))
            yield left, right

    def __iter__(self) -> Generator[Pair, None, None]:
        unread, self._unread = self._unread, None
        if unread is not None and self._is_full:
            unread.close()
            unread = None
        with closing(unread or iter(self.pairs)) as unread:
            while self._buffer:
                left, right = self._buffer.popleft()
                yield left(), right()
            yield from unread

    def close(self) -> None:
        """Stop reading and free the buffer."""
        self._buffer.clear()
        if self._unread is not None:
            self._unread.close()
        self.pairs.close()
