"""ObjectStore: buckets of S3 and Google Cloud Storage through pyarrow; keys are `bucket/key`, not percent-encoded."""

from __future__ import annotations

import os
import shutil
from collections.abc import Iterator, Mapping
from contextlib import suppress
from datetime import timedelta
from functools import lru_cache
from pathlib import Path
from typing import TYPE_CHECKING, Any

from track_range.fleet.storage.entry import Entry, FileStat, with_folders
from track_range.fleet.storage.errors import StorageError, storage_errors

if TYPE_CHECKING:
    from pyarrow.fs import FileInfo, FileSystem

_N_ATTEMPTS = 3
"""Attempts of a request to S3; the caller decides on further ones."""

_CONNECT_TIMEOUT_S, _REQUEST_TIMEOUT_S = 5.0, 20.0
"""Time limits of the connection, and between two bytes of an answer."""

_GCS_TIME_LIMIT_S = 10
"""Time for which pyarrow repeats a request to Google Cloud Storage (default: 15 minutes)."""

_BLOCK_BYTES = 4 << 20
"""Size of the blocks in which files are copied, bytes."""

_FOLDER = FileStat(0, 0, is_folder=True)


class ObjectStore:
    """See `Storage` for the methods.

    Args:
        scheme: "s3" or "gs".
        options: `endpoint_override`, `scheme`, `region` and `anonymous` by name.
    """

    is_read_only = False

    def __init__(self, scheme: str, options: Mapping[str, str]) -> None:
        self._scheme, self._options = scheme, tuple(sorted(options.items()))

    def file_system(self, key: str, address: str) -> FileSystem:
        """File system of pyarrow for the bucket of a key."""
        with storage_errors(address, "read"):
            if self._scheme == "gs":
                return _gcs(self._options)
            return _s3(self._options, _endpoint(self._options), _region(self._options, key.partition("/")[0]))

    def stat(self, key: str, address: str) -> FileStat | None:
        """Size and time; None = no such object, folder or bucket."""
        files = self.file_system(key, address)
        with storage_errors(address, "read"):
            return _stat_of(files.get_file_info(key))

    def entries(self, key: str, address: str, *, recursive: bool) -> Iterator[Entry]:
        """Objects and folders below a prefix."""
        if self._scheme != "gs":
            yield from self._entries(key, address, recursive=recursive)
            return
        # pyarrow lists no folders of Google Cloud Storage, except those that exist as empty objects
        for entry in with_folders(self._entries(key, address, recursive=True)):
            if recursive or "/" not in entry.name:
                yield entry

    def _entries(self, key: str, address: str, *, recursive: bool) -> Iterator[Entry]:
        from pyarrow.fs import FileSelector

        files = self.file_system(key, address)
        with storage_errors(address, "read"):
            infos = files.get_file_info(FileSelector(key, recursive=recursive))
        n_prefix = len(key.rstrip("/")) + 1
        for info in infos:
            if (status := _stat_of(info)) is not None:
                yield Entry(info.path[n_prefix:], status)

    def read(self, key: str, address: str, max_bytes: int) -> bytes:
        """Content of an object of at most `max_bytes`."""
        files = self.file_system(key, address)
        with storage_errors(address, "read"), files.open_input_stream(key, compression=None) as stream:
            content: bytes = stream.read(max_bytes + 1)
        if len(content) > max_bytes:
            raise StorageError(f"{address}: expected a file of at most {max_bytes} bytes, found a larger one.")
        return content

    def write(self, key: str, address: str, content: bytes) -> None:
        """Write an object with one request."""
        files = self.file_system(key, address)
        with storage_errors(address, "written"), files.open_output_stream(key, compression=None) as stream:
            stream.write(content)

    def upload(self, key: str, address: str, file: Path) -> None:
        """Copy a local file here; the object appears when all of it has been sent."""
        files = self.file_system(key, address)
        with storage_errors(address, "written"), open(file, "rb") as source:
            stream = files.open_output_stream(key, compression=None)
            is_complete = False
            try:
                shutil.copyfileobj(source, stream, _BLOCK_BYTES)
                is_complete = True
            finally:
                stream.close()
                if not is_complete:  # pyarrow's streams cannot be aborted: closing publishes what has been sent
                    with suppress(OSError):
                        files.delete_file(key)

    def download(self, key: str, address: str, file: Path, max_bytes: int) -> int:
        """Copy an object to a local path; returns its size."""
        files = self.file_system(key, address)
        size = 0
        with (
            storage_errors(address, "read"),
            files.open_input_stream(key, compression=None) as stream,
            open(file, "wb") as target,
        ):
            while block := stream.read(_BLOCK_BYTES):
                size += len(block)
                if size > max_bytes:
                    raise StorageError(f"{address}: expected at most {max_bytes} bytes, found more.")
                target.write(block)
        return size

    def remove(self, key: str, address: str) -> None:
        """Remove an object; a missing one is no error."""
        files = self.file_system(key, address)
        with storage_errors(address, "removed"), suppress(FileNotFoundError):
            files.delete_file(key)


