"""WebStorage: files on a web server, read only, through fsspec (extra `fleet`); keys are `host/path?query`."""

from __future__ import annotations

import posixpath
import re
from collections.abc import Iterator
from contextlib import contextmanager
from email.utils import parsedate_to_datetime
from functools import cached_property
from pathlib import Path
from typing import TYPE_CHECKING, Any
from urllib.parse import unquote

from track_range.fleet.storage.entry import Entry, FileStat
from track_range.fleet.storage.errors import StorageError, StorageFault, storage_error

if TYPE_CHECKING:
    from fsspec.implementations.http import HTTPFileSystem

_CONNECT_TIMEOUT_S, _READ_TIMEOUT_S = 10.0, 30.0
"""Time limits of the connection, and between two parts of an answer."""

_BLOCK_BYTES = 4 << 20
"""Size of the blocks in which files are copied, bytes."""

_MAX_DEPTH = 8
"""Largest depth of the folders that are listed."""

_FOLDER = FileStat(0, 0, is_folder=True)
_QUERY = re.compile(r"[?#].*$", re.DOTALL)

_STATUS_FAULTS: dict[int, StorageFault] = {401: "permission", 403: "permission", 404: "missing", 410: "missing"}
"""Kinds of faults by HTTP status; the others below 500 are "other"."""


class WebStorage:
    """See `Storage` for the methods.

    Args:
        scheme: "http" or "https".
    """

    is_read_only = True

    def __init__(self, scheme: str) -> None:
        self._scheme = scheme

    def stat(self, key: str, address: str) -> FileStat | None:
        """Size and time, as far as the server states them; None = no such file."""
        files = self._files
        try:
            with _web_errors(address):
                info = files.info(f"{self._scheme}://{key}")
        except StorageError as error:
            if error.kind == "missing":
                return None
            raise
        size = info.get("size")
        return FileStat(-1 if size is None else int(size), _time_ns(info.get("Last-Modified", "")))

    def entries(self, key: str, address: str, *, recursive: bool) -> Iterator[Entry]:
        """Files to which the page of a folder links; their sizes and times are not known."""
        folder = f"{self._scheme}://{_QUERY.sub('', key).rstrip('/')}/"
        yield from self._linked(folder, folder, address, depth=_MAX_DEPTH if recursive else 1)

    def read(self, key: str, address: str, max_bytes: int) -> bytes:
        """Content of a file of at most `max_bytes`."""
        return b"".join(self._blocks(key, address, max_bytes))

    def write(self, key: str, address: str, content: bytes) -> None:
        """Raise an error: nothing can be written to a web server."""
        raise _read_only(address)

    def upload(self, key: str, address: str, file: Path) -> None:
        """Raise an error: nothing can be written to a web server."""
        raise _read_only(address)

    def download(self, key: str, address: str, file: Path, max_bytes: int) -> int:
        """Copy a file to a local path; returns its size."""
        size = 0
        blocks = self._blocks(key, address, max_bytes)
        try:
            with open(file, "wb") as target:
                for block in blocks:
                    target.write(block)
                    size += len(block)
        except OSError as error:
            raise storage_error(file, "written", error) from error
        return size

    def remove(self, key: str, address: str) -> None:
        """Raise an error: nothing can be removed from a web server."""
        raise _read_only(address)

    @cached_property
    def _files(self) -> HTTPFileSystem:
        try:
            import aiohttp
            from fsspec.implementations.http import HTTPFileSystem
        except ImportError as error:
            raise StorageError(
                'http:// and https:// need the packages fsspec and aiohttp; install them with: pip install "track-range'
                '[fleet]".'
            ) from error
        timeout = aiohttp.ClientTimeout(total=None, sock_connect=_CONNECT_TIMEOUT_S, sock_read=_READ_TIMEOUT_S)
        return HTTPFileSystem(client_kwargs={"timeout": timeout}, use_listings_cache=False)

    def _blocks(self, key: str, address: str, max_bytes: int) -> Iterator[bytes]:
        size, files = 0, self._files
        with _web_errors(address), files.open(f"{self._scheme}://{key}", "rb", block_size=0) as stream:
            while block := stream.read(_BLOCK_BYTES):
                size += len(block)
                if size > max_bytes:
                    raise StorageError(f"{address}: expected a file of at most {max_bytes} bytes, found a larger one.")
                yield block

    def _linked(self, folder: str, base: str, address: str, *, depth: int) -> Iterator[Entry]:
        files = self._files
        with _web_errors(address):
            links = files.ls(folder, detail=False)
        for link in sorted({_QUERY.sub("", link) for link in links}):
            name = unquote(link[len(base) :])
            if not link.startswith(folder) or link == folder or ".." in name.split("/"):
                continue
            yield Entry(posixpath.normpath(name), _FOLDER if link.endswith("/") else FileStat(-1, 0))
            if link.endswith("/") and depth > 1:
                yield from self._linked(link, base, address, depth=depth - 1)


@contextmanager
def _web_errors(address: str) -> Iterator[None]:
    """Context in which errors of fsspec and aiohttp become a StorageError."""
    from aiohttp import ClientError, InvalidURL

    try:
        yield
    except (ClientError, OSError, ValueError) as error:
        # fsspec reports each failure of `info` as a missing file, with the reason as its cause
        cause: Any = error.__cause__ if isinstance(error.__cause__, ClientError | OSError) else error
        status = getattr(cause, "status", None)
        if isinstance(cause, FileNotFoundError):
            raise storage_error(address, "read", cause, "missing") from error
        if status is not None:
            reason = ValueError(f"HTTP status {status} {getattr(cause, 'message', '')}".strip())
            kind = _STATUS_FAULTS.get(status, "network" if status >= 500 or status in (408, 429) else "other")
            raise storage_error(address, "read", reason, kind) from error
        is_invalid = isinstance(cause, InvalidURL) or not isinstance(cause, ClientError | OSError)
        raise storage_error(address, "read", cause, "other" if is_invalid else "network") from error


def _read_only(address: str) -> StorageError:
    return StorageError(f"{address}: cannot be written (a web server); give a folder or a bucket.", "permission")


def _time_ns(text: str) -> int:
    """Date in a header as ns since 1970; 0 = none."""
    try:
        return int(parsedate_to_datetime(text).timestamp()) * 10**9
    except (ValueError, TypeError, OverflowError):
        return 0
