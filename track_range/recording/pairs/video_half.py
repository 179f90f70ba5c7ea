"""VideoHalf: the images of one camera in a video whose images show those of two, beside or below each other."""

from __future__ import annotations

import math
from collections.abc import Generator

from track_range.recording.frame import ImagePart, VideoFrame
from track_range.recording.live.live_video import LiveVideo
from track_range.recording.names import Half, StereoLayout
from track_range.recording.recorded_video import RecordedVideo, VideoPart
from track_range.recording.utc import UtcStart


def image_half(layout: StereoLayout, size_px: tuple[int, int], *, is_right: bool) -> ImagePart:
    """Rows and columns of the images of one camera in images of (width, height); an odd row or column is left out."""
    is_second = is_right != (layout in ("right-left", "bottom-top"))
    is_stacked = layout in ("top-bottom", "bottom-top")
    length_px = size_px[1] if is_stacked else size_px[0]
    half = slice(length_px - length_px // 2, None) if is_second else slice(length_px // 2)
    return (half, slice(None)) if is_stacked else (slice(None), half)


class VideoHalf(RecordedVideo):
    """The images of one camera in `whole`; the left one reports for both, as they are read together."""

    path: Half

    def __init__(self, whole: RecordedVideo | LiveVideo, name: Half) -> None:
        self.whole, self.path = whole, name
        self.part = image_half(name.layout, (whole.width_px, whole.height_px), is_right=name.is_right)
        rows, columns = (
            range(*part.indices(length))
            for part, length in zip(self.part, (whole.height_px, whole.width_px), strict=True)
        )
        self.height_px, self.width_px = len(rows), len(columns)
        self.pixel_aspect, self.is_grey, self.fps = whole.pixel_aspect, whole.is_grey, whole.fps
        self.first_time_s, self.n_total = whole.first_time_s, whole.n_frames
        if isinstance(whole, RecordedVideo):
            self.n_total, self.metadata = whole.n_total, whole.metadata

    @property
    def n_frames(self) -> int | None:
        """See `RecordedVideo`."""
        return self.whole.n_frames

    @property
    def utc(self) -> UtcStart | None:
        """See `RecordedVideo`."""
        return self.whole.utc

    @property
    def notes(self) -> tuple[str, ...]:
        """See `RecordedVideo`."""
        return () if self.path.is_right else self.whole.notes

    @property
    def parts(self) -> tuple[VideoPart, ...]:
        """See `RecordedVideo`."""
        return self.whole.parts if isinstance(self.whole, RecordedVideo) else ()

    def frames(self, from_s: float, until_s: float) -> Generator[VideoFrame, None, None]:
        """See `RecordedVideo`."""
        if isinstance(self.whole, RecordedVideo):
            for frame in self.whole.frames(from_s, until_s):
                yield frame.part(self.part)

    def select(self, start_s: float, duration_s: float | None = None, *, origin_s: float | None = None) -> None:
        """See `RecordedVideo`; the part is that of both cameras."""
        super().select(start_s, duration_s, origin_s=origin_s)
        if isinstance(self.whole, RecordedVideo):
            self.whole.select(start_s, duration_s, origin_s=origin_s)

    def check_unchanged(self) -> None:
        """See `RecordedVideo`."""
        if isinstance(self.whole, RecordedVideo):
            self.whole.check_unchanged()

    def close(self) -> None:
        """See `RecordedVideo`."""
        self.whole.close()

    def with_packed_pixels(self, aspect: float) -> None:
        """Take the pixels as twice as wide, or half, where the images were squeezed to fit beside or below each other.

        `aspect` is the width / height of the images by a calibration.
        """
        own = self.width_px / self.height_px * (self.pixel_aspect or 1.0)
        squeeze = 0.5 if self.path.layout in ("top-bottom", "bottom-top") else 2.0
        if abs(math.log(aspect / own / squeeze)) < abs(math.log(aspect / own)):
            self.pixel_aspect = squeeze * (self.pixel_aspect or 1.0)
