"""File systems of object stores (pyarrow) and web servers (fsspec, extra `fleet`)."""

from __future__ import annotations

import os
from collections.abc import Mapping
from datetime import timedelta
from functools import lru_cache
from typing import TYPE_CHECKING, Any

from track_range.fleet.storage.errors import StorageError

if TYPE_CHECKING:
    from fsspec.implementations.http import HTTPFileSystem
    from pyarrow.fs import FileSystem

_N_ATTEMPTS = 3  # attempts of a request to S3; the caller decides on further ones
# time limits of the connection, and between two parts of an answer
CONNECT_TIMEOUT_S, REQUEST_TIMEOUT_S = 5.0, 20.0
# time for which pyarrow repeats a request to Google Cloud Storage (default: 15 minutes)
_GCS_TIME_LIMIT_S = 10


def object_store(scheme: str, bucket: str, options: Mapping[str, str]) -> FileSystem:
    """File system of pyarrow for a bucket of "s3" or "gs".

    Options are `endpoint_override`, `scheme`, `region` and `anonymous`. Raises OSError or
    ValueError if they are wrong, or the region of the bucket is not known.
    """
    endpoint, variables = options.get("endpoint_override", ""), os.environ
    if scheme == "gs":
        return _gcs(endpoint, options.get("scheme", "https"), options.get("anonymous") == "true")
    # pyarrow itself reads no variable for the server
    endpoint = (
        endpoint
        or variables.get("AWS_ENDPOINT_URL_S3", "")
        or variables.get("AWS_ENDPOINT_URL", "")
    )
    region = (
        options.get("region") or variables.get("AWS_REGION") or variables.get("AWS_DEFAULT_REGION")
    )
    region = region or ("us-east-1" if endpoint else _region_of(bucket))
    timeouts_s = CONNECT_TIMEOUT_S, REQUEST_TIMEOUT_S
    return _s3(
        endpoint,
        options.get("scheme", "https"),
        region,
        options.get("anonymous") == "true",
        timeouts_s,
    )


@lru_cache(maxsize=256)
def _region_of(bucket: str) -> str:
    from pyarrow.fs import resolve_s3_region

    region: str = resolve_s3_region(bucket)
    return region


@lru_cache(maxsize=32)
def _s3(
    endpoint: str, scheme: str, region: str, anonymous: bool, timeouts_s: tuple[float, float]
) -> FileSystem:
    from pyarrow.fs import AwsStandardS3RetryStrategy, S3FileSystem

    if os.environ.get("AWS_ACCESS_KEY_ID"):
        # region and credentials are known; the AWS SDK would still wait for the metadata service of
        # a cloud machine
        os.environ.setdefault("AWS_EC2_METADATA_DISABLED", "true")
    return S3FileSystem(
        region=region,
        anonymous=anonymous,
        connect_timeout=timeouts_s[0],
        request_timeout=timeouts_s[1],
        allow_delayed_open=True,  # one request for a small object
        retry_strategy=AwsStandardS3RetryStrategy(max_attempts=_N_ATTEMPTS),
        **_server(endpoint, scheme),
    )


@lru_cache(maxsize=32)
def _gcs(endpoint: str, scheme: str, anonymous: bool) -> FileSystem:
    from pyarrow.fs import GcsFileSystem

    limit = timedelta(seconds=_GCS_TIME_LIMIT_S)
    return GcsFileSystem(anonymous=anonymous, retry_time_limit=limit, **_server(endpoint, scheme))


def _server(endpoint: str, scheme: str) -> dict[str, Any]:
    """Options of pyarrow for HOST:PORT or an address with a scheme; none for the provider's own
    server.
    """
    given_scheme, _, host = endpoint.rpartition("://")
    return (
        {"endpoint_override": host.rstrip("/"), "scheme": given_scheme or scheme}
        if endpoint
        else {}
    )


def web_files() -> HTTPFileSystem:
    """File system of fsspec for web servers; raises StorageError if a package is missing."""
    return _web_files(2 * CONNECT_TIMEOUT_S, 1.5 * REQUEST_TIMEOUT_S)  # web servers may be slower


@lru_cache(maxsize=4)
def _web_files(connect_s: float, read_s: float) -> HTTPFileSystem:
    try:
        import aiohttp
        from fsspec.implementations.http import HTTPFileSystem
    except ImportError as error:
        raise StorageError(
            "http:// and https:// need the packages fsspec and aiohttp; install them with: pip install "
            '"track-range[fleet]".'
        ) from error
    timeout = aiohttp.ClientTimeout(total=None, sock_connect=connect_s, sock_read=read_s)
    return HTTPFileSystem(client_kwargs={"timeout": timeout}, use_listings_cache=False)
