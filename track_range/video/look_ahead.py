r"""LookAhead: the first pairs of two videos are seen before the pass that uses them, and decoded once.

pairs -> read_ahead() -> alignment, checks          live: nothing is kept, and the pass starts with the newest
               \-> kept, packed, at most `max_bytes` -> iteration: kept ones first (freed as they go), then the rest
"""

from __future__ import annotations

from collections import deque
from collections.abc import Callable, Generator
from contextlib import closing

from track_range.video.frame import VideoFrame
from track_range.video.live.pair import LivePair
from track_range.video.pairing import StereoVideo

Pair = tuple[VideoFrame, VideoFrame]


class LookAhead:
    """Pairs of two videos, of which the first may be read ahead once before they are iterated.

    Args:
        pairs: the two videos.
        max_bytes: memory for the pairs read ahead. If they are more than one and need more, none is kept, and the
            iteration starts anew: recorded videos from their start, live ones with what comes then.
    """

    def __init__(self, pairs: StereoVideo | LivePair, *, max_bytes: int) -> None:
        self.pairs = pairs
        self._max_bytes = max_bytes
        self._unread: Generator[Pair, None, None] | None = None
        self._kept: deque[tuple[Callable[[], VideoFrame], Callable[[], VideoFrame]]] = deque()
        self._n_bytes = 0
        self._is_full = False

    @property
    def n_kept(self) -> int:
        """Pairs that have been read ahead and wait for the iteration."""
        return len(self._kept)

    def read_ahead(self) -> Generator[Pair, None, None]:
        """The first pairs, as many as the caller takes; to be called at most once, before the iteration."""
        self._unread = iter(self.pairs)
        for left, right in self._unread:
            self._n_bytes += left.n_packed_bytes + right.n_packed_bytes
            self._is_full |= bool(self._kept) and self._n_bytes > self._max_bytes
            if self._is_full:
                self._kept.clear()
            else:
                self._kept.append((left.packed(), right.packed()))
            yield left, right

    def __iter__(self) -> Generator[Pair, None, None]:
        unread, self._unread = self._unread, None
        if unread is not None and self._is_full:
            unread.close()
            unread = None
        with closing(unread or iter(self.pairs)) as unread:
            while self._kept:
                left, right = self._kept.popleft()
                yield left(), right()
            yield from unread

    def close(self) -> None:
        """End the reading and free what is kept."""
        self._kept.clear()
        if self._unread is not None:
            self._unread.close()
        self.pairs.close()
