"""Servers of object storage and web pages on this machine, and recordings for fleets."""

from __future__ import annotations

import functools
import logging
import threading
from collections.abc import Callable, Iterator
from http.server import SimpleHTTPRequestHandler, ThreadingHTTPServer
from pathlib import Path
from typing import Any

import pytest

from tests.track_range.fleet.ray_clusters import ACCESS_KEY, SECRET_KEY, ray_cluster
from track_range.fleet.storage.location import Location


class _QuietHandler(SimpleHTTPRequestHandler):
    """Serves a folder with listings."""

    def log_message(self, *_: object) -> None:
        """Write nothing."""


@pytest.fixture(scope="session")
def s3_endpoint() -> Iterator[str]:
    """Address of an S3 server, for the whole session."""
    from moto.server import ThreadedMotoServer

    logging.getLogger("werkzeug").setLevel(logging.ERROR)
    server = ThreadedMotoServer("127.0.0.1", port=0, verbose=False)
    server.start()
    host, port = server.get_host_and_port()
    yield f"http://{host}:{port}"
    server.stop()


@pytest.fixture
def s3(s3_endpoint: str, monkeypatch: pytest.MonkeyPatch) -> str:
    """Address of an S3 server, with the credentials in the environment."""
    for name, value in {
        "AWS_ENDPOINT_URL": s3_endpoint,
        "AWS_ACCESS_KEY_ID": ACCESS_KEY,
        "AWS_SECRET_ACCESS_KEY": SECRET_KEY,
        "AWS_EC2_METADATA_DISABLED": "true",
    }.items():
        monkeypatch.setenv(name, value)
    return s3_endpoint


@pytest.fixture
def bucket(s3: str, request: pytest.FixtureRequest) -> Location:
    """A new bucket."""
    from pyarrow.fs import S3FileSystem

    name = f"bucket-{abs(hash(request.node.nodeid))}"
    files = S3FileSystem(
        endpoint_override=s3.partition("://")[2],
        scheme="http",
        region="us-east-1",
        allow_bucket_creation=True,
    )
    files.create_dir(name)
    return Location.of(f"s3://{name}")


@pytest.fixture
def web(tmp_path: Path) -> Iterator[tuple[str, Path]]:
    """Address of a web server, and the folder that it serves."""
    folder = tmp_path / "web"
    folder.mkdir()
    server = ThreadingHTTPServer(
        ("127.0.0.1", 0), functools.partial(_QuietHandler, directory=str(folder))
    )
    thread = threading.Thread(
        target=server.serve_forever, kwargs={"poll_interval": 0.02}, daemon=True
    )
    thread.start()
    yield f"http://127.0.0.1:{server.server_address[1]}", folder
    server.shutdown()
    server.server_close()
    thread.join()


@pytest.fixture
def filled() -> Callable[..., Path]:
    """Writes files of one byte or with given content: `filled(folder, "a.mp4", "b/c.mp4",
    **{"d.txt": b"..."})`."""

    def write(folder: Path, *names: str, **contents: bytes) -> Path:
        for name, content in {**dict.fromkeys(names, b"x"), **contents}.items():
            path = folder / name
            path.parent.mkdir(parents=True, exist_ok=True)
            path.write_bytes(content)
        return folder

    return write


@pytest.fixture(scope="session")
def cluster() -> Iterator[Any]:
    """A Ray cluster of this machine, to which this process is connected; see `ray_cluster`."""
    pytest.importorskip("ray")
    with ray_cluster() as started:
        yield started
