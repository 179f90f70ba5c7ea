"""Segments: the name of several files that are one recording."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING

from track_range.foundation.files.input_files import counted
from track_range.recording.video.source_name import RecordedName, SourceName

if TYPE_CHECKING:
    from track_range.recording.sources.segments.segmented_video import SegmentedVideo
    from track_range.recording.video.options import RecordingOptions
    from track_range.recording.video.video import Video


@dataclass(frozen=True, slots=True)
class Segments(RecordedName):
    """At least two video files that form one recording, as a dashcam writes them."""

    paths: tuple[Path, ...]

    def __str__(self) -> str:
        return f"{self.paths[0]} and {counted(len(self.paths) - 1, 'other file')}"

    def with_topic(self, topic: str) -> SourceName:
        """See `SourceName`; the files of a bag are given as their folder."""
        from track_range.recording.sources.segments import segmented_video

        segmented_video.files_of_parts(self)
        return SourceName.with_topic(self, topic)

    def open_whole(self, options: RecordingOptions, left: Video | None = None) -> SegmentedVideo:
        """See `RecordedName`."""
        from track_range.recording.sources.segments import segmented_video

        files = segmented_video.files_of_parts(self)
        return segmented_video.SegmentedVideo(
            self, files, left=left, track=options.track, fps=options.fps, is_listed=True
        )
