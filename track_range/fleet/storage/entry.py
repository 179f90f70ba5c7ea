"""FileStat and Entry: size, time of change and name of a stored file."""

from __future__ import annotations

from dataclasses import dataclass


@dataclass(frozen=True, slots=True)
class FileStat:
    """Size and time of the last change of a file, by which a changed file is recognised.

    Attributes:
        size: bytes; -1 = not stated by a web server.
        mtime_ns: time of the last change in ns since 1970; 0 = not stated.
        is_folder: whether it is a folder; its size and time are 0.
    """

    size: int
    mtime_ns: int
    is_folder: bool = False


@dataclass(frozen=True, slots=True)
class Entry:
    """A file or folder in a listing.

    Attributes:
        name: path relative to the listed folder, with "/" between its parts.
        stat: its size and time of change.
    """

    name: str
    stat: FileStat
