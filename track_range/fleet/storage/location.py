"""Location: a file or folder on this machine, in an object store (`s3://`, `gs://`) or on a web
server (`https://`).

Addresses of object stores are written as their own tools write them: `s3://bucket/any key`, without
percent-encoding. Options follow a question mark:
`s3://bucket/key?endpoint_override=host:9000&scheme=http`; $AWS_ENDPOINT_URL is used as well.
Credentials come from the environment and the configuration files of the store, not from the
address.
"""

from __future__ import annotations

import io
import os
import posixpath
import re
import shutil
import stat
import threading
from collections.abc import Iterable, Iterator
from contextlib import suppress
from dataclasses import dataclass
from email.utils import parsedate_to_datetime
from pathlib import Path
from typing import IO, TYPE_CHECKING
from urllib.parse import parse_qsl, quote, unquote

from track_range.fleet.storage.errors import StorageError, storage_errors
from track_range.fleet.storage.file_systems import object_store, web_files
from track_range.foundation.files.atomic_files import atomic_path, write_bytes
from track_range.foundation.files.input_files import open_regular, printable, quoted, shortened

if TYPE_CHECKING:
    from pyarrow.fs import FileInfo, FileSystem

_MAX_READ_BYTES = 2_000_000_000  # size limit of a file that is read into memory
_BLOCK_BYTES = 4 << 20  # size of the blocks in which files are copied
_MAX_WEB_DEPTH = 8  # largest depth of the folders of a web server that are listed

_SCHEME = re.compile(r"([A-Za-z][A-Za-z0-9+.-]*)://")
_SCHEMES = {"s3": "s3", "gs": "gs", "gcs": "gs", "http": "http", "https": "https", "file": "file"}

_OPTION_NAMES = {"endpoint_override", "scheme", "region", "anonymous"}
_USER = re.compile(r"(?<=://)[^/@]*@")
_QUERY, _LINK_QUERY = re.compile(r"\?.*$", re.DOTALL), re.compile(r"[?#].*$", re.DOTALL)


@dataclass(frozen=True, slots=True)
class FileStat:
    """Size and time of the last change of a file; for a folder, 0 or the values of its files."""

    size: int  # bytes; -1 = not stated by a web server
    mtime_ns: int  # since 1970; 0 = not stated
    is_folder: bool = False


_FOLDER = FileStat(0, 0, is_folder=True)


@dataclass(frozen=True, slots=True)
class Entry:
    """A file or folder in a listing; `name` is its path relative to the listed folder, with "/"
    between its parts.
    """

    name: str
    stat: FileStat


def is_hidden(name: str) -> bool:
    """Whether a relative path leads to a hidden file, or into a hidden folder."""
    return name.startswith(".") or "/." in name


def folder_state(entries: Iterable[Entry]) -> FileStat:
    """Total size and latest time of change of the files in a listing, without hidden files."""
    files = [entry.stat for entry in entries if not (entry.stat.is_folder or is_hidden(entry.name))]
    size = sum(max(file.size, 0) for file in files)
    return FileStat(size, max((file.mtime_ns for file in files), default=0), is_folder=True)


