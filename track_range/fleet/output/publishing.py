"""Publishing of files in the output of a fleet, each as a whole.

In a local folder a file is written to OUT/unfinished first, and then moved to its place: a worker that is killed leaves
nothing beside the results, where readers of the data set would find it. In an object store, an upload is atomic.
"""

from __future__ import annotations

import os
import platform
import shutil
from collections.abc import Callable
from contextlib import suppress
from pathlib import Path

from track_range.fleet.output.repetition import repeated
from track_range.fleet.storage.errors import storage_errors
from track_range.fleet.storage.location import Location

UNFINISHED = "unfinished"


def publish_file(out: Location, location: Location, file: Path) -> None:
    """Copy a local file to its place in the output.

    Args:
        out: folder of the results.
        location: place in it.
        file: the file.

    Raises:
        StorageError: it cannot be written.
    """
    if out.is_local:
        _move_into_place(out, location, lambda partial: shutil.copyfile(file, partial))
    else:
        repeated(lambda: location.upload(file))


def publish_bytes(out: Location, location: Location, content: bytes) -> None:
    """Write a file to its place in the output; see `publish_file`."""
    if out.is_local:
        _move_into_place(out, location, lambda partial: partial.write_bytes(content))
    else:
        repeated(lambda: location.write_bytes(content))


def remove_unfinished(out: Location) -> None:
    """Remove what workers that were killed have left, as far as possible."""
    if out.is_local:
        shutil.rmtree(out.path / UNFINISHED, ignore_errors=True)


def _move_into_place(out: Location, location: Location, write: Callable[[Path], object]) -> None:
    partial = out.path / UNFINISHED / f"{platform.node()}-{os.getpid()}"
    with storage_errors(location, "written"):
        try:
            partial.parent.mkdir(parents=True, exist_ok=True)
            location.path.parent.mkdir(parents=True, exist_ok=True)
            write(partial)
            with partial.open("r+b") as file:
                os.fsync(file.fileno())
            partial.replace(location.path)
        except BaseException:
            with suppress(OSError):
                partial.unlink(missing_ok=True)
            raise
