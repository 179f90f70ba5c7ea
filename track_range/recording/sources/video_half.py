"""VideoHalf: the images of one camera in a video whose images contain two cameras beside or below
each other.
"""

import math
from collections.abc import Generator

from track_range.foundation.arrays import Image
from track_range.recording.sources.names import Half
from track_range.recording.video.frame import VideoFrame
from track_range.recording.video.layouts import REVERSED, STACKED, PackedLayout, StereoLayout
from track_range.recording.video.recorded_video import RecordedVideo
from track_range.recording.video.utc import UtcStart
from track_range.recording.video.video import Video, VideoPart


def image_half(layout: StereoLayout, image: Image, *, is_right: bool) -> Image:
    """The part of an image that belongs to one camera, without a copy; an odd row or column is left
    out.
    """
    length_px = image.shape[0 if layout in STACKED else 1] // 2
    half = slice(-length_px, None) if is_right != (layout in REVERSED) else slice(length_px)
    return image[half] if layout in STACKED else image[:, half]


def half_size_px(layout: PackedLayout, size_px: tuple[int, int]) -> tuple[int, int]:
    """(width, height) of the images of one camera in images of this size."""
    width_px, height_px = size_px
    return (width_px, height_px // 2) if layout in STACKED else (width_px // 2, height_px)


class VideoHalf(RecordedVideo):
    """The images of one camera in `whole`; the left camera's object reports for both, as they are
    read together.
    """

    path: Half

    def __init__(self, whole: Video, name: Half) -> None:
        self._whole, self.path = whole, name
        self._recorded = whole if isinstance(whole, RecordedVideo) else None  # None = live
        self.width_px, self.height_px = half_size_px(name.layout, (whole.width_px, whole.height_px))
        self.pixel_aspect, self.is_grey, self.fps = whole.pixel_aspect, whole.is_grey, whole.fps
        self.first_time_s, self.n_total = whole.first_time_s, whole.n_frames
        self.metadata = whole.metadata

    @property
    def whole(self) -> Video:
        """See `Video`."""
        return self._whole

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
        return self.whole.parts

    def frames(self, from_s: float, until_s: float) -> Generator[VideoFrame, None, None]:
        """See `RecordedVideo`."""
        if self._recorded is not None:
            for frame in self._recorded.frames(from_s, until_s):
                yield self.half(frame)

    def half(self, frame: VideoFrame) -> VideoFrame:
        """The part of a frame of both cameras that belongs to this camera; it shares the memory of
        the frame.
        """
        image = image_half(self.path.layout, frame.image, is_right=self.path.is_right)
        return VideoFrame(frame.index, frame.time_s, image)

    def check_unchanged(self) -> None:
        """See `RecordedVideo`."""
        if self._recorded is not None:
            self._recorded.check_unchanged()

    def close(self) -> None:
        """See `RecordedVideo`."""
        self.whole.close()

    def with_packed_pixels(self, aspect: float) -> None:
        """Take the pixels as twice as wide, or half, where the images were squeezed to fit beside
        or below each other.

        `aspect` is the width / height of the images by a calibration.
        """
        own = self.width_px / self.height_px * (self.pixel_aspect or 1.0)
        squeeze = 0.5 if self.path.layout in STACKED else 2.0
        if abs(math.log(aspect / own / squeeze)) < abs(math.log(aspect / own)):
            self.pixel_aspect = squeeze * (self.pixel_aspect or 1.0)
