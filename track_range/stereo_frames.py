"""StereoFrames: two videos -> rectified frames of one instant each."""

from __future__ import annotations

from collections.abc import Generator
from contextlib import closing
from dataclasses import dataclass
from pathlib import Path

from stereo.frames import Frame
from stereo.rectification import Rectifier
from track_range.config import RunSettings
from track_range.pairing import StereoVideo
from track_range.video import VideoError, VideoReader

_CODEC_CROP_PX = 2  # video codecs want even sizes, so one eye may have lost a row or a column


@dataclass(frozen=True, slots=True)
class StereoFrames:
    """An opened pair of videos; may be run through several times.

    Attributes:
        video: both, in step.
        size_px: width and height that both have.
    """

    video: StereoVideo
    size_px: tuple[int, int]

    @classmethod
    def open(cls, settings: RunSettings, stereo: tuple[Path, Path]) -> StereoFrames:
        """Open left and right, the part that the settings want.

        Raises:
            VideoError: one cannot be used, or their sizes differ.
        """
        left = eye_reader(settings, stereo[0])
        right = eye_reader(settings, stereo[1], origin_s=left.first_time_s)
        return cls(StereoVideo(left, right), _shared_size_px(left, right))

    @property
    def left(self) -> VideoReader:
        """The left video."""
        return self.video.left

    def rectified(self, rectifier: Rectifier) -> Generator[Frame, None, None]:
        """All pairs; closing it closes the videos."""
        width_px, height_px = self.size_px
        with closing(iter(self.video)) as pairs:
            for left, right in pairs:
                images = (eye.image[:height_px, :width_px] for eye in (left, right))
                left_image, right_image = rectifier.rectify(*images)
                yield Frame(left.index, left.time_s - self.left.first_time_s, left_image, right_image)


def eye_reader(settings: RunSettings, path: Path, *, origin_s: float | None = None) -> VideoReader:
    """The part of a video that the settings want; `origin_s`: when the left one begins.

    Raises:
        VideoError: it cannot be used.
    """
    return VideoReader(
        path,
        folder_fps=settings.folder_fps,
        start_s=settings.start_s,
        duration_s=settings.duration_s,
        origin_s=origin_s,
    )


def _shared_size_px(left: VideoReader, right: VideoReader) -> tuple[int, int]:
    sizes = [(reader.width_px, reader.height_px) for reader in (left, right)]
    if any(abs(a - b) > _CODEC_CROP_PX for a, b in zip(*sizes, strict=True)):
        (lw, lh), (rw, rh) = sizes
        raise VideoError(f"{left.path} is {lw}x{lh} but {right.path} {rw}x{rh}: left and right must have one size.")
    return min(w for w, _ in sizes), min(h for _, h in sizes)
