"""FolderListings: sizes and times of many files with one request per folder instead of one or more per file."""

from __future__ import annotations

import threading
from collections.abc import Mapping
from dataclasses import dataclass, field

from track_range.fleet.storage.entry import FileStat, folder_state
from track_range.fleet.storage.errors import StorageError
from track_range.fleet.storage.location import Location


@dataclass(slots=True)
class _Listing:
    """Content of a folder, read once.

    Attributes:
        lock: held while it is read.
        stats: sizes and times by name; None = not read yet.
    """

    lock: threading.Lock = field(default_factory=threading.Lock)
    stats: Mapping[str, FileStat] | None = None


class FolderListings:
    """Sizes and times as they are when a folder is first needed; several threads may use it."""

    def __init__(self) -> None:
        self._lock = threading.Lock()
        self._listings: dict[str, _Listing] = {}

    def stat(self, location: Location) -> FileStat | None:
        """As `Location.stat`, from a listing of the folder if it is in an object store."""
        parent = location.parent
        if location.is_local or location.is_web or parent is None:
            return location.stat()
        with self._lock:
            listing = self._listings.setdefault(parent.address, _Listing())
        with listing.lock:
            if listing.stats is None:
                listing.stats = _stats_in(parent)
            return listing.stats.get(location.name)

    def state(self, location: Location) -> FileStat | None:
        """As `Location.state`, from a listing of the folder if it is in an object store."""
        status = self.stat(location)
        return status if status is None or not status.is_folder else folder_state(location.list(recursive=True))


def _stats_in(folder: Location) -> dict[str, FileStat]:
    try:
        return {entry.name: entry.stat for entry in folder.list()}
    except StorageError as error:
        if error.kind == "missing":
            return {}
        raise
