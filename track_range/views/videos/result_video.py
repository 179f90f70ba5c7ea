"""Videos of a run in progress (overlay.mp4, disparity.mp4), drawn and encoded in a separate
thread.
"""

from __future__ import annotations

from collections import deque
from collections.abc import Callable
from concurrent.futures import Future, ThreadPoolExecutor
from pathlib import Path
from typing import Self

from track_range.foundation.arrays import Image
from track_range.foundation.prefetch import lower_thread_priority
from track_range.pipeline.clock import StageClock
from track_range.pipeline.frame_result import FrameResult
from track_range.views.videos.video_writer import MAX_HELD_FRAMES, VideoWriter

# of H.264: visually equal to crf 23, and on KITTI 0003 faster and smaller
QUANTIZER = 28
# that a video may lack after a kill, whichever is less; at least one frame
_MAX_LAG_S, _MAX_LAG_FRAMES = 1.0, 5
# draws a result as (H, W, 3) uint8 BGR; called from one thread
Draw = Callable[[FrameResult], Image]


class ResultVideo:
    """Draws and encodes results in a thread; an error is raised by a later call of `wait` or
    `write`.

    `draw` draws a result in the size `size_px` (width, height); the stage "write" of `clock` counts
    the time. `precedes_rows`: whether frames must be written before their rows, since the video
    would otherwise lag too much; `write` then returns after the frame is encoded. Raises
    VideoError: the file cannot be written; also raised by `wait`, `write` and `raise_error` for an
    earlier frame.
    """

    def __init__(
        self, path: Path, draw: Draw, *, size_px: tuple[int, int], fps: float, clock: StageClock
    ) -> None:
        width_px, height_px = size_px
        self._writer = VideoWriter(
            path, width_px=width_px, height_px=height_px, fps=fps, quantizer=QUANTIZER
        )
        self._picture = draw
        self._clock = clock
        self._thread = ThreadPoolExecutor(
            1, thread_name_prefix=path.stem, initializer=lower_thread_priority
        )
        self._queue: deque[Future[None]] = deque()
        max_lag = min(_MAX_LAG_FRAMES, max(1, int(_MAX_LAG_S * fps)))
        # The rows of the next frame are written while these frames wait, and the muxer holds
        # others.
        self._max_queued = max(0, max_lag - MAX_HELD_FRAMES - 1)
        self.precedes_rows = max_lag <= MAX_HELD_FRAMES

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_error: object) -> None:
        try:
            self._finish(0)
        finally:
            self._thread.shutdown()
            self._writer.close()

    def wait(self) -> None:
        """Wait until so few frames are queued that the rows of the next frame may be written."""
        self.raise_error()
        self._finish(self._max_queued)

    def write(self, result: FrameResult) -> None:
        """Queue one frame; with `precedes_rows`, write it."""
        self._queue.append(self._thread.submit(self._draw, result))
        if self.precedes_rows:
            self._finish(0)

    def raise_error(self) -> None:
        """Raise the error of a frame that was drawn, if there is one."""
        while self._queue and self._queue[0].done():
            self._queue.popleft().result()

    def _finish(self, max_queued: int) -> None:
        while len(self._queue) > max_queued:
            self._queue.popleft().result()

    def _draw(self, result: FrameResult) -> None:
        with self._clock.stage("write"):
            self._writer.write(self._picture(result), result.frame.time_s)
