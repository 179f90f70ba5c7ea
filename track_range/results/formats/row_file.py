"""RowFile, RowWriter: files of a run in progress with whole frames only, also after a failed write
or a kill.
"""

from __future__ import annotations

import csv
import io
import os
from collections.abc import Iterable, Mapping
from contextlib import suppress
from pathlib import Path
from typing import Any

from track_range.pipeline.frame_result import FrameResult
from track_range.results.formats.run_info import RunInfo


class RowFile:
    """UTF-8 text file to which the content of each frame is appended with one system call.

    If writing fails, such as on a full disk, the file is cut back to the last whole frame. An
    existing file is replaced; `header` is the content before the first frame. OSError: the file
    cannot be created.
    """

    def __init__(self, path: Path, header: str | bytes = b"") -> None:
        self._file = path.open("wb", buffering=0)
        self._end = self._previous_end = 0  # size in bytes with and without the last frame
        try:
            self.write(header)
        except OSError:
            self._file.close()
            raise
        self._previous_end = self._end

    def write(self, rows: str | bytes) -> None:
        """Add whole lines of a frame, perhaps none; OSError if they cannot be written: the file is
        then unchanged.
        """
        content = memoryview(rows.encode("utf-8") if isinstance(rows, str) else rows)
        end = self._end + len(content)
        try:
            while content:
                # less than all is written shortly before the disk is full
                n_written = self._file.write(content)
                content = content[n_written:]
        except BaseException:
            self._cut(self._end)
            raise
        self._previous_end, self._end = self._end, end

    def discard_last(self) -> None:
        """Remove the content of the last frame, since another file lacks it; a second call does
        nothing.
        """
        self._cut(self._previous_end)
        self._end = self._previous_end

    def close(self) -> None:
        """Close the file."""
        self._file.close()

    def _cut(self, size: int) -> None:
        with suppress(OSError):  # pipes and devices cannot be cut
            os.ftruncate(self._file.fileno(), size)
            self._file.seek(size)


class RowWriter:
    """Base of the writers of one file to which frames are appended (see `RowFile`), which implement `rows` and, for a
    header, `header`.
    """

    files: tuple[str, ...]

    def header(self) -> str:
        """Text before the first frame."""
        return ""

    def rows(self, result: FrameResult) -> str | bytes:
        """Whole lines of a frame, or its bytes."""
        raise NotImplementedError

    def open(self, info: RunInfo, folder: Path) -> None:
        """Create the file with its header."""
        self.info = info
        self._file = RowFile(folder / self.files[0], self.header())

    def write(self, result: FrameResult) -> None:
        """Add the rows of a frame."""
        self._file.write(self.rows(result))

    def discard_last(self) -> None:
        """Remove the rows of the last frame."""
        self._file.discard_last()

    def close(self, summary: Mapping[str, Any] | None) -> None:
        """Close the file."""
        self._file.close()


def csv_text(rows: Iterable[Iterable[str]]) -> str:
    """Rows as lines of a CSV file."""
    text = io.StringIO(newline="")
    csv.writer(text, lineterminator="\n").writerows(rows)
    return text.getvalue()
