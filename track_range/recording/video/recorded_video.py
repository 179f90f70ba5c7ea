"""RecordedVideo: the images of one camera from a file, several files, a folder of images, or a
topic of a bag.
"""

import math
import time
from abc import ABC, abstractmethod
from collections.abc import Generator, Mapping, Sequence
from contextlib import closing
from dataclasses import dataclass
from pathlib import Path

from track_range.foundation.arrays import Image
from track_range.recording.video.frame import VideoError, VideoFrame
from track_range.recording.video.names import RecordedName, StereoLayout
from track_range.recording.video.threads import DECODER_THREADS
from track_range.recording.video.utc import UtcStart
from track_range.stereo.geometry.camera import pixel_aspect_of, shown_size

_now_s = time.thread_time if DECODER_THREADS == 1 else time.perf_counter


@dataclass(frozen=True, slots=True)
class VideoPart:
    """One file of a recording, or its folder of images."""

    path: Path
    start_s: float  # time of its first frame, in seconds from the first frame of the recording
    duration_s: float  # length as the header states it; 0 = unknown
    utc: UtcStart | None  # UTC of its first frame; None = unknown


class RecordedVideo(ABC):
    """The frames of a recording; each iteration reads the part that was selected, at first all of
    it.

    A file is opened once for its properties and the first iteration, and again for each later
    iteration.

    While iterating, raises VideoError if no frame is in the part to read, an image of a folder
    cannot be decoded or has another size, or the file or folder was replaced, shortened or
    overwritten in the meantime.
    """

    path: RecordedName  # name of the recording
    width_px: int  # of the upright images, as the height
    height_px: int
    # width / height of the pixels as the file states it; None = not stated
    pixel_aspect: float | None = None
    is_grey: bool  # whether the first frame has no colour
    fps: float  # nominal frame rate
    has_times = True  # whether frames have recorded times; else their times follow from a rate
    first_time_s: float  # time of the file's first frame, independent of the selected part
    n_total: int | None  # estimated number of frames of the whole recording; None = unknown
    # tags in the header of a single video file, and of its video stream; empty for other recordings
    metadata: Mapping[str, str] = {}
    # (width, height) of the tracks of a file, unless one is chosen
    tracks_px: tuple[tuple[int, int], ...] = ()
    # where the images have those of two cameras; None = not stated
    stated_layout: StereoLayout | None = None
    first_image: Image | None = None  # as long as it is needed
    # whether this is the first track of a video file, stored without a rotation
    is_upright_file = False
    # time spent reading and decoding so far: CPU time of this thread, or wall time with several
    # threads of FFmpeg
    busy_s = 0.0
    _part_s: tuple[float, float] | None = None  # file times

    @property
    @abstractmethod
    def utc(self) -> UtcStart | None:
        """UTC of the first frame; None = unknown."""

    @property
    @abstractmethod
    def notes(self) -> tuple[str, ...]:
        """Messages for the user, including the problems of the latest reading; complete only after
        the last frame.
        """

    def forget_first_image(self) -> None:
        """Free the memory of `first_image`."""
        self.first_image = None

    @property
    def parts(self) -> tuple[VideoPart, ...]:
        """The video files, or the folder of images, with their times; none for a topic of a bag."""
        duration_s = (self.n_total or 0) / self.fps if self.fps else 0.0
        return (VideoPart(Path(str(self.path)), 0.0, duration_s, self.utc),)

    @property
    def shown_size_px(self) -> tuple[int, int]:
        """(width, height) of the images after they were resampled to square pixels, if at all."""
        size_px = self.width_px, self.height_px
        return shown_size(size_px, pixel_aspect_of(size_px, self.pixel_aspect))

    @property
    def n_frames(self) -> int | None:
        """Estimated number of frames in the selected part; None = unknown."""
        if self.n_total is None or self._part_s is None:
            return self.n_total
        from_s, until_s = self._part_s
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

    def close(self) -> None:  # noqa: B027  # not all recordings keep files open
        """Close the file, if it has not been read."""

    def __iter__(self) -> Generator[VideoFrame, None, None]:
        from_s, until_s = self._part_s or (self.first_time_s, math.inf)
        is_empty = True
        with closing(self.frames(from_s, until_s)) as frames:
            while True:
                began_s = _now_s()
                frame = next(frames, None)
                self.busy_s += _now_s() - began_s
                if frame is None:
                    break
                is_empty = False
                yield frame
        self.check_unchanged()
        if is_empty:
            end_s = (
                self.first_time_s + (self.n_total or math.inf) / self.fps if self.fps else math.inf
            )
            part = f" to {until_s:.2f} s" if until_s < end_s else ""
            end = "" if math.isinf(end_s) else f" and ends at {end_s:.2f} s"
            raise VideoError(
                f"{self.path}: there is no frame from {from_s:.2f} s{part}; choose another start "
                f"or duration (the video starts at {self.first_time_s:.2f} s{end})."
            )
