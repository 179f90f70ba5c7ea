"""Videos of a run in progress (overlay.mp4, disparity.mp4), drawn and encoded in a separate thread."""

from __future__ import annotations

from collections import deque
from collections.abc import Callable
from concurrent.futures import Future, ThreadPoolExecutor
from dataclasses import dataclass
from pathlib import Path
from types import TracebackType
from typing import Self

from track_range.foundation.arrays import Image
from track_range.run.frame_result import FrameResult
from track_range.run.prefetch import lower_thread_priority
from track_range.run.stage_clock import StageClock
from track_range.video.writer import VideoWriter

_QUANTIZER = 28
"""Constant quantizer of H.264, visually equal to crf 23; 2.7 ms and 57 kB per frame of KITTI 0003 (3.3 ms, 72 kB)."""

_MAX_QUEUED = 4
"""Maximum number of frames that may wait to be drawn; then `write` blocks."""

Draw = Callable[[FrameResult], Image]
"""Draws a result as (H, W, 3) uint8 BGR; called from one thread."""


@dataclass(frozen=True, slots=True)
class VideoFormat:
    """(Width, height) in pixels and nominal frame rate of a video."""

    size_px: tuple[int, int]
    fps: float


class ResultVideo:
    """Draws and encodes results in a thread; an error is raised by a later call of `write`."""

    def __init__(self, path: Path, draw: Draw, *, form: VideoFormat, clock: StageClock) -> None:
        """Create the video; its time is added to the stage "write" of `clock`.

        Raises:
            VideoError: the file cannot be written.
        """
        width_px, height_px = form.size_px
        self._writer = VideoWriter(path, width_px=width_px, height_px=height_px, fps=form.fps, quantizer=_QUANTIZER)
        self._picture = draw
        self._clock = clock
        self._thread = ThreadPoolExecutor(1, thread_name_prefix=path.stem, initializer=lower_thread_priority)
        self._waiting: deque[Future[None]] = deque()

    def __enter__(self) -> Self:
        return self

    def __exit__(self, kind: type[BaseException] | None, error: BaseException | None, at: TracebackType | None) -> None:
        try:
            while self._waiting:
                self._waiting.popleft().result()
        finally:
            self._thread.shutdown()
            self._writer.close()

    def write(self, result: FrameResult) -> None:
        """Queue one frame; blocks only if `_MAX_QUEUED` frames are waiting."""
        self._waiting.append(self._thread.submit(self._draw, result))
        if len(self._waiting) > _MAX_QUEUED:
            self._waiting.popleft().result()

    def _draw(self, result: FrameResult) -> None:
        with self._clock.stage("write"):
            self._writer.write(self._picture(result), result.frame.time_s)
