"""VideoReader: a video file, or a folder of numbered images, as frames with times."""

from __future__ import annotations

import math
import time
from collections.abc import Generator, Iterator
from contextlib import closing
from pathlib import Path

from track_range.video.file import VideoFile
from track_range.video.frame import VideoError, VideoFrame
from track_range.video.image_folder import ImageFolder
from track_range.video.threads import DECODER_THREADS

_now_s = time.thread_time if DECODER_THREADS == 1 else time.perf_counter


class VideoReader:
    """A video file, or a folder of numbered images, as frames with times.

    It is opened once for its properties and the first iteration; each later iteration opens it anew.

    Args:
        path: the file or folder.
        folder_fps: rate of a folder without timestamps.txt.
        start_s: where to start, in seconds after `origin_s`; frames before it are skipped, mostly without decoding.
        duration_s: how much to read from there; None = all.
        origin_s: the file time that `start_s` counts from; None = the first frame. For the right video of a pair:
            the left one's `first_time_s`.

    Attributes:
        width_px, height_px: size of the upright images.
        is_grey: the first frame has no colour.
        fps: nominal rate.
        first_time_s: time of the file's first frame (whatever `start_s` is).
        n_frames: frames to expect; an estimate; None = unknown.
        busy_s: time spent reading and decoding so far: processor time, or time by the wall where FFmpeg decodes in
            threads of its own.

    Raises:
        VideoError: missing, no video, nothing decodes. While iterating: no frame in the part asked for, an image that
            cannot be decoded in a folder, an image of another size.
    """

    def __init__(
        self,
        path: Path,
        *,
        folder_fps: float = 10.0,
        start_s: float = 0.0,
        duration_s: float | None = None,
        origin_s: float | None = None,
    ) -> None:
        self.path = path
        self._source = _source(path, folder_fps)
        self.width_px, self.height_px = self._source.width_px, self._source.height_px
        self.is_grey, self.fps = self._source.is_grey, self._source.fps
        self.first_time_s = self._source.first_time_s
        self._from_s = (self.first_time_s if origin_s is None else origin_s) + start_s
        self._until_s = math.inf if duration_s is None else self._from_s + duration_s
        self.n_frames = self._expected()
        self.busy_s = 0.0

    @property
    def notes(self) -> tuple[str, ...]:
        """Sentences for the user; complete only after the last frame."""
        return tuple(self._source.notes)

    def close(self) -> None:
        """Close the file, if it has not been read."""
        self._source.close()

    def __iter__(self) -> Generator[VideoFrame, None, None]:
        is_empty = True
        with closing(self._source.frames(self._from_s, self._until_s)) as frames:
            while (frame := self._timed(frames)) is not None:
                is_empty = False
                yield frame
        if is_empty:
            part = "on" if math.isinf(self._until_s) else f"to {self._until_s:.2f} s"
            raise VideoError(
                f"{self.path}: no frame from {self._from_s:.2f} s {part}, where its own time starts at "
                f"{self.first_time_s:.2f} s: choose another start or duration."
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


def _source(path: Path, folder_fps: float) -> VideoFile | ImageFolder:
    try:
        path.stat()
        return ImageFolder(path, fps=folder_fps) if path.is_dir() else VideoFile(path)
    except FileNotFoundError as error:
        raise VideoError(f"{path}: there is no such file or folder: check the name.") from error
    except OSError as error:
        raise VideoError(f"{path}: cannot be read ({error.strerror}): check it and its permissions.") from error
