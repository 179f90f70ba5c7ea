"""Overlap of two consecutive files of a recording, from compressed frames that both contain.

Dashcams with an overlap write the last second of a file also to the beginning of the next one, without encoding it
again.
"""

from __future__ import annotations

from contextlib import closing

from track_range.recording.files.video_file import compressed_frames
from track_range.recording.frame import VideoError
from track_range.recording.segments.segment_times import SegmentFacts

MAX_OVERLAP_S = 5.0
"""Longest overlap, s, that is searched; dashcams repeat 1 to 3 s."""

_MIN_BYTES = 2000
"""Smallest number of bytes of repeated frames; fewer are those of an empty picture, which may be equal by chance."""


def repeated_s(before: SegmentFacts, after: SegmentFacts) -> float:
    """Time, s, from the start of `after` to the end of `before`, if its first frames are the last ones of `before`.

    0 = they are not, or a file cannot be read.
    """
    try:
        with closing(compressed_frames(after.path)) as beginning:
            _, first = next(beginning, (0.0, b""))
            end = list(compressed_frames(before.path, last_s=MAX_OVERLAP_S))
            matches = [number for number, (_, content) in enumerate(end) if content == first]
            if not first or len(matches) != 1:
                return 0.0
            repeated = end[matches[0] :]
            is_equal = all(content == next(beginning, (0.0, b""))[1] for _, content in repeated[1:])
    except VideoError:
        return 0.0
    if not is_equal or sum(len(content) for _, content in repeated) < _MIN_BYTES:
        return 0.0
    return before.first_s + before.duration_s - repeated[0][0]
