"""StereoVideo: left and right frames of two videos, paired by time.

Each frame is paired with the nearest of the other video, never by its number: cameras drop frames, start apart and run
at different rates.

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


@dataclass(slots=True)
class _Side:
    """One of the two videos while they are read.

    Attributes:
        name: "left" or "right".
        reader: the video.
        frames: its frames, decoded ahead in a thread.
        current: the frame that has no partner yet; None = not begun, or over.
        n_before, n_between, n_after: frames without partner before the first pair, between pairs, since the last pair.
    """

    name: str
    reader: VideoReader
    frames: Generator[VideoFrame, None, None]
    current: VideoFrame | None = None
    n_read: int = 0
    n_before: int = 0
    n_between: int = 0
    n_after: int = 0
    first_s: float | None = None
    last_s: float = 0.0
    is_over: bool = False

    @property
    def n_unread(self) -> int:
        """Frames still to come; a damaged file announces more than it has."""
        return 0 if self.is_over else max(0, (self.reader.n_frames or 0) - self.n_read)

    @property
    def end_s(self) -> float:
        """Where the part asked for ends, as far as known."""
        return self.last_s + self.n_unread / self.reader.fps

    def advance(self) -> None:
        """Read the next frame."""
        self.current = next(self.frames, None)
        if self.current is None:
            self.is_over = True
            return
        self.n_read += 1
        self.first_s = self.current.time_s if self.first_s is None else self.first_s
        self.last_s = self.current.time_s

    def count_pair(self, *, is_first: bool) -> None:
        """The frames since the last pair have no partner."""
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
        self._n_pairs, self._nearest_s = 0, math.inf
        self._sides = self._new_sides()

    def _new_sides(self) -> tuple[_Side, _Side]:
        left, right = (prefetch(reader, depth=FRAMES_AHEAD, low_priority=True) for reader in (self.left, self.right))
        return _Side("left", self.left, left), _Side("right", self.right, right)

    @property
    def notes(self) -> tuple[str, ...]:
        """Sentences for the user on frames that were not used; complete only after the last pair."""
        left, right = self._sides
        return (*self._rate_notes(), *self._unpaired_notes(left, right), *self._unpaired_notes(right, left))

    def close(self) -> None:
        """Close both files, if they have not been read."""
        self.left.close()
        self.right.close()

    def __iter__(self) -> Generator[tuple[VideoFrame, VideoFrame], None, None]:
        """The earlier of two frames is paired with the other, unless its successor is nearer to that one."""
        self._n_pairs, self._nearest_s = 0, math.inf
        self._sides = left, right = self._new_sides()
        with closing(left.frames), closing(right.frames):
            left.advance()
            right.advance()
            while left.current is not None and right.current is not None:
                pair = left.current, right.current
                is_right_earlier = pair[1].time_s < pair[0].time_s
                earlier, later = (right, left) if is_right_earlier else (left, right)
                later_s, gap_s = later.last_s, abs(pair[1].time_s - pair[0].time_s)
                earlier.advance()
                is_successor_nearer = earlier.current is not None and abs(earlier.current.time_s - later_s) < gap_s
                if is_successor_nearer or gap_s > self.tolerance_s + TIME_EPSILON_S:
                    self._nearest_s = min(self._nearest_s, gap_s)
                    earlier.n_after += 1
                    continue
                for side in self._sides:
                    side.count_pair(is_first=self._n_pairs == 0)
                self._n_pairs += 1
                yield pair
                later.advance()
            for side in self._sides:
                side.n_after += 0 if side.current is None else 1 + side.n_unread
        if not self._n_pairs:
            raise VideoError(self._why_nothing_pairs())

    def _rate_notes(self) -> list[str]:
        left_hz, right_hz = self.left.fps, self.right.fps
        if abs(left_hz - right_hz) <= _RATE_DIFFERENCE * max(left_hz, right_hz):
            return []
        return [
            f"The left video runs at {left_hz:.2f} and the right one at {right_hz:.2f} frames per second: only frames "
            f"within {1000 * self.tolerance_s:.1f} ms of each other are paired."
        ]

    def _unpaired_notes(self, side: _Side, other: _Side) -> list[str]:
        """Frames of one side that were not used, before, after and between the pairs."""
        later_s = (other.first_s or 0.0) - (side.first_s or 0.0)
        earlier_s = side.end_s - other.end_s
        n_between, notes = side.n_between, []
        if side.n_before and later_s > self.tolerance_s:
            notes.append(
                f"The {other.name} video starts {later_s:.2f} s later than the {side.name} one: "
                f"{counted(side.n_before, 'frame')} of the {side.name} one before that not used."
            )
        else:
            n_between += side.n_before
        if side.n_after and earlier_s > self.tolerance_s:
            notes.append(
                f"The {other.name} video ends {earlier_s:.2f} s earlier than the {side.name} one: "
                f"{counted(side.n_after, 'frame')} of the {side.name} one after that not used."
            )
        else:
            n_between += side.n_after
        if n_between:
            notes.append(
                f"{counted(n_between, 'frame')} of the {side.name} video without a {other.name} one within "
                f"{1000 * self.tolerance_s:.1f} ms not used."
            )
        return notes

    def _why_nothing_pairs(self) -> str:
        spans = [f"{side.reader.path} ({side.first_s or 0.0:.2f} s to {side.end_s:.2f} s)" for side in self._sides]
        apart = f"their nearest frames are {self._nearest_s:.3f} s apart, and {self.tolerance_s:.3f} s is the most"
        return (
            f"{spans[0]} and {spans[1]} have no frames of one instant: {apart}; give two videos of one recording whose "
            "clocks agree."
        )
