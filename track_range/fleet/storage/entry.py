"""FileStat and Entry: size, time of change and name of a stored file."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass


@dataclass(frozen=True, slots=True)
class FileStat:
    """Size and time of the last change of a file, by which a changed file is recognised.

    Attributes:
        size: bytes; -1 = not stated by a web server.
        mtime_ns: time of the last change in ns since 1970; 0 = not stated.
        is_folder: whether it is a folder; its size and time are 0, or those of its files.
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


def folder_state(entries: Iterable[Entry]) -> FileStat:
    """Total size and latest time of change of the files in a listing, hidden ones excluded."""
    size, mtime_ns = 0, 0
    for entry in entries:
        if not (entry.stat.is_folder or is_hidden(entry.name)):
            size, mtime_ns = size + max(entry.stat.size, 0), max(mtime_ns, entry.stat.mtime_ns)
    return FileStat(size, mtime_ns, is_folder=True)


def with_folders(entries: Iterable[Entry]) -> list[Entry]:
    """A recursive listing of files with the folders that contain them."""
    listed = list(entries)
    folders = {entry.name for entry in listed if entry.stat.is_folder}
    added: list[Entry] = []
    for entry in listed:
        name = entry.name.rpartition("/")[0]
        while name and name not in folders:
            folders.add(name)
            added.append(Entry(name, FileStat(0, 0, is_folder=True)))
            name = name.rpartition("/")[0]
    return [*listed, *added]


def is_hidden(name: str) -> bool:
    """Whether a relative path is that of a hidden file, or is in a hidden folder."""
    return name.startswith(".") or "/." in name
