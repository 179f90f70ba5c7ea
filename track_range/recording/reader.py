"""VideoReader: iterates over the frames of a recorded video: one file, several, or a folder of numbered images."""

from __future__ import annotations

import math
import time
from collections.abc import Generator, Iterator, Mapping
from contextlib import closing
from pathlib import Path

from track_range.foundation.files.atomic_files import describe
from track_range.foundation.files.input_files import quoted
from track_range.recording.bags.bag import is_bag
from track_range.recording.bags.bag_video import BagVideo
from track_range.recording.files.image_folder import ImageFolder
from track_range.recording.files.video_file import VideoFile
from track_range.recording.files.video_part import VideoPart
from track_range.recording.frame import VideoError, VideoFrame
from track_range.recording.names import BagTopic, RecordedName, Segments
from track_range.recording.segments.segmented_video import SegmentedVideo, segment_files
from track_range.recording.threads import DECODER_THREADS
from track_range.recording.utc import UtcStart

_now_s = time.thread_time if DECODER_THREADS == 1 else time.perf_counter


_MIN_SIDE_PX = 8
"""Smallest width and height of a video; smaller ones show no road users, and their headers are usually damaged."""


Source = VideoFile | ImageFolder | SegmentedVideo | BagVideo
"""Frames of a recording with their properties; see `VideoReader`."""


class VideoReader:
    """The frames of a video file, of several files that are one recording, or of a folder of numbered images.

    The file is opened once for its properties and the first iteration, and again for each later iteration.

    Args:
        path: the file, the folder of images or videos, a pattern such as `DIR/*_F.mp4`, several files, or a
            topic of a bag.
        folder_fps: frame rate of a folder without timestamps.txt.
        start_s: start of the part to read, in seconds after `origin_s`; most frames before it are not decoded.
        duration_s: length of the part to read; None = to the end.
        origin_s: file time from which `start_s` counts; None = that of the first frame. For the right video of a pair:
            `first_time_s` of the left one.
        left: the left video of a pair, if this is the right one.

    Attributes:
        width_px, height_px: size of the upright images.
        is_grey: whether the first frame has no colour.
        fps: nominal frame rate.
        first_time_s: time of the file's first frame, independent of `start_s`.
        n_frames: estimated number of frames in the part to read; None = unknown.
        busy_s: time spent reading and decoding so far: CPU time of this thread, or wall time where FFmpeg decodes in
            several threads.

    Raises:
        VideoError: the path does not exist, is no video, nothing can be decoded, or the images are too small. While
            iterating: no frame in the part to read, an image of a folder cannot be decoded, an image has another size,
            or the file or folder was replaced, shortened or overwritten in the meantime.
    """

    def __init__(
        self,
        path: RecordedName,
        *,
        folder_fps: float = 10.0,
        start_s: float = 0.0,
        duration_s: float | None = None,
        origin_s: float | None = None,
        left: VideoReader | None = None,
    ) -> None:
        self.path = path
        self._source: Source = _source(path, folder_fps, None if left is None else left._source)
        self.width_px, self.height_px = self._source.width_px, self._source.height_px
        if min(self.width_px, self.height_px) < _MIN_SIDE_PX:
            self._source.close()
            raise VideoError(
                f"{path}: expected images of at least {_MIN_SIDE_PX}x{_MIN_SIDE_PX} px, found "
                f"{self.width_px}x{self.height_px} px; check the video."
            )
        self.is_grey, self.fps = self._source.is_grey, self._source.fps
        self.first_time_s = self._source.first_time_s
        self._from_s = (self.first_time_s if origin_s is None else origin_s) + start_s
        self._until_s = math.inf if duration_s is None else self._from_s + duration_s
        self.n_frames = self._expected()
        self.busy_s = 0.0

    @property
    def bag(self) -> BagVideo | None:
        """The topic of a bag that is read; None = another kind of recording."""
        return self._source if isinstance(self._source, BagVideo) else None

    @property
    def parts(self) -> tuple[VideoPart, ...]:
        """The video files, or the folder of images, with their times; none for a topic of a bag."""
        if isinstance(self._source, SegmentedVideo):
            return self._source.parts
        if isinstance(self._source, BagVideo):
            return ()
        duration_s = (self._source.n_frames or 0) / self.fps if self.fps else 0.0
        return (VideoPart(Path(self._source.path), 0.0, duration_s, self.utc),)

    @property
    def metadata(self) -> Mapping[str, str]:
        """Tags in the header of a single video file, and of its video stream; empty for other recordings."""
        return self._source.metadata if isinstance(self._source, VideoFile) else {}

    @property
    def utc(self) -> UtcStart | None:
        """UTC of the first frame; None = unknown."""
        return self._source.utc

    @property
    def is_upright_file(self) -> bool:
        """Whether this is one video file that stores its images as they are shown, without a rotation."""
        return isinstance(self._source, VideoFile) and self._source.is_upright

    @property
    def notes(self) -> tuple[str, ...]:
        """Messages for the user; complete only after the last frame."""
        return tuple(self._source.notes)

    def close(self) -> None:
        """Close the file, if it has not been read."""
        self._source.close()

    def check_unchanged(self) -> None:
        """Check that the file or folder is the one that was opened; it may have been deleted, or have grown.

        Raises:
            VideoError: it was replaced, shortened or overwritten in the meantime.
        """
        self._source.check_unchanged()

    def __iter__(self) -> Generator[VideoFrame, None, None]:
        is_empty = True
        with closing(self._source.frames(self._from_s, self._until_s)) as frames:
            while (frame := self._timed(frames)) is not None:
                is_empty = False
                yield frame
        self.check_unchanged()
        if is_empty:
            part = "" if math.isinf(self._until_s) else f" to {self._until_s:.2f} s"
            raise VideoError(
                f"{self.path}: no frame from {self._from_s:.2f} s{part}; the video starts at "
                f"{self.first_time_s:.2f} s, choose another start or duration."
            )

    def _timed(self, frames: Iterator[VideoFrame]) -> VideoFrame | None:
        began_s = _now_s()
        frame = next(frames, None)
        self.busy_s += _now_s() - began_s
        return frame

    def _expected(self) -> int | None:
        n_total = self._source.n_frames
        if n_total is None or (self._from_s <= self.first_time_s and math.isinf(self._until_s)):
            return n_total
        end_s = min(self._until_s, self.first_time_s + n_total / self.fps)
        return max(0, round((end_s - max(self._from_s, self.first_time_s)) * self.fps))


