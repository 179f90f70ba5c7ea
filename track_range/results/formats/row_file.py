"""RowFile: text file of a run in progress that contains whole frames only, also after a failed write or a kill."""

from __future__ import annotations

import os
from contextlib import suppress
from pathlib import Path


class RowFile:
    """Text file, UTF-8, to which the rows of one frame after the other are added with one system call.

    If writing fails, such as on a full disk, the file is cut back to the last whole frame.

    Args:
        path: the file; replaced if it exists.
        header: text before the rows of the first frame.

    Raises:
        OSError: the file cannot be created.
    """

    def __init__(self, path: Path, header: str = "") -> None:
        self._file = path.open("wb", buffering=0)
        self._end = self._previous_end = 0  # size in bytes with and without the last frame
        try:
            self.write(header)
        except OSError:
            self._file.close()
            raise
        self._previous_end = self._end

    def write(self, rows: str) -> None:
        """Add the rows of a frame.

        Args:
            rows: whole lines; empty if the frame has none.

        Raises:
            OSError: they cannot be written; the file is as before.
        """
        content = memoryview(rows.encode("utf-8"))
        end = self._end + len(content)
        try:
            while content:
                content = content[
                    self._file.write(content) :
                ]  # less than all is written shortly before the disk is full
        except BaseException:
            self._cut(self._end)
            raise
        self._previous_end, self._end = self._end, end

    def discard_last(self) -> None:
        """Remove the rows of the last frame, since another file lacks them; a second call does nothing."""
        self._cut(self._previous_end)
        self._end = self._previous_end

    def close(self) -> None:
        """Close the file."""
        self._file.close()

    def _cut(self, size: int) -> None:
        with suppress(OSError):  # pipes and devices cannot be cut
            os.ftruncate(self._file.fileno(), size)
            self._file.seek(size)
