"""FragmentFile: output of FFmpeg's MP4 muxer that ends with a complete fragment, also if writing fails.

After a failed write FFmpeg continues with the next packets, which makes the file unplayable from there on or, if the
failure was in a header, altogether.
"""

from __future__ import annotations

import os
from contextlib import suppress
from pathlib import Path

BUFFER_BYTES = 1 << 18
"""Size of the muxer's buffer: a fragment of one frame fits, and is written with one system call."""

_LAST_BOXES = (b"moov", b"mdat")
"""Types of the boxes with which the header and each fragment (moof, mdat) of an MP4 file end."""


class FragmentFile:
    """File object for `av.open`: not seekable, and without further writing after the first error.

    Args:
        path: the file; replaced if it exists.

    Attributes:
        failure: the first error; None = all data was written. The file then ends with its last complete fragment.

    Raises:
        OSError: the file cannot be created.
    """

    def __init__(self, path: Path) -> None:
        self.failure: OSError | None = None
        self._file = path.open("wb", buffering=0)
        self._size = self._complete_size = 0  # in bytes; up to the end of the last complete fragment
        self._header = bytearray()  # of the current box: size and type
        self._box_left = 0  # bytes

    def write(self, data: bytes) -> int:
        """Append data; errors are stored as `failure` instead of raised, so that FFmpeg frees its memory as usual."""
        if self.failure is None:
            try:
                rest = memoryview(data)
                while rest:
                    rest = rest[self._file.write(rest) :]  # less than all is written shortly before the disk is full
            except OSError as error:
                self.failure = error
                with suppress(OSError):  # pipes and devices cannot be cut
                    os.ftruncate(self._file.fileno(), self._complete_size)
            else:
                self._count(data)
        return len(data)

    def close(self) -> None:
        """Close the file.

        Raises:
            OSError: the file system reports an error only now.
        """
        self._file.close()

    def _count(self, data: bytes) -> None:
        """Follow the boxes of the file (ISO/IEC 14496-12, 4.2) to the end of the last complete fragment."""
        start = 0
        while start < len(data):
            if self._box_left == 0:
                n_bytes = 16 if self._header[:4] == b"\0\0\0\1" else 8  # 1 = the size follows the type, as 64 bits
                part = data[start : start + n_bytes - len(self._header)]
                self._header += part
                start += len(part)
                if len(self._header) < n_bytes or (n_bytes == 8 and self._header[:4] == b"\0\0\0\1"):
                    continue
                size = self._header[8:16] if n_bytes == 16 else self._header[:4]
                self._box_left = int.from_bytes(size, "big") - n_bytes
            else:
                n_bytes = min(self._box_left, len(data) - start)
                start += n_bytes
                self._box_left -= n_bytes
            if self._box_left == 0:
                if bytes(self._header[4:8]) in _LAST_BOXES:
                    self._complete_size = self._size + start
                self._header.clear()
        self._size += len(data)