class Location:
    """A file or folder in any storage; it need not exist. Equal addresses are equal locations.

    `address`: absolute local path, or address with scheme and options; may contain credentials of a
    web server.
    """

    __slots__ = ("_key", "_options", "_scheme", "address")

    def __init__(self, scheme: str, key: str, options: tuple[tuple[str, str], ...] = ()) -> None:
        self._scheme, self._key, self._options = scheme, key, options
        self.address = f"{scheme}://{key}{_options_text(options)}" if scheme else key

    @classmethod
    def of(cls, name: str | Path | Location) -> Location:
        """The location with a path or address; relative paths start in the current folder.

        Raises StorageError for an unknown scheme, no bucket, or credentials in the address.
        """
        if isinstance(name, Location):
            return name
        text = os.fspath(name)
        match = _SCHEME.match(text)
        if match is None:
            if "\0" in text or not text:
                raise StorageError(
                    f"{quoted(text)}: expected a path or an address such as s3://bucket/folder."
                )
            return cls("", os.path.abspath(os.path.expanduser(text)))
        scheme, rest = _SCHEMES.get(match[1].lower(), ""), text[match.end() :]
        if scheme == "file":
            return cls("", os.path.abspath(rest))
        if scheme in ("http", "https"):
            return cls(scheme, rest)
        start = shortened(shown(text), 100)
        if not scheme:
            raise StorageError(
                f"{start}: expected a path, s3://, gs://, http:// or https://, found "
                f"{quoted(match[1])}."
            )
        key, _, query = rest.rpartition("?")
        options = dict(parse_qsl(query, keep_blank_values=True)) if key else {}
        if not options or not options.keys() <= _OPTION_NAMES:
            key, options = rest, {}
        bucket, _, path = key.partition("/")
        if "@" in bucket:
            raise StorageError(
                f"{start}: expected an address without credentials; set them in the environment "
                "(AWS_ACCESS_KEY_ID and AWS_SECRET_ACCESS_KEY) instead.",
                "permission",
            )
        if bucket in ("", ".", ".."):
            raise StorageError(
                f"{start}: expected the name of a bucket, as in {scheme}://bucket/folder."
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
        """Whether the location is on this machine."""
        return not self._scheme

    @property
    def is_web(self) -> bool:
        """Whether the location is on a web server, to which nothing can be written."""
        return self._scheme in ("http", "https")

    @property
    def path(self) -> Path:
        """The local path; raises StorageError for a remote location."""
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
        """The folder that contains this location; None for a bucket, a server, and the root
        folder.
        """
        if self.is_local:
            folder = os.path.dirname(self._key)
            return None if folder == self._key else Location("", folder)
        key = _QUERY.sub("", self._key) if self.is_web else self._key
        folder = key.rstrip("/").rpartition("/")[0]
        return Location(self._scheme, folder, self._options) if folder else None

    def child(self, *names: str) -> Location:
        """A file or folder below this folder; `names` are relative paths with "/" between their
        parts.
        """
        if self.is_web:
            base = _QUERY.sub("", self._key).rstrip("/")
            return Location(
                self._scheme,
                "/".join((base, *(quote(name, errors="surrogateescape") for name in names))),
            )
        return Location(self._scheme, "/".join((self._key.rstrip("/"), *names)), self._options)

    def descendant(self, path: str) -> Location:
        """The file with a path relative to this folder; raises StorageError if `..` leaves the
        bucket or server.
        """
        if not self._scheme:
            return Location("", os.path.normpath(f"{self._key}/{path}"))
        key = self.child(path)._key
        root, key = key.partition("/")[0], posixpath.normpath(key)
        if key.partition("/")[0] != root:
            raise StorageError(f"{self}: expected a path in {quoted(root)}, found {quoted(path)}.")
        return Location(self._scheme, key, self._options)

    def stat(self) -> FileStat | None:
        """Size and time of change; None = no such file, folder or bucket; raises StorageError if
        access is refused.
        """
        try:
            with storage_errors(self, "read"):
                if self.is_local:
                    return _local_stat(os.stat(self._key))
                if self.is_web:
                    info = web_files().info(self.address)
                    size = info.get("size")
                    return FileStat(
                        -1 if size is None else int(size), _header_ns(info.get("Last-Modified", ""))
                    )
                return _arrow_stat(self.arrow()[0].get_file_info(self._key))
        except StorageError as error:
            if error.kind == "missing":
                return None
            raise

    def exists(self) -> bool:
        """Whether there is such a file or folder; raises the errors of `stat`."""
        return self.stat() is not None

    def list(self, *, recursive: bool = False) -> Iterator[Entry]:
        """Files and folders in this folder, in no particular order.

        Links to folders are followed, except back to a folder above. The sizes and times of files
        on a web server, to which the pages of its folders link, are not known. Raises StorageError:
        there is no such folder, or it cannot be read.
        """
        if self.is_local:
            with storage_errors(self, "read"):
                status = os.stat(self._key)
            yield from _scanned(
                self._key, "", ((status.st_dev, status.st_ino),), recursive=recursive
            )
            return
        if self.is_web:
            folder = f"{self._scheme}://{_LINK_QUERY.sub('', self._key).rstrip('/')}/"
            yield from self._linked(folder, folder, depth=_MAX_WEB_DEPTH if recursive else 1)
            return
        from pyarrow.fs import FileSelector

        # pyarrow lists no folders of Google Cloud Storage, except those that exist as empty objects
        has_folders, (files, key) = self._scheme != "gs", self.arrow()
        with storage_errors(self, "read"):
            infos = files.get_file_info(FileSelector(key, recursive=recursive or not has_folders))
        known = ((info.path[len(key.rstrip("/")) + 1 :], _arrow_stat(info)) for info in infos)
        entries = [Entry(name, status) for name, status in known if status is not None]
        for entry in entries if has_folders else with_folders(entries):
            if recursive or "/" not in entry.name:
                yield entry

    def _linked(self, folder: str, base: str, *, depth: int) -> Iterator[Entry]:
        with storage_errors(self, "read"):
            links = {_LINK_QUERY.sub("", link) for link in web_files().ls(folder, detail=False)}
        for link in sorted(links):
            name = unquote(link[len(base) :])
            if not link.startswith(folder) or link == folder or ".." in name.split("/"):
                continue
            yield Entry(
                posixpath.normpath(name), _FOLDER if link.endswith("/") else FileStat(-1, 0)
            )
            if link.endswith("/") and depth > 1:
                yield from self._linked(link, base, depth=depth - 1)

    def read_bytes(self, max_bytes: int = _MAX_READ_BYTES) -> bytes:
        """Content of a file; raises StorageError if it does not exist, is larger, or cannot be
        read.
        """
        return b"".join(self._blocks(max_bytes))

    def download(self, file: Path, max_bytes: int = 1 << 62) -> int:
        """Copy this file to a local path, which is incomplete if an error is raised; returns its
        size in bytes.

        Raises the errors of `read_bytes`, and an error if the local file cannot be written.
        """
        with storage_errors(file, "written"), open(file, "wb") as target:
            return sum(target.write(block) for block in self._blocks(max_bytes))

    def _blocks(self, max_bytes: int) -> Iterator[bytes]:
        size = 0
        with storage_errors(self, "read"):
            stream: IO[bytes]
            if self.is_local:
                os.stat(self._key)  # raises for a missing file, with its kind
                stream = open_regular(Path(self._key), StorageError, "a file")
            elif self.is_web:
                stream = web_files().open(self.address, "rb", block_size=0)
            else:
                stream = self.arrow()[0].open_input_stream(self._key, compression=None)
            with stream:
                while block := stream.read(_BLOCK_BYTES):
                    size += len(block)
                    if size > max_bytes:
                        raise StorageError(
                            f"{self}: expected a file of at most {max_bytes} bytes, found more."
                        )
                    yield block

    def write_bytes(self, content: bytes) -> None:
        """Write a file atomically, or raise StorageError. Folders are created, buckets are not."""
        with storage_errors(self, "written"):
            if self.is_local:
                os.makedirs(os.path.dirname(self._key), exist_ok=True)
                write_bytes(Path(self._key), content)
            else:
                self._send(io.BytesIO(content))

    def upload(self, file: Path) -> None:
        """Copy a local file to this location, as `write_bytes` does."""
        with storage_errors(self, "written"), open(file, "rb") as source:
            if self.is_local:
                os.makedirs(os.path.dirname(self._key), exist_ok=True)
                with atomic_path(Path(self._key)) as partial:
                    shutil.copyfile(file, partial)
            else:
                self._send(source)

    def _send(self, source: IO[bytes]) -> None:
        stream = self.arrow()[0].open_output_stream(self._key, compression=None)
        try:
            shutil.copyfileobj(source, stream, _BLOCK_BYTES)
        except BaseException:
            # pyarrow's streams cannot be aborted: closing publishes what has been sent
            stream.close()
            with suppress(StorageError):  # the first error is the one to report
                self.remove()
            raise
        stream.close()

    def remove(self) -> None:
        """Remove a file; a missing file is not an error."""
        with storage_errors(self, "removed"), suppress(FileNotFoundError):
            if self.is_local:
                os.unlink(self._key)
            else:
                self.arrow()[0].delete_file(self._key)

    def arrow(self) -> tuple[FileSystem, str]:
        """File system of pyarrow and the path in it; raises StorageError without a connection, and
        for web servers.
        """
        if self.is_web:
            raise StorageError(
                f"{self}: expected a folder on this machine or in an object store, found a web "
                "server.",
                "permission",
            )
        with storage_errors(self, "read"):
            if not self.is_local:
                return object_store(
                    self._scheme, self._key.partition("/")[0], dict(self._options)
                ), self._key
            from pyarrow.fs import LocalFileSystem

            return LocalFileSystem(), self._key

    def address_and_options(self) -> tuple[str, str]:
        """The address without options, and the options with their question mark; "" = none."""
        address, options = self.address, _options_text(self._options)
        return (_QUERY.sub("", address) if self.is_web else address.removesuffix(options)), options


def shown(address: str) -> str:
    """An address without the user name and password, and without the query of a web address, for
    messages.
    """
    if _SCHEME.match(address) is None:
        return address
    address = _USER.sub("", address)
    return _QUERY.sub("?...", address) if address.startswith(("http:", "https:")) else address


def has_scheme(text: str) -> bool:
    """Whether a text is an address such as `s3://...` instead of a path."""
    return _SCHEME.match(text) is not None


def _options_text(options: tuple[tuple[str, str], ...]) -> str:
    query = "&".join(f"{name}={value}" for name, value in options)
    return f"?{query}" if query else ""


def _scanned(
    folder: str, prefix: str, above: tuple[tuple[int, int], ...], *, recursive: bool
) -> Iterator[Entry]:
    """Entries of a folder; `above` are device and inode of this folder and of the folders above."""
    with storage_errors(folder, "read"), os.scandir(folder) as items:
        for item in items:
            try:
                status = item.stat()
            except FileNotFoundError:  # a broken link, or removed meanwhile
                continue
            yield Entry(prefix + item.name, _local_stat(status))
            identity = (status.st_dev, status.st_ino)
            if recursive and stat.S_ISDIR(status.st_mode) and identity not in above:
                yield from _scanned(
                    item.path, f"{prefix}{item.name}/", (*above, identity), recursive=True
                )


def with_folders(entries: Iterable[Entry]) -> Iterator[Entry]:
    """A recursive listing of files with the folders that contain them."""
    listed = list(entries)
    yield from listed
    known = {entry.name for entry in listed if entry.stat.is_folder}
    for entry in listed:
        name = entry.name.rpartition("/")[0]
        while name and name not in known:
            known.add(name)
            yield Entry(name, _FOLDER)
            name = name.rpartition("/")[0]


def _local_stat(status: os.stat_result) -> FileStat:
    return _FOLDER if stat.S_ISDIR(status.st_mode) else FileStat(status.st_size, status.st_mtime_ns)


def _arrow_stat(info: FileInfo) -> FileStat | None:
    from pyarrow.fs import FileType

    if info.type == FileType.NotFound:
        return None
    return _FOLDER if info.type == FileType.Directory else FileStat(info.size, info.mtime_ns or 0)


def _header_ns(text: str) -> int:
    """Date in a header as ns since 1970; 0 = none."""
    try:
        return int(parsedate_to_datetime(text).timestamp()) * 10**9
    except (ValueError, TypeError, OverflowError):
        return 0


class FolderListings:
    """Sizes and times of many files as they are when a folder is first needed; several threads may
    use it.

    In an object store, one request lists a folder, instead of one or more for each file.
    """

    def __init__(self) -> None:
        self._lock = threading.Lock()
        self._folder_locks: dict[str, threading.Lock] = {}
        self._stats: dict[str, dict[str, FileStat]] = {}

    def stat(self, location: Location) -> FileStat | None:
        """See `Location.stat`."""
        parent = location.parent
        if location.is_local or location.is_web or parent is None:
            return location.stat()
        with self._lock:
            folder_lock = self._folder_locks.setdefault(parent.address, threading.Lock())
        with folder_lock:
            if parent.address not in self._stats:
                try:
                    self._stats[parent.address] = {
                        entry.name: entry.stat for entry in parent.list()
                    }
                except StorageError as error:
                    if error.kind != "missing":
                        raise
                    self._stats[parent.address] = {}
            return self._stats[parent.address].get(location.name)

    def state(self, location: Location) -> FileStat | None:
        """See `stat`; for a folder, the total size and the latest change of all files that are not
        hidden.
        """
        status = self.stat(location)
        return (
            status
            if status is None or not status.is_folder
            else folder_state(location.list(recursive=True))
        )
