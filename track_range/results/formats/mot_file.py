"""mot.txt: the tracks of a run in MOTChallenge's format, frames and pixels counted from 1."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Any

from track_range.detection.formats.video_labels.mot import mot_lines
from track_range.pipeline.frame_result import FrameResult
from track_range.results.formats.row_file import RowFile
from track_range.results.writers import RunInfo


class MotWriter:
    """Writer of mot.txt, frame by frame (see `RowFile`)."""

    files = ("mot.txt",)

    def open(self, info: RunInfo, folder: Path) -> None:
        """Create the file."""
        self._file = RowFile(folder / "mot.txt")

    def write(self, result: FrameResult) -> None:
        """Add the tracks of a frame."""
        self._file.write("".join(mot_lines(result.tracks, result.index)))

    def discard_last(self) -> None:
        """Remove the tracks of the last frame."""
        self._file.discard_last()

    def close(self, summary: Mapping[str, Any] | None) -> None:
        """Close the file."""
        self._file.close()
