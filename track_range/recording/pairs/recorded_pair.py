"""RecordedPair: the frames of two recorded videos, paired by time.

Each frame is paired with the frame of the other video that is nearest in time, not by its number:
cameras drop frames, start at different times and run at different rates.

    left   |  a     b     c     d                pairs: (b, B) (d, D)
    right           B           D     E          a, c and E are unpaired

The clocks of the two videos may have different origins:

    both have an origin (MP4, folders, bags)    ->  times of the files
    one is a transport or program stream        ->  both start together
    both are, and their times overlap           ->  times of the files, else both start together
    the images contradict (`clock_offset`)      ->  the offset that the images show
"""

import math
from collections.abc import Generator
from contextlib import closing
from dataclasses import dataclass

from track_range.foundation.files.input_files import counted
from track_range.recording.pairs.video_pair import Pair, VideoPair
from track_range.recording.video.frame import TIME_EPSILON_S, VideoError, VideoFrame
from track_range.recording.video.recorded_video import RecordedVideo
from track_range.recording.video.threads import MAX_LOOK_AHEAD_BYTES
from track_range.stereo.alignment.common_moment import ClockOffset

_TOLERANCE_INTERVALS = 0.25
"""Largest time difference within a pair, in intervals of the faster video.

At 30 Hz this is 8 ms; a car closing at 30 m/s then moves 0.25 m, 1 % of 25 m. With half an interval
every frame would find a partner.
"""

# latest start of one of two streams that have one clock, as a fraction of the shorter one
_MAX_LATER = 0.5
# smallest offset from images that is used: smaller ones are a matter of `SyncMonitor`, which
# measures them also between frames
_MIN_OFFSET_INTERVALS = 1.5
# relative difference up to which nominal rates count as equal, such as 29.97 and 30
_RATE_DIFFERENCE = 0.01


@dataclass(slots=True)
class _Side:
    """One of the two videos while they are read."""

    name: str
    video: RecordedVideo
    frames: Generator[VideoFrame, None, None]
    current: VideoFrame | None = None  # the frame to be paired next; None = not started, or ended
    n_read: int = 0
    n_before: int = 0  # unpaired frames before the first pair
    n_between: int = 0  # the same between pairs
    n_after: int = 0  # the same after the last pair
    first_s: float = 0.0  # time of the first frame read
    last_s: float = 0.0  # time of the last frame read
    error: VideoError | None = None

    @property
    def n_unread(self) -> int:
        """Estimated number of frames not yet read; too large for a damaged file."""
        return 0 if self.current is None else max(0, (self.video.n_frames or 0) - self.n_read)

    @property
    def end_s(self) -> float:
        """Estimated end of the part to read, s."""
        return self.last_s + self.n_unread / self.video.fps

    def advance(self) -> None:
        """Read the next frame; an error is stored, so that the frames before it can be paired."""
        try:
            self.current = next(self.frames, None)
        except VideoError as error:
            self.current, self.error = None, error
        if self.current is not None:
            self.first_s = self.first_s if self.n_read else self.current.time_s
            self.last_s = self.current.time_s
            self.n_read += 1

    def is_nearer_to(self, time_s: float, gap_s: float) -> bool:
        """Whether the time of the next frame differs from a time by less than `gap_s`."""
        return self.current is not None and abs(self.current.time_s - time_s) < gap_s

    def count_unpaired(self, *, is_first_pair: bool) -> None:
        """Count the frames since the last pair as unpaired, before a pair."""
        if is_first_pair:
            self.n_before = self.n_after
        else:
            self.n_between += self.n_after
        self.n_after = 0


def _suggested_offset_s(left: RecordedVideo, right: RecordedVideo) -> float:
    """What is added to the times of the right video, by the files alone, s."""
    later_s = left.first_time_s - right.first_time_s
    shorter_s = min((video.n_total or 0) / video.fps for video in (left, right))
    has_one_clock = left.has_origin or abs(later_s) <= _MAX_LATER * shorter_s
    return 0.0 if left.has_origin == right.has_origin and has_one_clock else later_s


