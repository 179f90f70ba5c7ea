"""PackedPair: the pairs of a video whose images contain two cameras; the images of a pair are
simultaneous.
"""

from __future__ import annotations

from collections.abc import Callable, Generator
from contextlib import closing

from track_range.recording.pairs.recorded_pair import RecordedPair
from track_range.recording.pairs.stereo_layout import stereo_tracks
from track_range.recording.pairs.video_pair import Pair, VideoPair
from track_range.recording.sources.names import Half, VideoTrack, recorded
from track_range.recording.sources.video_half import VideoHalf
from track_range.recording.video.frame import VideoFrame
from track_range.recording.video.layouts import PackedLayout, StereoLayout
from track_range.recording.video.options import DEFAULTS, RecordingOptions
from track_range.recording.video.source_name import SourceName
from track_range.recording.video.threads import MAX_LOOK_AHEAD_BYTES
from track_range.recording.video.video import Video


def pair_in(
    whole: Video, name: SourceName, layout: StereoLayout, options: RecordingOptions = DEFAULTS
) -> PackedPair | RecordedPair:
    """The pair in the images of a recording, or in two video tracks, which are opened with the
    options.
    """
    if layout != "tracks":
        return PackedPair(whole, name, layout)
    whole.close()
    source = recorded(name)
    left_name, right_name = (VideoTrack(source, number) for number in stereo_tracks(whole)[:2])
    left = left_name.open(options)
    return RecordedPair(left, right_name.open(options, left))


class PackedPair(VideoPair[VideoHalf]):
    """The pairs of `whole`; the images of a pair are parts of one image, and share its memory."""

    _newest: VideoFrame  # that of the last pair

    def __init__(self, whole: Video, name: SourceName, layout: PackedLayout) -> None:
        self.whole, self.is_live = whole, whole.is_live
        left, right = (VideoHalf(whole, Half(name, layout, is_right)) for is_right in (False, True))
        super().__init__(
            left,
            right,
            tolerance_s=0.0,
            max_ahead_bytes=0 if self.is_live else MAX_LOOK_AHEAD_BYTES,
        )

    @property
    def notes(self) -> tuple[str, ...]:
        """See `VideoPair`; all frames have their partners."""
        return ()

    def pairs(self) -> Generator[Pair, None, None]:
        """See `VideoPair`."""
        with closing(self.whole.ahead("read pair")) as frames:
            for frame in frames:
                self.left.first_time_s, self.left.busy_s = (
                    self.whole.first_time_s,
                    self.whole.busy_s,
                )
                self._newest = frame
                yield self._halves(frame)

    def _packed(self, pair: Pair) -> tuple[int, Callable[[], Pair]]:
        whole = self._newest.packed()  # converted once for both
        return self._newest.n_packed_bytes, lambda: self._halves(whole())

    def _halves(self, frame: VideoFrame) -> Pair:
        return self.left.half(frame), self.right.half(frame)
