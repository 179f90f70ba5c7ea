"""FrameFile, RowFile: files of a run in progress with whole frames only, also after a failed write or a kill."""

from __future__ import annotations

import csv
import io
import os
from collections.abc import Iterable
from contextlib import suppress
from pathlib import Path


class FrameFile:
    """File to which the content of one frame after the other is added with one system call.

    If writing fails, such as on a full disk, the file is cut back to the last whole frame.

    Args:
        path: the file; replaced if it exists.
        header: content before that of the first frame.

    Raises:
        OSError: the file cannot be created.
    """

    def __init__(self, path: Path, header: bytes = b"") -> None:
        self._file = path.open("wb", buffering=0)
        self._end = self._previous_end = 0  # size in bytes with and without the last frame
        try:
            self.add(header)
        except OSError:
            self._file.close()
            raise
        self._previous_end = self._end

    def add(self, frame: bytes) -> None:
        """Add the content of a frame; may be empty.

        Raises:
            OSError: it cannot be written; the file is as before.
        """
        content = memoryview(frame)
        end = self._end + len(content)
        try:
            while content:
                n_written = self._file.write(content)  # less than all is written shortly before the disk is full
                content = content[n_written:]
        except BaseException:
            self._cut(self._end)
            raise
        self._previous_end, self._end = self._end, end

    def discard_last(self) -> None:
        """Remove the content of the last frame, since another file lacks it; a second call does nothing."""
        self._cut(self._previous_end)
        self._end = self._previous_end

    def close(self) -> None:
        """Close the file."""
        self._file.close()

    def _cut(self, size: int) -> None:
        with suppress(OSError):  # pipes and devices cannot be cut
            os.ftruncate(self._file.fileno(), size)
            self._file.seek(size)


class RowFile(FrameFile):
    """Text file, UTF-8, to which the rows of one frame after the other are added (see `FrameFile`).

    Args:
        path: the file; replaced if it exists.
        header: text before the rows of the first frame.

    Raises:
        OSError: the file cannot be created.
    """

    def __init__(self, path: Path, header: str = "") -> None:
        super().__init__(path, header.encode("utf-8"))

    def write(self, rows: str) -> None:
        """Add the rows of a frame.

        Args:
            rows: whole lines; empty if the frame has none.

        Raises:
            OSError: they cannot be written; the file is as before.
        """
        self.add(rows.encode("utf-8"))


def csv_text(rows: Iterable[Iterable[str]]) -> str:
    """Rows as lines of a CSV file."""
    text = io.StringIO(newline="")
    csv.writer(text, lineterminator="\n").writerows(rows)
    return text.getvalue()
