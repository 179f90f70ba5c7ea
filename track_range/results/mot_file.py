"""mot.txt: the tracks of a run in MOTChallenge's format, frames and pixels counted from 1."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Any

from track_range.results.writers import RunInfo
from track_range.run.frame_result import FrameResult
from track_range.tracking.mot_format import mot_lines


class MotWriter:
    """Writer of mot.txt, flushed after every frame."""

    files = ("mot.txt",)

    def open(self, info: RunInfo, folder: Path) -> None:
        """Create the file."""
        self._file = (folder / "mot.txt").open("w", encoding="utf-8", newline="\n")

    def write(self, result: FrameResult) -> None:
        """Add the tracks of a frame."""
        self._file.writelines(mot_lines(result.tracks, result.index))
        self._file.flush()

    def close(self, summary: Mapping[str, Any] | None) -> None:
        """Close the file."""
        self._file.close()
