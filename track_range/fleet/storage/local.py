"""LocalStorage: files and folders of this machine; keys are absolute paths."""

from __future__ import annotations

import os
import shutil
import stat
from collections.abc import Iterator
from pathlib import Path

from track_range.fleet.storage.entry import Entry, FileStat
from track_range.fleet.storage.errors import StorageError, storage_errors
from track_range.foundation.files.atomic_files import atomic_path
from track_range.foundation.files.atomic_files import write_bytes as write_file
from track_range.foundation.files.input_files import read_bytes

_FOLDER = FileStat(0, 0, is_folder=True)


class LocalStorage:
    """See `Storage` for the methods."""

    is_read_only = False

    def stat(self, key: str, address: str) -> FileStat | None:
        """Size and time; None = no such file or folder."""
        try:
            with storage_errors(address, "read"):
                return _stat_of(os.stat(key))
        except StorageError as error:
            if error.kind == "missing":
                return None
            raise

    def entries(self, key: str, address: str, *, recursive: bool) -> Iterator[Entry]:
        """Files and folders in a folder, in no particular order; links are followed, except back to a folder above."""
        with storage_errors(address, "read"):
            status = os.stat(key)
        yield from _scanned(key, "", ((status.st_dev, status.st_ino),), recursive=recursive)

    def read(self, key: str, address: str, max_bytes: int) -> bytes:
        """Content of a file of at most `max_bytes`."""
        with storage_errors(address, "read"):
            os.stat(key)  # raises for a missing file, with its kind
        return read_bytes(Path(key), StorageError, "a file", max_bytes=max_bytes)

    def write(self, key: str, address: str, content: bytes) -> None:
        """Write a file atomically; its folder is created."""
        with storage_errors(address, "written"):
            os.makedirs(os.path.dirname(key), exist_ok=True)
            write_file(Path(key), content)

    def upload(self, key: str, address: str, file: Path) -> None:
        """Copy a local file here atomically; folders are created."""
        with storage_errors(address, "written"):
            os.makedirs(os.path.dirname(key), exist_ok=True)
            with atomic_path(Path(key)) as partial:
                shutil.copyfile(file, partial)

    def download(self, key: str, address: str, file: Path, max_bytes: int) -> int:
        """Copy a file to a local path; returns its size."""
        with storage_errors(address, "read"):
            if (size := os.path.getsize(key)) > max_bytes:
                raise StorageError(f"{address}: expected at most {max_bytes} bytes, found {size}.")
            shutil.copyfile(key, file)
            return size

    def remove(self, key: str, address: str) -> None:
        """Remove a file; a missing one is no error."""
        with storage_errors(address, "removed"):
            Path(key).unlink(missing_ok=True)


def _scanned(folder: str, prefix: str, above: tuple[tuple[int, int], ...], *, recursive: bool) -> Iterator[Entry]:
    """Entries of a folder; `above` are device and inode of it and of the folders that contain it."""
    with storage_errors(folder, "read"), os.scandir(folder) as items:
        for item in items:
            name = prefix + item.name
            try:
                status = item.stat()
            except FileNotFoundError:  # a broken link, or removed meanwhile
                continue
            if not stat.S_ISDIR(status.st_mode):
                yield Entry(name, _stat_of(status))
                continue
            yield Entry(name, _FOLDER)
            identity = (status.st_dev, status.st_ino)
            if recursive and identity not in above:
                yield from _scanned(item.path, f"{name}/", (*above, identity), recursive=True)


def _stat_of(status: os.stat_result) -> FileStat:
    return _FOLDER if stat.S_ISDIR(status.st_mode) else FileStat(status.st_size, status.st_mtime_ns)
