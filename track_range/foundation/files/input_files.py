"""Reading of files that a user names: regular files of limited size; errors are one sentence with
the path.

Pipes, devices and folders are refused before they are read: a named pipe would block, and /dev/zero
has no end.
"""

import codecs
import errno
import os
import stat
from collections.abc import Iterable, Iterator
from contextlib import contextmanager
from io import BufferedReader
from pathlib import Path
from typing import BinaryIO

from track_range.foundation.files.atomic_files import describe

# size limit, bytes, of files that a person or a calibration program writes: rigs, settings
MAX_TEXT_BYTES = 1_000_000
# size limit, bytes, of tables with a row per object: labels, detections, tracks
MAX_TABLE_BYTES = 2_000_000_000
# sizes of the blocks in which files are read, and of their start
_BLOCK_BYTES, _START_BYTES = 1 << 20, 65_536
_MAX_QUOTED = 60  # characters of a value in a message

_ARCHIVES = {
    b"PK\x03\x04": "a ZIP archive",
    b"\x1f\x8b": "a gzip archive",
    b"7z\xbc\xaf": "a 7z archive",
}
# also of UTF-32, which spreadsheets and Windows' editors write
_UTF_16_MARKS = (b"\xff\xfe", b"\xfe\xff")

_SPECIAL_FILES = (
    (stat.S_ISDIR, "a folder"),
    (stat.S_ISFIFO, "a named pipe"),
    (stat.S_ISCHR, "a device"),
    (stat.S_ISBLK, "a device"),
    (stat.S_ISSOCK, "a socket"),
)


def open_regular(
    path: Path, error: type[Exception], expected: str, *, max_bytes: int | None = None
) -> BufferedReader:
    """A regular file, opened for reading; symbolic links are followed.

    Raises `error` if there is no such file, it is not a regular file, is larger than `max_bytes`,
    or cannot be read; the message names the file and `expected`, a noun phrase such as "the
    rig.yaml of the cameras".
    """
    try:
        # without O_NONBLOCK, the opening of a named pipe waits for a writer
        descriptor = os.open(
            path, os.O_RDONLY | getattr(os, "O_NONBLOCK", 0) | getattr(os, "O_BINARY", 0)
        )
    except (OSError, ValueError) as reason:
        raise _unreadable(path, reason, error, expected) from reason
    try:
        status = os.fstat(descriptor)
        if not stat.S_ISREG(status.st_mode):
            noun = next(
                (noun for is_noun, noun in _SPECIAL_FILES if is_noun(status.st_mode)),
                "a special file",
            )
            raise error(f"{path}: expected {expected}, found {noun}; give a regular file.")
        if max_bytes is not None and status.st_size > max_bytes:
            raise _too_large(path, max_bytes, status.st_size, error, expected)
        return os.fdopen(descriptor, "rb")
    except BaseException:
        os.close(descriptor)
        raise


@contextmanager
def readable(path: Path, error: type[Exception]) -> Iterator[None]:
    """Context in which the operating system's errors become an `error` that names the file or
    folder to read.
    """
    try:
        yield
    except OSError as reason:
        raise error(
            f"{path}: cannot be read ({describe(reason)}); check the disk and the permissions."
        ) from reason


def check_regular(
    path: Path, error: type[Exception], expected: str, *, max_bytes: int | None = None
) -> None:
    """Check a file that a library opens by its path; see `open_regular` for the arguments and
    errors.
    """
    open_regular(path, error, expected, max_bytes=max_bytes).close()


def read_bytes(path: Path, error: type[Exception], expected: str, *, max_bytes: int) -> bytes:
    """Content of a regular file; see `open_regular` for the arguments and errors."""
    blocks, n_bytes = [], 0
    with open_regular(path, error, expected, max_bytes=max_bytes) as file:
        try:
            # in blocks, which take no more memory than the file has: files in /proc have no size,
            # and a file may grow
            while n_bytes <= max_bytes and (block := _read(file, _BLOCK_BYTES)):
                blocks.append(block)
                n_bytes += len(block)
        except OSError as reason:
            raise _unreadable(path, reason, error, expected) from reason
    if n_bytes > max_bytes:
        raise _too_large(path, max_bytes, n_bytes, error, expected)
    return b"".join(blocks)


def read_text(
    path: Path, error: type[Exception], expected: str, *, max_bytes: int = MAX_TEXT_BYTES
) -> str:
    """Text of a regular file in UTF-8, with or without a byte order mark; lines end with a line
    feed.

    Raises `error` as `open_regular` does, and if the file is not UTF-8 or has null characters.
    """
    first_line(path, error, expected)  # rejects a large binary file before all of it is read
    content = read_bytes(path, error, expected, max_bytes=max_bytes)
    return _decoded(content, path, error, expected).replace("\r\n", "\n").replace("\r", "\n")