def _source(path: RecordedName, folder_fps: float, left: Source | None) -> Source:
    """The opened recording with this name; `left` is that of the left camera, if this is the right one."""
    if isinstance(path, Path) and is_bag(path):
        path = BagTopic(path, None)
    if isinstance(path, BagTopic):
        return BagVideo(path)
    try:
        files = segment_files(path)
    except ValueError as error:  # a null character
        raise VideoError(f"{quoted(str(path))}: cannot be read (invalid name); check the name.") from error
    if files is not None and (len(files) > 1 or isinstance(path, Segments)):
        return SegmentedVideo(path, files, left=left if isinstance(left, SegmentedVideo) else None)
    if files:
        return VideoFile(files[0])
    if isinstance(path, Segments):
        raise VideoError(f"{path}: expected video files, found none.")
    return _single_source(path, folder_fps)


def _single_source(path: Path, folder_fps: float) -> VideoFile | ImageFolder:
    try:
        is_folder = path.is_dir()
    except (OSError, ValueError) as error:  # a null character
        reason = describe(error) if isinstance(error, OSError) else "invalid name"
        raise VideoError(f"{path}: cannot be read ({reason}); check its permissions.") from error
    if path.is_fifo():
        raise VideoError(
            f"{path}: expected a video file, found a named pipe; give a stream by its address, such as "
            "udp://127.0.0.1:5000, or record it to a file first."
        )
    return ImageFolder(path, fps=folder_fps) if is_folder else VideoFile(path)
