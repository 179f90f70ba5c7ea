"""Names of sources: a path, several files, a topic of a bag, a camera or stream, or a part of one."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING

from track_range.recording.sources.bags.bag_topic import BagTopic
from track_range.recording.sources.live.address import live_address
from track_range.recording.sources.segments.segments import Segments
from track_range.recording.video.file_names import is_pattern, matching_files
from track_range.recording.video.layouts import PackedLayout
from track_range.recording.video.source_name import RecordedName, SourceName

if TYPE_CHECKING:
    from track_range.recording.sources.video_half import VideoHalf
    from track_range.recording.video.options import RecordingOptions
    from track_range.recording.video.recorded_video import RecordedVideo
    from track_range.recording.video.video import Video

VideoName = Path | SourceName
"""Any source of one camera's images; a path is a video file, a folder of videos or images, a
pattern such as `DIR/*_F.mp4`, or a bag."""


@dataclass(frozen=True, slots=True)
class RecordingPath(RecordedName):
    """A video file, a folder of videos or images, a pattern, or a bag: what it is shows when it is
    opened.
    """

    path: Path

    def __str__(self) -> str:
        return str(self.path)

    @property
    def paths(self) -> tuple[Path, ...]:
        """See `SourceName`."""
        return (self.path,)

    @property
    def files(self) -> list[Path]:
        """See `SourceName`."""
        return matching_files(self.path) if is_pattern(self.path) else [self.path]

    def sides(self) -> tuple[SourceName, SourceName] | None:
        """See `SourceName`."""
        from track_range.recording.sources.files.image_names import stereo_images

        sides = stereo_images(self.path) if self.path.is_dir() else None
        return None if sides is None else (RecordingPath(sides[0]), RecordingPath(sides[1]))

    def with_topic(self, topic: str) -> SourceName:
        """See `SourceName`."""
        from track_range.recording.sources.bags.bag import is_bag

        return (
            BagTopic(self.path, topic) if is_bag(self.path) else SourceName.with_topic(self, topic)
        )

    def open_whole(self, options: RecordingOptions, left: Video | None = None) -> RecordedVideo:
        """See `RecordedName`."""
        from track_range.foundation.files.images import IMAGE_SUFFIXES
        from track_range.recording.sources.bags.bag import is_bag
        from track_range.recording.sources.files.image_folder import ImageFolder
        from track_range.recording.sources.files.video_file import VideoFile
        from track_range.recording.sources.segments.segmented_video import (
            SegmentedVideo,
            segment_files,
        )
        from track_range.recording.video.frame import VideoError

        path = self.path
        if is_bag(path):
            return BagTopic(path, None).open_whole(options, left)
        files = segment_files(path) or [path]
        is_pattern_of_images = is_pattern(path) and all(
            file.suffix.lower() in IMAGE_SUFFIXES for file in files
        )
        if is_pattern_of_images or (files == [path] and path.is_dir()):
            return ImageFolder(path, fps=options.fps, bayer=options.bayer)
        if len(files) > 1:
            return SegmentedVideo(path, files, left=left, track=options.track, fps=options.fps)
        if path.is_fifo():
            raise VideoError(
                f"{path}: expected a video file, found a named pipe; give a stream by its address, "
                "such as udp://127.0.0.1:5000, or record it to a file first."
            )
        return VideoFile(files[0], options.track, options.fps)


class _PartOfRecording(RecordedName):
    """A part of a source, with the files of the whole one."""

    __slots__ = ()
    recording: SourceName

    @property
    def paths(self) -> tuple[Path, ...]:
        """See `SourceName`."""
        return self.recording.paths

    @property
    def files(self) -> list[Path]:
        """See `SourceName`."""
        return self.recording.files


@dataclass(frozen=True, slots=True)
class VideoTrack(_PartOfRecording):
    """One of several video tracks of the files of a recording, counted from 0 without cover art."""

    recording: RecordedName
    number: int

    def __str__(self) -> str:
        return f"{self.recording} (video track {self.number})"

    def open_whole(self, options: RecordingOptions, left: Video | None = None) -> RecordedVideo:
        """See `RecordedName`."""
        return self.recording.open_whole(replace(options, track=self.number), left)


@dataclass(frozen=True, slots=True)
class Half(_PartOfRecording):
    """The images of one camera in a source whose images contain both cameras."""

    recording: SourceName
    layout: PackedLayout
    is_right: bool

    def __str__(self) -> str:
        return f"{self.recording} ({'right' if self.is_right else 'left'} camera)"

    @property
    def stem(self) -> str:
        """See `SourceName`."""
        return self.recording.stem

    def open_whole(self, options: RecordingOptions, left: Video | None = None) -> VideoHalf:
        """See `RecordedName`."""
        from track_range.recording.sources.video_half import VideoHalf

        return VideoHalf(recorded(self.recording).open_whole(options, left), self)


def video_name(name: str | VideoName | Sequence[str | Path]) -> VideoName:
    """The source or pattern with this name, or several files; ValueError for no name or several
    live sources.
    """
    if isinstance(name, str):
        return live_address(name) or Path(name)
    if isinstance(name, Path | SourceName):
        return name
    names = [video_name(part) for part in name]
    paths = tuple(part for part in names if isinstance(part, Path))
    if not names or len(paths) < len(names):
        raise ValueError("expected one camera, one stream, or video files")
    return paths[0] if len(paths) == 1 else Segments(paths)


def source_of(name: VideoName) -> SourceName:
    """The name of a source that can be opened."""
    return RecordingPath(name) if isinstance(name, Path) else name


def recorded(name: VideoName) -> RecordedName:
    """The name of a recorded source; raises VideoError for a camera or stream."""
    source = source_of(name)
    if not isinstance(source, RecordedName):
        from track_range.recording.video.frame import VideoError

        raise VideoError(f"{name}: expected a recording, found a live source.")
    return source