def first_line(path: Path, error: type[Exception], expected: str) -> str:
    """The first line that is not blank in the first 64 kB of a text file; "" = none. See
    `read_text`.
    """
    with open_regular(path, error, expected) as file:
        try:
            start = _read(file, _START_BYTES)
        except OSError as reason:
            raise _unreadable(path, reason, error, expected) from reason
    lines = _decoded(
        start, path, error, expected, is_complete=len(start) < _START_BYTES
    ).splitlines()
    return next((line for line in lines if line.strip()), "")


def _read(file: BinaryIO, n_bytes: int) -> bytes:
    """At most `n_bytes` of a file; raises OSError if they cannot be read without waiting, as for
    parts of /proc.
    """
    content: bytes | None = file.read(n_bytes)
    if content is None:
        raise BlockingIOError(errno.EAGAIN, "no data at present")
    return content


def real_path(path: Path) -> Path:
    """Absolute path with symbolic links followed, except links that form a loop (`Path.resolve`
    raises).
    """
    return Path(os.path.realpath(path))


def alternatives(words: Iterable[str]) -> str:
    """The words as "a, b or c"."""
    *first, last = words
    return f"{', '.join(first)} or {last}" if first else last


def counted(n: int, noun: str, plural: str | None = None) -> str:
    """A number with its noun: `1 frame`, `2 frames`; the default plural appends an s."""
    return f"{n} {noun if n == 1 else plural or noun + 's'}"


def quoted(value: object, max_characters: int = _MAX_QUOTED) -> str:
    """A value as Python writes it, shortened to a number of characters, for messages."""
    return shortened(
        repr(
            value[: max_characters + 1] if isinstance(value, str | bytes | list | tuple) else value
        ),
        max_characters,
    )


def shortened(text: str, max_characters: int = _MAX_QUOTED) -> str:
    """A text in printable characters, cut off after a number of characters, for messages."""
    return printable(text if len(text) <= max_characters else f"{text[: max_characters - 3]}...")


def printable(text: str) -> str:
    """A text with "?" for line breaks, control sequences and other characters that a terminal does
    not show.
    """
    return text if text.isprintable() else "".join(c if c.isprintable() else "?" for c in text)


def _decoded(
    content: bytes, path: Path, error: type[Exception], expected: str, *, is_complete: bool = True
) -> str:
    """Text of a file's content in UTF-8; the last character may be incomplete unless
    `is_complete`.
    """
    if archive := next(
        (noun for mark, noun in _ARCHIVES.items() if content.startswith(mark)), None
    ):
        raise error(f"{path}: expected {expected} as text, found {archive}; unpack it first.")
    if content.startswith(_UTF_16_MARKS):
        raise error(
            f"{path}: expected {expected} as text in UTF-8, found UTF-16; save the file as UTF-8."
        )
    try:
        text = codecs.getincrementaldecoder("utf-8-sig")().decode(content, final=is_complete)
        index = content.find(b"\0")
        if index < 0:
            return text
        problem = "a null character"
    except UnicodeDecodeError as reason:
        index, problem = reason.start, "a binary file or another encoding"
    line = content.count(b"\n", 0, index) + 1
    raise error(f"{path}, line {line}: expected {expected} as text in UTF-8, found {problem}.")


def _unreadable(
    path: Path, reason: OSError | ValueError, error: type[Exception], expected: str
) -> Exception:
    if isinstance(reason, FileNotFoundError | NotADirectoryError):
        return error(f"{path}: no such file; expected {expected}.")
    if isinstance(reason, ValueError):  # a path with a null character
        return error(
            f"{quoted(str(path))}: expected the path of {expected}, found an invalid file name."
        )
    if reason.errno == errno.ELOOP:
        return error(
            f"{path}: expected {expected}, found a loop of symbolic links; give the file itself."
        )
    # Windows; sockets and devices that cannot be opened
    if reason.errno in (errno.EISDIR, errno.ENXIO):
        return error(
            f"{path}: expected {expected}, found a folder, device or socket; give a regular file."
        )
    return error(f"{path}: cannot be read ({describe(reason)}); expected {expected}.")


def _too_large(
    path: Path, max_bytes: int, n_bytes: int, error: type[Exception], expected: str
) -> Exception:
    limit, size = (
        next((f"{n / factor:.4g} {unit}" for unit, factor in _UNITS if n >= factor), f"{n} bytes")
        for n in (max_bytes, n_bytes)
    )
    return error(f"{path}: expected {expected} of at most {limit}, found {size}.")


_UNITS = (("GB", 1e9), ("MB", 1e6), ("kB", 1e3))
