"""SourceName: the name of a source of the images of one camera, which opens it.

Names are compared and printed without reading anything, and need no decoder: what reads a source is
imported when the source is opened.
"""

from __future__ import annotations

from abc import ABC, abstractmethod
from pathlib import Path
from typing import TYPE_CHECKING, ClassVar

from track_range.recording.video.file_names import stem_of_path

if TYPE_CHECKING:
    from track_range.recording.video.options import RecordingOptions
    from track_range.recording.video.recorded_video import RecordedVideo
    from track_range.recording.video.video import Video

_MIN_SIDE_PX = 8  # smaller videos show no road users, and their headers are usually damaged


class SourceName(ABC):
    """The name of a source of the images of one camera; its text form is that of messages."""

    __slots__ = ()
    is_live: ClassVar[bool] = False  # whether it is a camera or a stream

    @abstractmethod
    def open(self, options: RecordingOptions, left: Video | None = None) -> Video:
        """The opened source, of which the part of the options is read.

        `left` is the left video of a pair whose right video this is. Raises VideoError if the
        source does not exist or is no video, or nothing can be decoded.
        """

    @property
    @abstractmethod
    def paths(self) -> tuple[Path, ...]:
        """The files, folders and patterns that are named; none for a live source."""

    @property
    def files(self) -> list[Path]:
        """The files and folders of the source; none for a live source."""
        return list(self.paths)

    @property
    @abstractmethod
    def stem(self) -> str:
        """Stem of names of files for this source."""

    def sides(self) -> tuple[SourceName, SourceName] | None:
        """Left and right of a folder that contains the images of two cameras; None = of one."""
        return None

    def with_topic(self, topic: str) -> SourceName:
        """The topic of a bag; raises VideoError for other sources."""
        from track_range.recording.video.frame import VideoError

        raise VideoError(
            f"{self}: expected an MCAP file or ROS bag, since topics are given; omit --topics."
        )


class RecordedName(SourceName):
    """The name of a source that is recorded."""

    __slots__ = ()

    @property
    def stem(self) -> str:
        """See `SourceName`."""
        return stem_of_path(self.paths[0])

    def open(self, options: RecordingOptions, left: Video | None = None) -> RecordedVideo:
        """See `SourceName`; also raises VideoError if the images are too small."""
        from track_range.recording.video.frame import VideoError

        video = self.open_whole(options, left)
        if min(video.width_px, video.height_px) < _MIN_SIDE_PX:
            video.close()
            raise VideoError(
                f"{self}: expected images of at least {_MIN_SIDE_PX}x{_MIN_SIDE_PX} px, found "
                f"{video.width_px}x{video.height_px} px; check the video."
            )
        origin_s = None if left is None or left.is_live else left.first_time_s
        video.select(options.start_s, options.duration_s, origin_s=origin_s)
        return video

    @abstractmethod
    def open_whole(self, options: RecordingOptions, left: Video | None = None) -> RecordedVideo:
        """The opened source from its start to its end. Errors and arguments as of `open`."""
