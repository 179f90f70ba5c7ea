"""PackedPair: the pairs of a video whose images show those of two cameras; each is of one moment."""

from __future__ import annotations

from collections.abc import Generator
from contextlib import closing

from track_range.foundation.prefetch import prefetch
from track_range.recording.live.live_video import LiveVideo
from track_range.recording.names import Half, StereoLayout, WholeName
from track_range.recording.pairs.video_half import VideoHalf
from track_range.recording.pairs.video_pair import Pair, VideoPair
from track_range.recording.recorded_video import RecordedVideo
from track_range.recording.threads import FRAMES_AHEAD, MAX_LOOK_AHEAD_BYTES


class PackedPair(VideoPair[RecordedVideo]):
    """The pairs of `whole`; the images of a pair are parts of one, and share its memory."""

    def __init__(self, whole: RecordedVideo | LiveVideo, name: WholeName, layout: StereoLayout) -> None:
        self.whole, self.is_live = whole, isinstance(whole, LiveVideo)
        left, right = (VideoHalf(whole, Half(name, layout, is_right)) for is_right in (False, True))
        self._parts = left.part, right.part
        super().__init__(left, right, tolerance_s=0.0, max_ahead_bytes=0 if self.is_live else MAX_LOOK_AHEAD_BYTES)

    @property
    def notes(self) -> tuple[str, ...]:
        """See `VideoPair`; all frames have their partners."""
        return ()

    def pairs(self) -> Generator[Pair, None, None]:
        """See `VideoPair`."""
        if isinstance(self.whole, LiveVideo):
            frames = self.whole.newest()
        else:
            frames = prefetch(self.whole, depth=FRAMES_AHEAD, low_priority=True, name="read pair")
        with closing(frames):
            for frame in frames:
                self.left.first_time_s, self.left.busy_s = self.whole.first_time_s, self.whole.busy_s
                yield frame.part(self._parts[0]), frame.part(self._parts[1])
