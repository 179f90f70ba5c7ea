"""Location: a file or folder on this machine, in an object store (`s3://`, `gs://`) or on a web server (`https://`).

Addresses of object stores are written as their own tools write them: `s3://bucket/any key`, without percent-encoding.
Options follow a question mark: `s3://bucket/key?endpoint_override=host:9000&scheme=http`; $AWS_ENDPOINT_URL is used
as well. Credentials come from the environment and the configuration files of the store, not from the address.
"""

from __future__ import annotations

import os
import posixpath
import re
from collections.abc import Iterator
from functools import lru_cache
from pathlib import Path
from typing import TYPE_CHECKING, Protocol
from urllib.parse import parse_qsl, quote, unquote

from track_range.fleet.storage.entry import Entry, FileStat, folder_state
from track_range.fleet.storage.errors import StorageError
from track_range.fleet.storage.local import LocalStorage
from track_range.fleet.storage.object_store import ObjectStore
from track_range.foundation.files.input_files import printable, quoted, shortened

if TYPE_CHECKING:
    from pyarrow.fs import FileSystem

MAX_READ_BYTES = 2_000_000_000
"""Size limit, bytes, of a file that is read into memory."""

_SCHEME = re.compile(r"([A-Za-z][A-Za-z0-9+.-]*)://")
_SCHEMES = {"s3": "s3", "gs": "gs", "gcs": "gs", "http": "http", "https": "https", "file": "file"}
"""Storage by scheme of an address."""

_OPTION_NAMES = frozenset(("endpoint_override", "scheme", "region", "anonymous"))
"""Options of an object store in an address."""

_USER = re.compile(r"(?<=://)[^/@]*@")
_QUERY = re.compile(r"\?.*$", re.DOTALL)


class Storage(Protocol):
    """A kind of storage.

    Keys are what follows the scheme of an address, or a local path; `address` is for messages. All methods raise
    StorageError.
    """

    is_read_only: bool

    def stat(self, key: str, address: str) -> FileStat | None:
        """Size and time of change; None = no such file or folder."""

    def entries(self, key: str, address: str, *, recursive: bool) -> Iterator[Entry]:
        """Files and folders in a folder, in no particular order."""

    def read(self, key: str, address: str, max_bytes: int) -> bytes:
        """Content of a file of at most `max_bytes`."""

    def write(self, key: str, address: str, content: bytes) -> None:
        """Write a file atomically."""

    def upload(self, key: str, address: str, file: Path) -> None:
        """Copy a local file here atomically."""

    def download(self, key: str, address: str, file: Path, max_bytes: int) -> int:
        """Copy a file of at most `max_bytes` to a local path; returns its size, bytes."""

    def remove(self, key: str, address: str) -> None:
        """Remove a file; a missing one is no error."""


