"""Web servers that refuse, stop in the middle, or do not answer."""

import sys
import threading
import time
from http.server import BaseHTTPRequestHandler, ThreadingHTTPServer

import pytest

from track_range.fleet.storage import file_systems
from track_range.fleet.storage.errors import StorageError
from track_range.fleet.storage.location import Location

BODY = b"0123456789" * 100


class _FaultyHandler(BaseHTTPRequestHandler):
    """Answers by the name of the file."""

    protocol_version = "HTTP/1.1"

    def log_message(self, *_: object) -> None:
        """Write nothing."""

    def do_HEAD(self) -> None:
        """Answer without a body."""
        self.do_GET()

    def do_GET(self) -> None:
        """Answer with a fault."""
        name = self.path.strip("/").partition("?")[0]
        if name == "silent":
            time.sleep(2)
            return
        if name == "moved":
            self.send_response(302)
            self.send_header("Location", "/whole")
            self.send_header("Content-Length", "0")
            self.end_headers()
            return
        self.send_response(int(name) if name.isdigit() else 200)
        if name == "unknown":
            self.send_header("Connection", "close")
        else:
            self.send_header("Content-Length", str(len(BODY)))
        self.end_headers()
        if self.command == "GET":
            self.wfile.write(BODY[:500] if name == "short" else BODY)
        self.close_connection = True


@pytest.fixture(scope="module")
def address():
    """Address of the server."""
    server = ThreadingHTTPServer(("127.0.0.1", 0), _FaultyHandler)
    thread = threading.Thread(
        target=server.serve_forever, kwargs={"poll_interval": 0.02}, daemon=True
    )
    thread.start()
    yield f"http://127.0.0.1:{server.server_address[1]}"
    server.shutdown()
    server.server_close()
    thread.join()


@pytest.mark.parametrize(
    ("name", "kind"),
    [("401", "permission"), ("403", "permission"), ("404", "missing"), ("418", "other"), ("429", "network"),
     ("503", "network"), ("short", "network")],
)  # fmt: skip
def test_kinds_of_answers(address, tmp_path, name, kind):
    location = Location.of(f"{address}/{name}?signature=secret")
    for act in (location.read_bytes, lambda: location.download(tmp_path / "x")):
        with pytest.raises(StorageError, match=name) as error:
            act()
        assert error.value.kind == kind
        assert "secret" not in str(error.value)
        assert len(str(error.value)) < 300
    if kind == "missing":
        assert location.stat() is None
    elif name != "short":
        with pytest.raises(StorageError) as error:
            location.stat()
        assert error.value.kind == kind


def test_redirected_and_without_length(address, tmp_path):
    for name in ("whole", "moved", "unknown"):
        location = Location.of(f"{address}/{name}")
        assert location.read_bytes() == BODY
        assert location.download(tmp_path / "x") == len(BODY)
    assert Location.of(f"{address}/moved").stat().size == len(BODY)
    unknown = Location.of(f"{address}/unknown").stat()
    assert (unknown.size, unknown.mtime_ns) == (-1, 0)


def test_silent_server(address, monkeypatch):
    monkeypatch.setattr(file_systems, "REQUEST_TIMEOUT_S", 0.2)
    start_s = time.monotonic()
    with pytest.raises(StorageError) as error:
        Location.of(f"{address}/silent").read_bytes()
    assert error.value.kind == "network"
    assert time.monotonic() - start_s < 30


def test_packages_are_missing(monkeypatch):
    # a file system that does not exist yet
    monkeypatch.setattr(file_systems, "REQUEST_TIMEOUT_S", 0.3)
    monkeypatch.setitem(sys.modules, "aiohttp", None)
    location = Location.of("http://host/x")
    for act in (location.stat, location.read_bytes):
        with pytest.raises(StorageError, match="pip install"):
            act()
