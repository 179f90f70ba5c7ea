"""Atomic writing of files: write to a temporary file in the same folder, fsync, rename.

A reader sees the complete old or the complete new content, however the program ends. File system
errors are raised as OSError; callers convert them to their own error class with `writable`.
"""

import os
import tempfile
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from pathlib import Path


@contextmanager
def atomic_path(path: Path, *, is_flushed: bool = True) -> Iterator[Path]:
    """A temporary path next to `path`, for libraries that write files themselves; renamed to `path`
    at the end.

    The temporary file is hidden, has the same suffix, and is removed if the block raises. Devices,
    pipes and symbolic links are not replaced but written in place: the result is then `path`
    itself. `is_flushed`: the content is on the disk before the file is renamed, which matters after
    a power failure. Raises OSError if `path` is a folder, or the file cannot be written or renamed.
    """
    if path.is_symlink() or (path.exists() and not path.is_file() and not path.is_dir()):
        yield path
        return
    partial = path.with_name(f".{os.getpid()}.{path.name}")
    try:
        yield partial
        _replace(partial, path, is_flushed=is_flushed)
    finally:
        with suppress(OSError):
            partial.unlink(missing_ok=True)


@contextmanager
def atomic_folder(path: Path) -> Iterator[Path]:
    """A temporary folder next to `path`, for intermediate files; the file named `path.name` in it
    replaces `path`.

    Raises OSError if the folder cannot be created, or the file is missing or cannot be renamed.
    """
    with tempfile.TemporaryDirectory(prefix=f".{path.name}.", dir=path.parent) as folder:
        yield Path(folder)
        _replace(Path(folder) / path.name, path)


def write_bytes(path: Path, content: bytes, *, is_flushed: bool = True) -> None:
    """Write a binary file atomically; see `atomic_path` for `is_flushed` and the errors."""
    with atomic_path(path, is_flushed=is_flushed) as partial:
        # without O_NONBLOCK, the opening of a named pipe waits for a reader
        flags = (
            os.O_WRONLY
            | os.O_CREAT
            | os.O_TRUNC
            | getattr(os, "O_NONBLOCK", 0)
            | getattr(os, "O_BINARY", 0)
        )
        descriptor = os.open(partial, flags, 0o666)
        with os.fdopen(descriptor, "wb") as file:
            if hasattr(os, "O_NONBLOCK"):
                os.set_blocking(descriptor, True)
            file.write(content)


def write_text(path: Path, text: str, *, is_flushed: bool = True) -> None:
    """Write a text file atomically, in UTF-8 with the line endings of `text`; see `atomic_path`."""
    write_bytes(path, text.encode("utf-8"), is_flushed=is_flushed)


@contextmanager
def writable(path: Path, error: type[Exception]) -> Iterator[None]:
    """Context in which the operating system's errors become an `error` that names the file or
    folder to write.
    """
    try:
        yield
    except OSError as reason:
        raise error(
            f"{path}: cannot be written ({describe(reason)}); choose another place."
        ) from reason


def describe(error: OSError) -> str:
    """The reason for a file system error, without its path and number."""
    return error.strerror or str(error)


def _replace(partial: Path, path: Path, *, is_flushed: bool = True) -> None:
    if is_flushed:
        with partial.open("r+b") as file:
            os.fsync(file.fileno())
    partial.replace(path)