class Location:
    """A file or folder in any storage; it need not exist. Equal addresses are equal locations.

    Attributes:
        address: absolute local path, or address with scheme and options; may contain credentials of a web server.
    """

    __slots__ = ("_key", "_options", "_scheme", "address")

    def __init__(self, scheme: str, key: str, options: tuple[tuple[str, str], ...] = ()) -> None:
        self._scheme, self._key, self._options = scheme, key, options
        self.address = _address(scheme, key, options)

    @classmethod
    def of(cls, name: str | Path | Location) -> Location:
        """The location with a path or address; relative paths start in the current folder.

        Raises:
            StorageError: an unknown scheme, no bucket, or credentials in the address.
        """
        if isinstance(name, Location):
            return name
        text = os.fspath(name)
        match = _SCHEME.match(text)
        if match is None:
            if "\0" in text or not text:
                raise StorageError(f"{quoted(text)}: expected a path or an address such as s3://bucket/folder.")
            return cls("", os.path.abspath(os.path.expanduser(text)))
        scheme = _SCHEMES.get(match[1].lower(), "")
        rest = text[match.end() :]
        if scheme == "file":
            return cls("", os.path.abspath(rest))
        if scheme in ("http", "https"):
            return cls(scheme, rest)
        if not scheme:
            raise StorageError(
                f"{shortened(shown(text), 100)}: expected a path, s3://, gs://, http:// or https://, found "
                f"{quoted(match[1])}."
            )
        return cls._in_bucket(scheme, rest, text)

    @classmethod
    def _in_bucket(cls, scheme: str, rest: str, text: str) -> Location:
        key, _, query = rest.rpartition("?")
        options = dict(parse_qsl(query, keep_blank_values=True)) if key else {}
        if not options or not options.keys() <= _OPTION_NAMES:
            key, options = rest, {}
        bucket, _, path = key.partition("/")
        if "@" in bucket:
            raise StorageError(
                f"{shortened(shown(text), 100)}: expected an address without credentials; set them in the environment "
                "(AWS_ACCESS_KEY_ID and AWS_SECRET_ACCESS_KEY) instead.",
                "permission",
            )
        if not bucket or bucket in (".", ".."):
            raise StorageError(
                f"{shortened(text, 100)}: expected the name of a bucket, as in {scheme}://bucket/folder."
            )
        return cls(scheme, f"{bucket}/{path}".rstrip("/"), tuple(sorted(options.items())))

    def __str__(self) -> str:
        return printable(shown(self.address))

    def __repr__(self) -> str:
        return f"Location({str(self)!r})"

    def __eq__(self, other: object) -> bool:
        return isinstance(other, Location) and self.address == other.address

    def __hash__(self) -> int:
        return hash(self.address)

    def __reduce__(self) -> tuple[type[Location], tuple[str, str, tuple[tuple[str, str], ...]]]:
        return type(self), (self._scheme, self._key, self._options)

    @property
    def is_local(self) -> bool:
        """Whether it is on this machine."""
        return not self._scheme

    @property
    def is_read_only(self) -> bool:
        """Whether it is on a web server, to which nothing can be written."""
        return self._storage.is_read_only

    @property
    def path(self) -> Path:
        """The local path.

        Raises:
            StorageError: it is not on this machine.
        """
        if self._scheme:
            raise StorageError(f"{self}: expected a path on this machine.")
        return Path(self._key)

    @property
    def name(self) -> str:
        """Last part of the path, without percent-encoding."""
        if self.is_web:
            return unquote(_QUERY.sub("", self._key).rstrip("/").rpartition("/")[2])
        return self._key.rpartition("/")[2]

    @property
    def parent(self) -> Location | None:
        """The folder that contains it; None for a bucket, a server, and the root folder."""
        key = _QUERY.sub("", self._key) if self.is_web else self._key
        folder = key.rstrip("/").rpartition("/")[0]
        if not self._scheme:
            folder = os.path.dirname(self._key)
            return None if folder == self._key else Location("", folder)
        return Location(self._scheme, folder, self._options) if folder else None

    def child(self, *names: str) -> Location:
        """A file or folder below this folder; `names` are relative paths with "/" between their parts."""
        if self.is_web:
            base = _QUERY.sub("", self._key).rstrip("/")
            return Location(self._scheme, "/".join((base, *(quote(name, errors="surrogateescape") for name in names))))
        return Location(self._scheme, "/".join((self._key.rstrip("/"), *names)), self._options)

    def descendant(self, path: str) -> Location:
        """The file with a path relative to this folder, which may contain `..`.

        Raises:
            StorageError: the path leaves the bucket or server.
        """
        if not self._scheme:
            return Location("", os.path.normpath(f"{self._key}/{path}"))
        child = self.child(path)
        root, _, _ = child._key.partition("/")
        key = posixpath.normpath(child._key)
        if key.partition("/")[0] != root:
            raise StorageError(f"{self}: expected a path in {quoted(root)}, found {quoted(path)}.")
        return Location(self._scheme, key, self._options)

    def stat(self) -> FileStat | None:
        """Size and time of change; None = no such file, folder or bucket.

        Raises:
            StorageError: the storage cannot be reached, or refuses.
        """
        return self._storage.stat(self._key, str(self))

    def state(self) -> FileStat | None:
        """As `stat`; of a folder, the total size and the latest change of all its files, hidden ones excluded."""
        status = self.stat()
        return status if status is None or not status.is_folder else folder_state(self.list(recursive=True))

    def exists(self) -> bool:
        """Whether there is such a file or folder; raises as `stat`."""
        return self.stat() is not None

    def is_folder(self) -> bool:
        """Whether it is a folder, in an object store the prefix of an object; raises as `stat`."""
        status = self.stat()
        return status is not None and status.is_folder

    def list(self, *, recursive: bool = False) -> Iterator[Entry]:
        """Files and folders in this folder, with names relative to it, in no particular order.

        Raises:
            StorageError: there is no such folder, or it cannot be read.
        """
        return self._storage.entries(self._key, str(self), recursive=recursive)

    def read_bytes(self, max_bytes: int = MAX_READ_BYTES) -> bytes:
        """Content of a file.

        Raises:
            StorageError: it does not exist, is larger, or cannot be read.
        """
        return self._storage.read(self._key, str(self), max_bytes)

    def write_bytes(self, content: bytes) -> None:
        """Write a file atomically; readers see the old or the new content. Folders are created, buckets are not.

        Raises:
            StorageError: it cannot be written.
        """
        self._storage.write(self._key, str(self), content)

    def upload(self, file: Path) -> None:
        """Copy a local file here atomically; raises as `write_bytes`."""
        self._storage.upload(self._key, str(self), file)

    def download(self, file: Path, max_bytes: int = 1 << 62) -> int:
        """Copy this file to a local path, which is incomplete if an error is raised; returns its size in bytes.

        Raises:
            StorageError: it does not exist, is larger than `max_bytes`, or cannot be read; or the local file cannot be
                written.
        """
        return self._storage.download(self._key, str(self), file, max_bytes)

    def remove(self) -> None:
        """Remove a file; a missing one is no error.

        Raises:
            StorageError: it cannot be removed.
        """
        self._storage.remove(self._key, str(self))

    def arrow(self) -> tuple[FileSystem, str]:
        """File system of pyarrow and the path in it, for data sets.

        Raises:
            StorageError: the storage cannot be reached, or is a web server.
        """
        storage = self._storage
        if isinstance(storage, ObjectStore):
            return storage.file_system(self._key, str(self)), self._key
        if self._scheme:
            raise StorageError(f"{self}: expected a folder on this machine or in an object store, found a web server.")
        from pyarrow.fs import LocalFileSystem

        return LocalFileSystem(), self._key

    @property
    def is_web(self) -> bool:
        """Whether it is on a web server."""
        return self._scheme in ("http", "https")

    def address_and_options(self) -> tuple[str, str]:
        """The address without options, and the options with their question mark; "" = none."""
        address, options = self.address, _options_text(self._options)
        return (_QUERY.sub("", address) if self.is_web else address.removesuffix(options)), options

    @property
    def _storage(self) -> Storage:
        return _storage_of(self._scheme, self._options)


def shown(address: str) -> str:
    """An address without the user name and password, and without the query of a web address, for messages."""
    if _SCHEME.match(address) is None:
        return address
    address = _USER.sub("", address)
    return _QUERY.sub("?...", address) if address.startswith(("http:", "https:")) else address


def has_scheme(text: str) -> bool:
    """Whether a text is an address such as `s3://...` instead of a path."""
    return _SCHEME.match(text) is not None


def _address(scheme: str, key: str, options: tuple[tuple[str, str], ...]) -> str:
    return f"{scheme}://{key}{_options_text(options)}" if scheme else key


def _options_text(options: tuple[tuple[str, str], ...]) -> str:
    query = "&".join(f"{name}={value}" for name, value in options)
    return f"?{query}" if query else ""


@lru_cache(maxsize=64)
def _storage_of(scheme: str, options: tuple[tuple[str, str], ...]) -> Storage:
    if not scheme:
        return LocalStorage()
    if scheme in ("http", "https"):
        from track_range.fleet.storage.web import WebStorage

        return WebStorage(scheme)
    return ObjectStore(scheme, dict(options))