class RecordedPair(VideoPair[RecordedVideo]):
    """Pairs of frames of two videos with times that differ by at most a quarter of the shorter
    nominal frame interval.

    Each video is decoded ahead in a thread. Each iteration starts from the beginning. Iterating
    raises VideoError if there is no pair at all, and the errors of the videos.
    """

    def __init__(self, left: RecordedVideo, right: RecordedVideo) -> None:
        tolerance_s = _TOLERANCE_INTERVALS / max(left.fps, right.fps)
        super().__init__(left, right, tolerance_s=tolerance_s, max_ahead_bytes=MAX_LOOK_AHEAD_BYTES)
        self._n_pairs, self._nearest_s = 0, math.inf
        self._clock_notes: list[str] = []
        right.offset_s = _suggested_offset_s(left, right)
        if right.offset_s:
            self._clock_notes.append(
                f"{left.path} starts at {left.first_time_s:.2f} s and {right.path} at "
                f"{right.first_time_s:.2f} s of clocks without a common origin: both are taken to "
                "start together."
            )
        self._sides = self._new_sides()

    def use_offset(self, offset: ClockOffset) -> bool:
        """Pair by what images show of the clocks, in addition to the present offset; returns
        whether that changes the pairs.
        """
        if offset.kind == "unknown":
            self._clock_notes.append(
                "The images of the first seconds do not show which moments of the two videos "
                "belong together: the pairs follow from the times of the files, and stereo is "
                "wrong if these are."
            )
        smallest_s = _MIN_OFFSET_INTERVALS / min(self.left.fps, self.right.fps)
        if offset.kind != "found" or abs(offset.value_s) < smallest_s:
            return False
        self.right.offset_s += offset.value_s
        self._clock_notes = [
            f"{self.right.path}: {self.right.offset_s:+.2f} s are added to its times, since its "
            f"images then show the moments of {self.left.path} ({offset.points:.0f} points in "
            f"equal rows, {offset.other_points:.0f} at other moments)."
        ]
        return True

    def _new_sides(self) -> tuple[_Side, _Side]:
        left, right = (
            _Side(
                name,
                video,
                video.ahead(f"read {name}"),
            )
            for name, video in (("left", self.left), ("right", self.right))
        )
        return left, right

    @property
    def notes(self) -> tuple[str, ...]:
        """Messages for the user about unpaired frames; complete only after the last pair."""
        (left, right), left_hz, right_hz = self._sides, self.left.fps, self.right.fps
        rates = (
            f"The left video has {left_hz:.2f} and the right one {right_hz:.2f} frames per second: "
            f"only frames within {1000 * self.tolerance_s:.1f} ms of each other are paired.",
        )
        has_equal_rates = abs(left_hz - right_hz) <= _RATE_DIFFERENCE * max(left_hz, right_hz)
        unpaired = *self._unpaired_notes(left, right), *self._unpaired_notes(right, left)
        notes = *self._clock_notes, *unpaired
        return notes if has_equal_rates else rates + notes

    def pairs(self) -> Generator[Pair, None, None]:
        """Pair the earlier of two frames with the later frame, unless the successor of the earlier
        frame is nearer.
        """
        self._n_pairs, self._nearest_s = 0, math.inf
        self._sides = left, right = self._new_sides()
        with closing(left.frames), closing(right.frames):
            left.advance()
            right.advance()
            while left.current is not None and right.current is not None:
                pair = left.current, right.current
                is_right_earlier = pair[1].time_s < pair[0].time_s
                earlier, later = (right, left) if is_right_earlier else (left, right)
                gap_s = abs(pair[1].time_s - pair[0].time_s)
                earlier.advance()
                if earlier.is_nearer_to(later.last_s, gap_s) or not self._is_close(gap_s):
                    self._nearest_s = min(self._nearest_s, gap_s)
                    earlier.n_after += 1
                    continue
                for side in self._sides:
                    side.count_unpaired(is_first_pair=self._n_pairs == 0)
                self._n_pairs += 1
                yield pair
                later.advance()
            for side in self._sides:
                side.n_after += 0 if side.current is None else 1 + side.n_unread
        self._check_end()

    def _is_close(self, gap_s: float) -> bool:
        """Whether times with this difference are those of a pair."""
        return gap_s <= self.tolerance_s + TIME_EPSILON_S

    def _check_end(self) -> None:
        """Raises VideoError for the error of a video, or if there was no pair."""
        for side in self._sides:
            if side.error is not None:
                raise side.error
            side.video.check_unchanged()
        if not self._n_pairs:
            spans = [
                f"{side.video.path} ({side.first_s:.2f} s to {side.end_s:.2f} s)"
                for side in self._sides
            ]
            raise VideoError(
                f"{spans[0]} and {spans[1]}: expected frames at most {self.tolerance_s:.3f} s "
                f"apart, found none nearer than {self._nearest_s:.3f} s; use two videos of one "
                "recording, from cameras with synchronised clocks."
            )

    def _unpaired_notes(self, side: _Side, other: _Side) -> list[str]:
        """Messages about the unpaired frames of one side before, after and between the pairs."""
        n_between, notes, noun = side.n_between, [], f"{side.name} frame"
        ends = (
            ("starts", "later", "earlier", side.n_before, other.first_s - side.first_s),
            ("ends", "earlier", "later", side.n_after, side.end_s - other.end_s),
        )
        for verb, adverb, opposite, n_skipped, by_s in ends:
            if n_skipped and by_s > self.tolerance_s:
                notes.append(
                    f"The {other.name} video {verb} {by_s:.2f} s {adverb} than the {side.name} "
                    f"one: skipped {counted(n_skipped, f'{opposite} {noun}')}."
                )
            else:
                n_between += n_skipped
        if n_between:
            notes.append(
                f"Skipped {counted(n_between, noun)} without a {other.name} frame within "
                f"{1000 * self.tolerance_s:.1f} ms."
            )
        return notes
