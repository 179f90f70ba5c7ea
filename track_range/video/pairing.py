"""StereoVideo: two videos in step: which left and right frame belong to one instant.

Frames are paired by their times, each with the nearest of the other eye, never by their numbers: cameras drop frames,
start apart and run at rates of their own.

    left   |  a     b     c     d                pairs: (b, B) (d, D)
    right           B           D     E          a, c and E have no partner
"""

from __future__ import annotations

import math
from collections.abc import Generator
from contextlib import closing
from dataclasses import dataclass

from track_range.run.prefetch import prefetch
from track_range.video.frame import TIME_EPSILON_S, VideoError, VideoFrame, counted
from track_range.video.reader import VideoReader
from track_range.video.threads import FRAMES_AHEAD

# A quarter of the shorter frame interval: half would pair every frame with some other; at 30 Hz a quarter is 8 ms, in
# which a car that closes at 30 m/s comes 0.25 m nearer: 1 % at 25 m.
_TOLERANCE_INTERVALS = 0.25
_RATE_DIFFERENCE = 0.01  # nominal rates that differ by less are the same, say 29.97 and 30

_Ahead = tuple[Generator[VideoFrame, None, None], Generator[VideoFrame, None, None]]


@dataclass(frozen=True, slots=True)
class PairCounts:
    """Pairs made, and frames without a partner; those not even read count where the file tells their number."""

    n_pairs: int
    n_left_unpaired: int
    n_right_unpaired: int


@dataclass(slots=True)
class _Eye:
    """What one side has contributed."""

    name: str
    reader: VideoReader
    n_read: int = 0
    n_before: int = 0  # without partner before the first pair,
    n_between: int = 0  # between pairs,
    n_after: int = 0  # and since the last pair
    first_s: float | None = None
    last_s: float = 0.0
    is_over: bool = False

    @property
    def n_unpaired(self) -> int:
        return self.n_before + self.n_between + self.n_after

    @property
    def end_s(self) -> float:
        """Where the part asked for ends, as far as known."""
        return self.last_s + self.n_unread / self.reader.fps

    @property
    def n_unread(self) -> int:
        """Frames still to come; a damaged file announces more than it has."""
        return 0 if self.is_over else max(0, (self.reader.n_frames or 0) - self.n_read)

    def taken(self, frame: VideoFrame | None) -> VideoFrame | None:
        if frame is None:
            self.is_over = True
        else:
            self.n_read += 1
            self.first_s = frame.time_s if self.first_s is None else self.first_s
            self.last_s = frame.time_s
        return frame

    def paired(self, *, is_first: bool) -> None:
        if is_first:
            self.n_before = self.n_after
        else:
            self.n_between += self.n_after
        self.n_after = 0


