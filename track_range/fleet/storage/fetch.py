"""Fetching of a clip's remote files into a local cache of limited size, for the time in which the clip is processed."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path

from track_range.fleet.inputs.clip import Clip


@dataclass(frozen=True, slots=True)
class FetchedFile:
    """A file of a clip as it was read.

    Attributes:
        address: where it was stored.
        path: local path.
        size: bytes.
        mtime_ns: time of the last change in its storage, ns since 1970; 0 = not stated.
        sha256: hash of the content in hexadecimal digits; for a folder, of the names and contents of its files.
    """

    address: str
    path: Path
    size: int
    mtime_ns: int
    sha256: str


@dataclass(frozen=True, slots=True)
class FetchedClip:
    """A clip with all of its files on this machine.

    Attributes:
        clip: the clip, with local paths.
        files: its files by role, as in `Clip.files`.
    """

    clip: Clip
    files: Mapping[str, FetchedFile]


@contextmanager
def fetched(clip: Clip, cache_folder: Path, limit_bytes: int) -> Iterator[FetchedClip]:
    """A clip with its remote files downloaded; they are removed at the end. Local files are used in place.

    Args:
        clip: the clip.
        cache_folder: folder of the downloads, which is created; several processes may share it.
        limit_bytes: largest size of the clip's downloads.

    Raises:
        StorageError: a file is missing, cannot be read, or the downloads are larger than the limit or the free space.
    """
    raise NotImplementedError
    yield