def _stat_of(info: FileInfo) -> FileStat | None:
    from pyarrow.fs import FileType

    if info.type == FileType.NotFound:
        return None
    return _FOLDER if info.type == FileType.Directory else FileStat(info.size, info.mtime_ns or 0)


def _endpoint(options: tuple[tuple[str, str], ...]) -> str:
    """Address of the S3 server, "" for Amazon's; pyarrow itself reads no variable for it."""
    given = dict(options).get("endpoint_override", "")
    return given or os.environ.get("AWS_ENDPOINT_URL_S3", "") or os.environ.get("AWS_ENDPOINT_URL", "")


def _region(options: tuple[tuple[str, str], ...], bucket: str) -> str:
    given = dict(options).get("region") or os.environ.get("AWS_REGION") or os.environ.get("AWS_DEFAULT_REGION")
    if given:
        return given
    return "us-east-1" if _endpoint(options) else _region_of(bucket)


@lru_cache(maxsize=256)
def _region_of(bucket: str) -> str:
    """Region of a bucket at Amazon, by a request."""
    from pyarrow.fs import resolve_s3_region

    region: str = resolve_s3_region(bucket)
    return region


@lru_cache(maxsize=32)
def _s3(options: tuple[tuple[str, str], ...], endpoint: str, region: str) -> FileSystem:
    from pyarrow.fs import AwsStandardS3RetryStrategy, S3FileSystem

    if os.environ.get("AWS_ACCESS_KEY_ID"):
        # region and credentials are known; the AWS SDK would still wait for the metadata service of a cloud machine
        os.environ.setdefault("AWS_EC2_METADATA_DISABLED", "true")
    given = dict(options)
    scheme, has_scheme, host = endpoint.rpartition("://")
    extra: dict[str, Any] = {"endpoint_override": host.rstrip("/")} if endpoint else {}
    return S3FileSystem(
        region=region,
        scheme=scheme if has_scheme else given.get("scheme", "https"),
        anonymous=given.get("anonymous", "") == "true",
        connect_timeout=_CONNECT_TIMEOUT_S,
        request_timeout=_REQUEST_TIMEOUT_S,
        allow_delayed_open=True,  # one request for a small object
        retry_strategy=AwsStandardS3RetryStrategy(max_attempts=_N_ATTEMPTS),
        **extra,
    )


@lru_cache(maxsize=32)
def _gcs(options: tuple[tuple[str, str], ...]) -> FileSystem:
    from pyarrow.fs import GcsFileSystem

    given = dict(options)
    endpoint = given.get("endpoint_override", "")
    scheme, has_scheme, host = endpoint.rpartition("://")
    extra: dict[str, Any] = (
        {"endpoint_override": host, "scheme": scheme if has_scheme else given.get("scheme", "https")}
        if endpoint
        else {}
    )
    return GcsFileSystem(
        anonymous=given.get("anonymous", "") == "true",
        retry_time_limit=timedelta(seconds=_GCS_TIME_LIMIT_S),
        **extra,
    )
