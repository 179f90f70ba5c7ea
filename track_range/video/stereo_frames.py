"""StereoFrames: two videos, or two cameras -> rectified frames of one instant each."""

from __future__ import annotations

from collections.abc import Generator
from contextlib import ExitStack, closing
from dataclasses import dataclass, replace

from track_range.run.settings import RunSettings, VideoName
from track_range.stereo.geometry.frames import Frame
from track_range.stereo.geometry.rectification import Rectifier
from track_range.video.live.address import LiveAddress
from track_range.video.live.pair import LivePair
from track_range.video.live.reader import LiveReader
from track_range.video.pairing import StereoVideo
from track_range.video.reader import VideoError, VideoReader

Reader = VideoReader | LiveReader

_CODEC_CROP_PX = 2  # video codecs want even sizes, so one eye may have lost a row or a column


@dataclass(frozen=True, slots=True)
class StereoFrames:
    """An opened pair of videos; may be run through several times.

    Attributes:
        video: both, in step.
        size_px: width and height that both have.
        settings, stereo: what was opened.
        stays_open: whether live streams outlive a reading.
    """

    video: StereoVideo | LivePair
    size_px: tuple[int, int]
    settings: RunSettings
    stereo: tuple[VideoName, VideoName]
    stays_open: bool = False

    @classmethod
    def open(cls, settings: RunSettings, stereo: tuple[VideoName, VideoName]) -> StereoFrames:
        """Open left and right, the part that the settings want.

        Raises:
            VideoError: one cannot be used, or their sizes differ.
        """
        left = eye_reader(settings, stereo[0])
        right = eye_reader(settings, stereo[1], origin_s=left.first_time_s)
        return cls(_in_step(left, right), _shared_size_px(left, right), settings, stereo)

    def to_look_at(self) -> StereoFrames:
        """The same for another reading, before this one: files are opened anew, live streams are read on."""
        if isinstance(self.video, LivePair):
            return replace(self, stays_open=True)
        return StereoFrames.open(self.settings, self.stereo)

    @property
    def left(self) -> Reader:
        """The left video."""
        return self.video.left

    def rectified(self, rectifier: Rectifier) -> Generator[Frame, None, None]:
        """All pairs; closing it closes the videos."""
        width_px, height_px = self.size_px
        with ExitStack() as stack:
            if isinstance(self.video, LivePair) and not self.stays_open:
                stack.callback(self.video.close)
            for left, right in stack.enter_context(closing(iter(self.video))):
                images = (eye.image[:height_px, :width_px] for eye in (left, right))
                left_image, right_image = rectifier.rectify(*images)
                yield Frame(left.index, left.time_s - self.left.first_time_s, left_image, right_image)


def _in_step(left: Reader, right: Reader) -> StereoVideo | LivePair:
    if isinstance(left, LiveReader) and isinstance(right, LiveReader):
        return LivePair(left, right)
    if isinstance(left, VideoReader) and isinstance(right, VideoReader):
        return StereoVideo(left, right)
    raise VideoError(f"{left.path} and {right.path}: one is live and the other a file; give two of a kind.")


def eye_reader(settings: RunSettings, path: VideoName, *, origin_s: float | None = None) -> Reader:
    """The part of a video that the settings want; `origin_s`: when the left one begins.

    Raises:
        VideoError: it cannot be used.
    """
    if isinstance(path, LiveAddress):
        return LiveReader(path, start_s=settings.start_s, duration_s=settings.duration_s)
    return VideoReader(
        path,
        folder_fps=settings.folder_fps,
        start_s=settings.start_s,
        duration_s=settings.duration_s,
        origin_s=origin_s,
    )


def _shared_size_px(left: Reader, right: Reader) -> tuple[int, int]:
    sizes = [(reader.width_px, reader.height_px) for reader in (left, right)]
    if any(abs(a - b) > _CODEC_CROP_PX for a, b in zip(*sizes, strict=True)):
        (lw, lh), (rw, rh) = sizes
        raise VideoError(f"{left.path} is {lw}x{lh} but {right.path} {rw}x{rh}: left and right must have one size.")
    return min(w for w, _ in sizes), min(h for _, h in sizes)
