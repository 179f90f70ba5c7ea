"""Inputs: one or two opened videos (files, folders, cameras, streams); two are paired by time."""

from __future__ import annotations

import itertools
from collections.abc import Generator
from contextlib import ExitStack, closing
from dataclasses import dataclass

from track_range.foundation.arrays import Image
from track_range.recording.frame import VideoError, VideoFrame
from track_range.recording.live.address import LiveAddress
from track_range.recording.live.pair import LivePair
from track_range.recording.live.reader import LiveReader
from track_range.recording.names import VideoName
from track_range.recording.pairs.look_ahead import LookAhead
from track_range.recording.pairs.pairing import StereoVideo
from track_range.recording.reader import VideoReader
from track_range.recording.threads import MAX_LOOK_AHEAD_BYTES
from track_range.recording.utc import UtcStart

Reader = VideoReader | LiveReader

Images = tuple[VideoFrame, VideoFrame | None]
"""Left and right frames captured at the same time; the right one is None if there is one video."""

_CODEC_CROP_PX = 2
"""Tolerated difference in size between left and right, px: codecs need even sizes, so one may lack a row or column."""


@dataclass(frozen=True, slots=True)
class Inputs:
    """The opened videos of a recording.

    Attributes:
        left: the left or only video.
        pairs: left and right, paired by time; None = one video.
        size_px: width and height of the images, common to left and right unless they are of unequal cameras.
        right_size_px: width and height of the right images.
    """

    left: Reader
    pairs: LookAhead | None
    size_px: tuple[int, int]
    right_size_px: tuple[int, int]

    @classmethod
    def open(
        cls,
        left: VideoName,
        right: VideoName | None,
        *,
        start_s: float = 0.0,
        duration_s: float | None = None,
        folder_fps: float = 10.0,
    ) -> Inputs:
        """Open one or two videos.

        Args:
            left: a recording, a camera or a stream.
            right: the same; None = one video.
            start_s: start of the part to read, in seconds after the left video's first frame.
            duration_s: length of the part to read; None = to the end.
            folder_fps: frame rate of folders without timestamps.txt.

        Raises:
            VideoError: a video cannot be used, or one is live and the other recorded.
        """

        def reader(name: VideoName, beside: Reader | None = None) -> Reader:
            if isinstance(name, LiveAddress):
                return LiveReader(name, start_s=start_s, duration_s=duration_s)
            return VideoReader(
                name,
                folder_fps=folder_fps,
                start_s=start_s,
                duration_s=duration_s,
                origin_s=None if beside is None else beside.first_time_s,
                left=beside if isinstance(beside, VideoReader) else None,
            )

        first = reader(left)
        if right is None:
            size_px = first.width_px, first.height_px
            return cls(first, None, size_px, size_px)
        with ExitStack() as on_error:
            on_error.callback(first.close)
            second = reader(right, beside=first)
            on_error.callback(second.close)
            pairs = _paired(first, second)
            size_px, right_size_px = _cropped_sizes_px(first, second)
            on_error.pop_all()
        is_live = isinstance(pairs, LivePair)
        return cls(first, LookAhead(pairs, max_bytes=0 if is_live else MAX_LOOK_AHEAD_BYTES), size_px, right_size_px)

    def read_ahead(self) -> Generator[tuple[VideoFrame, VideoFrame], None, None]:
        """The first pairs, before the iteration; see `LookAhead.read_ahead`. Empty for one video."""
        if self.pairs is not None:
            yield from self.pairs.read_ahead()

    def __iter__(self) -> Generator[Images, None, None]:
        if self.pairs is not None:
            yield from self.pairs
            return
        with closing(iter(self.left)) as images:
            for image in images:
                yield image, None

    def cut(self, images: Images) -> tuple[Image, Image | None]:
        """The images of one time, cropped to the common size of equal cameras."""
        left, right = images
        (width_px, height_px), (right_width_px, right_height_px) = self.size_px, self.right_size_px
        return (
            left.image[:height_px, :width_px],
            None if right is None else right.image[:right_height_px, :right_width_px],
        )

    def check_equal_sizes(self) -> None:
        """Check that left and right have the same size, which a pair without a rig must have.

        Raises:
            VideoError: they differ.
        """
        if self.size_px != self.right_size_px:
            (lw, lh), (rw, rh) = self.size_px, self.right_size_px
            raise VideoError(
                f"{self.readers[-1].path}: expected {lw}x{lh} px like {self.left.path}, got {rw}x{rh}; unequal cameras "
                "need a --rig with both of them."
            )

    @property
    def readers(self) -> tuple[Reader, ...]:
        """The readers of the one or two videos, left first."""
        return (self.left,) if self.pairs is None else (self.left, self.pairs.pairs.right)

    @property
    def fps(self) -> float:
        """Nominal frame rate."""
        return self.left.fps

    @property
    def n_frames(self) -> int | None:
        """Estimated number of frames; None = unknown."""
        return self.left.n_frames

    @property
    def utc(self) -> UtcStart | None:
        """UTC of the left video's first frame; None = unknown."""
        return self.left.utc

    @property
    def live(self) -> LiveReader | None:
        """The left video if it is a camera or a stream, else None."""
        return self.left if isinstance(self.left, LiveReader) else None

    @property
    def busy_s(self) -> float:
        """Time spent reading and decoding so far, s, summed over both videos."""
        return sum(reader.busy_s for reader in self.readers)

    @property
    def notes(self) -> tuple[str, ...]:
        """Messages for the user; complete only after the last frame."""
        paired = () if self.pairs is None else self.pairs.pairs.notes
        return (*itertools.chain.from_iterable(reader.notes for reader in self.readers), *paired)

    def close(self) -> None:
        """Close the files and the connections of live streams."""
        if self.pairs is not None:
            self.pairs.close()
        self.left.close()


def _paired(left: Reader, right: Reader) -> StereoVideo | LivePair:
    if isinstance(left, LiveReader) and isinstance(right, LiveReader):
        return LivePair(left, right)
    if isinstance(left, VideoReader) and isinstance(right, VideoReader):
        return StereoVideo(left, right)
    raise VideoError(
        f"{left.path} and {right.path}: expected two recorded videos or two live streams, got one of each; "
        "both must be of the same kind."
    )


def _cropped_sizes_px(left: Reader, right: Reader) -> tuple[tuple[int, int], tuple[int, int]]:
    """Sizes to which the images are cropped: a common one if only rows or columns of a codec differ."""
    sizes = [(reader.width_px, reader.height_px) for reader in (left, right)]
    if any(abs(a - b) > _CODEC_CROP_PX for a, b in zip(*sizes, strict=True)):
        return sizes[0], sizes[1]
    common = min(w for w, _ in sizes), min(h for _, h in sizes)
    return common, common