class StereoVideo:
    """Pairs of frames of two videos whose times differ by at most a quarter of the shorter nominal frame interval.

    Both are decoded ahead, in a thread each. Iterating again starts anew.

    Attributes:
        left, right: the readers.
        tolerance_s: the largest difference of time within a pair.

    Raises:
        VideoError: while iterating: no pair at all, or whatever the readers raise.
    """

    def __init__(self, left: VideoReader, right: VideoReader) -> None:
        self.left, self.right = left, right
        self.tolerance_s = _TOLERANCE_INTERVALS / max(left.fps, right.fps)
        self._start()

    def _start(self) -> None:
        self._n_pairs, self._nearest_s = 0, math.inf
        self._eyes = (_Eye("left", self.left), _Eye("right", self.right))

    @property
    def counts(self) -> PairCounts:
        """Counts so far."""
        left, right = self._eyes
        return PairCounts(self._n_pairs, left.n_unpaired, right.n_unpaired)

    @property
    def notes(self) -> tuple[str, ...]:
        """What of the two was not used; complete only after the last pair."""
        notes = self._rate_notes()
        for eye, other in (self._eyes, self._eyes[::-1]):
            notes += self._part_notes(eye, other)
        return tuple(notes)

    def close(self) -> None:
        """Close both files, if they have not been read."""
        self.left.close()
        self.right.close()

    def __iter__(self) -> Generator[tuple[VideoFrame, VideoFrame], None, None]:
        self._start()
        ahead = (self._ahead(self.left), self._ahead(self.right))
        with closing(ahead[0]), closing(ahead[1]):
            yield from self._pairs(ahead)
        if not self._n_pairs:
            raise VideoError(self._why_nothing_pairs())

    @staticmethod
    def _ahead(reader: VideoReader) -> Generator[VideoFrame, None, None]:
        return prefetch(reader, depth=FRAMES_AHEAD, gives_way=True)

    def _pairs(self, ahead: _Ahead) -> Generator[tuple[VideoFrame, VideoFrame], None, None]:
        """The frame that is behind is paired with the other eye's, unless its successor is nearer to that."""
        held = [eye.taken(next(frames, None)) for eye, frames in zip(self._eyes, ahead, strict=True)]
        while (left := held[0]) is not None and (right := held[1]) is not None:
            behind = int(right.time_s < left.time_s)
            gap_s = abs(right.time_s - left.time_s)
            held[behind] = successor = self._eyes[behind].taken(next(ahead[behind], None))
            ahead_s = max(left.time_s, right.time_s)
            is_successor_nearer = successor is not None and abs(successor.time_s - ahead_s) < gap_s
            if is_successor_nearer or gap_s > self.tolerance_s + TIME_EPSILON_S:
                self._nearest_s = min(self._nearest_s, gap_s)
                self._eyes[behind].n_after += 1
                continue
            self._count_pair()
            yield left, right
            held[1 - behind] = self._eyes[1 - behind].taken(next(ahead[1 - behind], None))
        for eye, frame in zip(self._eyes, held, strict=True):
            eye.n_after += (frame is not None) and 1 + eye.n_unread

    def _count_pair(self) -> None:
        for eye in self._eyes:
            eye.paired(is_first=self._n_pairs == 0)
        self._n_pairs += 1

    def _rate_notes(self) -> list[str]:
        left_hz, right_hz = self.left.fps, self.right.fps
        if abs(left_hz - right_hz) <= _RATE_DIFFERENCE * max(left_hz, right_hz):
            return []
        return [
            f"The left video runs at {left_hz:.2f} and the right one at {right_hz:.2f} frames per second: only frames "
            f"within {1000 * self.tolerance_s:.1f} ms of each other are paired."
        ]

    def _part_notes(self, eye: _Eye, other: _Eye) -> list[str]:
        """What of one eye was not used, before, after and between."""
        later_s = (other.first_s or 0.0) - (eye.first_s or 0.0)
        earlier_s = eye.end_s - other.end_s
        n_between, notes = eye.n_between, []
        if eye.n_before and later_s > self.tolerance_s:
            notes.append(
                f"The {other.name} video starts {later_s:.2f} s later than the {eye.name} one: "
                f"{counted(eye.n_before, 'frame')} of the {eye.name} one before that not used."
            )
        else:
            n_between += eye.n_before
        if eye.n_after and earlier_s > self.tolerance_s:
            notes.append(
                f"The {other.name} video ends {earlier_s:.2f} s earlier than the {eye.name} one: "
                f"{counted(eye.n_after, 'frame')} of the {eye.name} one after that not used."
            )
        else:
            n_between += eye.n_after
        if n_between:
            notes.append(
                f"{counted(n_between, 'frame')} of the {eye.name} video without a {other.name} one within "
                f"{1000 * self.tolerance_s:.1f} ms not used."
            )
        return notes

    def _why_nothing_pairs(self) -> str:
        spans = [f"{eye.reader.path} ({eye.first_s or 0.0:.2f} s to {eye.end_s:.2f} s)" for eye in self._eyes]
        apart = f"their nearest frames are {self._nearest_s:.3f} s apart, and {self.tolerance_s:.3f} s is the most"
        return (
            f"{spans[0]} and {spans[1]} have no frames of one instant: {apart}; give two videos of one recording whose "
            "clocks agree."
        )
