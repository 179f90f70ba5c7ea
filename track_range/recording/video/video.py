"""Video: the images of one camera, recorded or live."""

from abc import ABC, abstractmethod
from collections.abc import Generator, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import ClassVar, Protocol

from track_range.foundation.arrays import FloatArray32, Image
from track_range.recording.video.frame import VideoFrame
from track_range.recording.video.layouts import StereoLayout
from track_range.recording.video.source_name import SourceName
from track_range.recording.video.utc import UtcStart
from track_range.stereo.geometry.camera import pixel_aspect_of, shown_size
from track_range.stereo.rig_formats.camera_info import CameraInfo


@dataclass(frozen=True, slots=True)
class VideoPart:
    """One file of a recording, or its folder of images."""

    path: Path
    start_s: float  # time of its first frame, in seconds from the first frame of the recording
    duration_s: float  # length as the header states it; 0 = unknown
    utc: UtcStart | None  # UTC of its first frame; None = unknown


class RecordedDepth(Protocol):
    """Depth images beside those of a video."""

    def at(self, time_s: float) -> FloatArray32 | None:
        """(h, w) depth in metres of the image at a time of the video, NaN = unknown; it covers the
        whole image. None = there is none. Times are passed in their order.
        """
        ...


class Video(ABC):
    """The images of one camera, recorded or live; iterating reads them."""

    is_live: ClassVar[bool] = False
    path: Path | SourceName  # name of the source
    width_px: int  # of the upright images, as the height
    height_px: int
    # width / height of the pixels as the source states it; None = not stated
    pixel_aspect: float | None = None
    is_grey: bool  # whether the first frame has no colour
    fps: float  # nominal frame rate
    has_origin = True  # whether the times count from a moment that other sources may share
    time_question: str = ""  # what has to be given, since the times are not known; empty = nothing
    first_time_s: float  # time of the first frame, independent of the part that is read
    n_total: int | None = None  # estimated number of frames of the whole source; None = unknown
    # tags in the header of a single video file, and of its video stream; empty for other sources
    metadata: Mapping[str, str] = {}
    # (width, height) of the tracks of a file, unless one is chosen
    tracks_px: tuple[tuple[int, int], ...] = ()
    depth_tracks: frozenset[int] = frozenset()  # those of depth or infrared images beside others
    # where the images have those of two cameras; None = not stated
    stated_layout: StereoLayout | None = None
    camera: CameraInfo | None = None  # calibration that the source contains; None = none
    is_rectified = False  # whether the source states that its images are
    depth: RecordedDepth | None = None  # depth of the same view that the source contains
    depth_notes: tuple[str, ...] = ()  # those of `notes` about the depth that the source contains
    first_image: Image | None = None  # as long as it is needed
    # only the images up to this time after each keyframe are read, s, where keyframes follow each
    # other closely; set before reading, None = all images. Sources without keyframes read all.
    burst_s: float | None = None
    # time spent reading and decoding so far: CPU time of this thread, or wall time with several
    # threads of FFmpeg
    busy_s = 0.0

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

    @property
    def parts(self) -> tuple[VideoPart, ...]:
        """The video files, or the folder of images, with their times; none for a topic of a bag or
        a live source.
        """
        return ()

    @property
    def n_frames(self) -> int | None:
        """Estimated number of frames in the selected part; None = unknown."""
        return self.n_total

    @property
    def whole(self) -> "Video":
        """The video whose images contain those of this one; others than halves are whole."""
        return self

    @property
    def shown_size_px(self) -> tuple[int, int]:
        """(width, height) of the images after they were resampled to square pixels, if at all."""
        size_px = self.width_px, self.height_px
        return shown_size(size_px, pixel_aspect_of(size_px, self.pixel_aspect))

    def forget_first_image(self) -> None:
        """Free the memory of `first_image`."""
        self.first_image = None

    def with_packed_pixels(self, aspect: float) -> None:  # noqa: B027  # few images are squeezed
        """Correct the pixels of squeezed images of two cameras, of which a calibration states the
        width / height `aspect`; other images are not squeezed.
        """

    def close(self) -> None:  # noqa: B027  # not all recordings keep files open
        """Close the source, if it has not been read."""

    @abstractmethod
    def ahead(self, name: str) -> Generator[VideoFrame, None, None]:
        """The frames, read ahead in a thread with this name; the newest frames of a live source,
        which stays open.
        """

    @abstractmethod
    def __iter__(self) -> Generator[VideoFrame, None, None]: ...
