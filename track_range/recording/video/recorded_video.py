"""RecordedVideo: the images of one camera from a file, several files, a folder of images, or a
topic of a bag.
"""

import math
import time
from abc import abstractmethod
from collections.abc import Generator, Sequence
from contextlib import closing
from dataclasses import replace
from pathlib import Path

from track_range.foundation.prefetch import prefetch
from track_range.recording.video.frame import VideoError, VideoFrame
from track_range.recording.video.threads import DECODER_THREADS, FRAMES_AHEAD
from track_range.recording.video.video import Video, VideoPart

_now_s = time.thread_time if DECODER_THREADS == 1 else time.perf_counter


class RecordedVideo(Video):
    """The frames of a recording; each iteration reads the part that was selected, at first all of
    it.

    A file is opened once for its properties and the first iteration, and again for each later
    iteration.

    While iterating, raises VideoError if no frame is in the part to read, an image of a folder
    cannot be decoded or has another size, or the file or folder was replaced, shortened or
    overwritten in the meantime.
    """

    # whether this is the first track of a video file, stored without a rotation
    is_upright_file = False
    # added to the times of the file: of the right video of a pair whose clocks have other origins
    offset_s = 0.0
    _part_s: tuple[float, float] | None = None  # file times, of the left video of a pair

    @property
    def parts(self) -> tuple[VideoPart, ...]:
        """See `Video`."""
        duration_s = (self.n_total or 0) / self.fps if self.fps else 0.0
        return (VideoPart(Path(str(self.path)), 0.0, duration_s, self.utc),)

    @property
    def n_frames(self) -> int | None:
        """See `Video`."""
        if self.n_total is None or self._part_s is None:
            return self.n_total
        from_s, until_s = (bound_s - self.offset_s for bound_s in self._part_s)
        if from_s <= self.first_time_s and math.isinf(until_s):
            return self.n_total
        end_s = min(until_s, self.first_time_s + self.n_total / self.fps)
        return max(0, round((end_s - max(from_s, self.first_time_s)) * self.fps))

    def select(
        self, start_s: float, duration_s: float | None = None, *, origin_s: float | None = None
    ) -> None:
        """Read only a part, from `start_s` after `origin_s` on; most frames before it are not
        decoded.

        Without a `duration_s` it goes to the end. `origin_s` is a file time, by default the first
        frame's, and for the right video of a pair the left video's `first_time_s`.
        """
        from_s = (self.first_time_s if origin_s is None else origin_s) + start_s
        self._part_s = from_s, math.inf if duration_s is None else from_s + duration_s

    @abstractmethod
    def frames(self, from_s: float, until_s: float) -> Generator[VideoFrame, None, None]:
        """The frames with file times in [from_s, until_s); damaged frames are skipped, see
        `notes`.
        """

    @abstractmethod
    def check_unchanged(self) -> None:
        """Raise a VideoError if a file, while open, was replaced, cut or overwritten; growth is no
        error.
        """

    def check_size(
        self, size_px: Sequence[int], like: str, advice: str, path: Path | None = None
    ) -> None:
        """Raise a VideoError if an image, in the file `path` if there are several, has another
        width or height.
        """
        if tuple(size_px) != (self.width_px, self.height_px):
            raise VideoError(
                f"{path or self.path}: expected images of {self.width_px}x{self.height_px} "
                f"px{like}, got {size_px[0]}x{size_px[1]} px; {advice}."
            )

    def ahead(self, name: str) -> Generator[VideoFrame, None, None]:
        """See `Video`."""
        return prefetch(self, depth=FRAMES_AHEAD, low_priority=True, name=name)

    def __iter__(self) -> Generator[VideoFrame, None, None]:
        offset_s = self.offset_s
        from_s, until_s = self.first_time_s, math.inf
        if self._part_s is not None:
            from_s, until_s = (bound_s - offset_s for bound_s in self._part_s)
        is_empty = True
        with closing(self.frames(from_s, until_s)) as frames:
            while True:
                began_s = _now_s()
                frame = next(frames, None)
                self.busy_s += _now_s() - began_s
                if frame is None:
                    break
                is_empty = False
                yield replace(frame, time_s=frame.time_s + offset_s) if offset_s else frame
        self.check_unchanged()
        if is_empty:
            end_s = (
                self.first_time_s + (self.n_total or math.inf) / self.fps if self.fps else math.inf
            )
            part = f" to {until_s:.2f} s" if until_s < end_s else ""
            end = "" if math.isinf(end_s) else f" and ends at {end_s:.2f} s"
            raise VideoError(
                f"{self.path}: expected frames from {from_s:.2f} s{part} on, found none, since the "
                f"video starts at {self.first_time_s:.2f} s{end}; choose another start or duration."
            )
