"""LivePage: HTTP server of a page with the newest picture of a run, as a stream of JPEG images
(MJPEG).

/             the page
/stream.mjpg  every new picture
/frame.jpg    the newest picture
/state        "live" while the run is in progress
/boxes        the newest boxes in px with their time, and the name of the video, as JSON; no content where a known
              distance has no use

By default only this machine is served, and only under loopback names, so that other web pages
cannot read the pictures (DNS rebinding). The number of streams and of connections, the size of a
request and the time for it are limited, so that no client can delay the run or fill the memory.
"""

from __future__ import annotations

import errno
import io
import re
import socket
import sys
import threading
import time
from base64 import b64encode
from collections.abc import Callable
from contextlib import suppress
from functools import cache
from hashlib import sha256
from http import HTTPStatus
from http.client import HTTPException
from http.server import BaseHTTPRequestHandler, ThreadingHTTPServer
from importlib.resources import files
from ipaddress import ip_address
from socketserver import TCPServer
from typing import Any

from track_range.foundation.errors import ConfigError
from track_range.foundation.prefetch import lower_thread_priority

DEFAULT_VIEWERS = 16  # largest number of streams at a time
# connections served at a time in addition to the streams; each has a thread
_SPARE_CONNECTIONS = 32
# for a client to send its request, or to accept a picture; then its connection is closed
TIMEOUT_S = 5.0
# largest size of a request: twice the longest line that `http.server` accepts
_MAX_REQUEST_BYTES = 1 << 17
# about one picture: a slow viewer must not request pictures that it sees late
_SEND_BUFFER_BYTES = 1 << 18
_POLL_S = 0.1  # between checks of whether the server is to end
# between checks of whether a viewer who waits for a picture has disconnected
_DISCONNECT_POLL_S = 1.0

_HEADERS = {  # of every answer, besides the Content-Security-Policy
    "Cache-Control": "no-store",
    "Cross-Origin-Resource-Policy": "same-origin",
    "Referrer-Policy": "no-referrer",
    "X-Content-Type-Options": "nosniff",
    "X-Frame-Options": "DENY",
}

_REFUSAL = (  # of a connection for which there is no thread
    "HTTP/1.0 503 Service Unavailable\r\nContent-Type: text/plain; charset=utf-8\r\n"
    + "".join(f"{name}: {value}\r\n" for name, value in _HEADERS.items())
    + "Content-Security-Policy: default-src 'none'\r\nConnection: close\r\n\r\n"
    "Too many connections.\n"
).encode()

LOOPBACK = "127.0.0.1"

_LOCAL_NAMES = {"0.0.0.0": LOOPBACK, "::": "[::1]"}  # noqa: S104
"""Loopback address, by the address that means all interfaces of this machine."""


class PageError(ConfigError):
    """The page cannot be served at the given address."""


NextPicture = Callable[[int, float], tuple[bytes, int] | None]
"""Waits for a picture after the given number, at most for the given time in seconds.

Returns it as JPEG with its number, empty bytes if there is none yet, or None at the end of the run.
"""


class LivePage(ThreadingHTTPServer):
    """HTTP server of the live page, in a thread; serves until closed.

    Each connection has a thread; connections beyond the limit are closed with status 503.
    `next_picture` is called from one thread per connection; port 0 = any free port; `n_viewers` is
    the largest number of streams at a time, the next one is refused with status 503; `boxes`
    returns the content of /boxes, empty = none; `timeout_s` is how long a client may take to send a
    request or to accept a picture. `url`: address of the page on this machine.
    `url_elsewhere`: probable address on other machines if all interfaces are served; else None.

    Raises PageError: the port is in use, or the address does not belong to this machine.
    """

    daemon_threads = True
    block_on_close = False  # a stalled connection must not delay the end of the run
    request_queue_size = 64

    def __init__(
        self,
        next_picture: NextPicture,
        port: int,
        *,
        host: str = LOOPBACK,
        n_viewers: int = DEFAULT_VIEWERS,
        boxes: Callable[[], bytes] = bytes,
        timeout_s: float = TIMEOUT_S,
    ) -> None:
        self.next_picture, self.boxes, self.timeout_s = next_picture, boxes, timeout_s
        self.is_private = _is_loopback(host)
        self.n_viewers = n_viewers
        self.free_streams = threading.BoundedSemaphore(n_viewers)
        self._free_connections = threading.BoundedSemaphore(n_viewers + _SPARE_CONNECTIONS)
        self.address_family = socket.AF_INET6 if ":" in host else socket.AF_INET
        shown = f"[{host}]" if ":" in host else host
        try:
            super().__init__((host, port), _Handler)
        except OSError as error:
            advice = (
                "choose a port above 1023" if error.errno == errno.EACCES else "choose another port"
            )
            if isinstance(error, socket.gaierror) or error.errno == errno.EADDRNOTAVAIL:
                advice = "give an address of this machine, such as 0.0.0.0 for all interfaces"
            raise PageError(
                f"--serve {shown}:{port}: cannot listen on this address "
                f"({error.strerror or error}); {advice}."
            ) from error
        port = self.server_address[1]
        self.url = f"http://{_LOCAL_NAMES.get(host, shown)}:{port}/"
        self.url_elsewhere = (
            f"http://{socket.gethostname()}:{port}/" if host in _LOCAL_NAMES else None
        )
        self._thread = threading.Thread(target=self._serve, name="live page", daemon=True)
        self._thread.start()

    def close(self) -> None:
        """End the server and its streams; may be called again."""
        self.shutdown()
        self.server_close()
        self._thread.join()

    def _serve(self) -> None:
        lower_thread_priority()  # also that of the connections' threads
        self.serve_forever(_POLL_S)

    def server_bind(self) -> None:
        """Bind without http.server's reverse DNS lookup, which can take long."""
        TCPServer.server_bind(self)

    def process_request(self, request: socket.socket, client_address: object) -> None:  # type: ignore[override]
        """Start the thread of a connection, or refuse it."""
        if not self._free_connections.acquire(blocking=False):
            with suppress(OSError):
                request.setblocking(False)
                request.send(_REFUSAL)
            self.shutdown_request(request)
            return
        try:
            super().process_request(request, client_address)
        except RuntimeError:  # no thread can be started: memory or processes are limited
            self._free_connections.release()
            self.shutdown_request(request)

    def process_request_thread(self, request: socket.socket, client_address: object) -> None:  # type: ignore[override]
        """Serve a connection in its thread."""
        try:
            super().process_request_thread(request, client_address)
        finally:
            self._free_connections.release()

    def handle_error(self, request: object, client_address: object) -> None:
        """Report an error of ours; browsers may disconnect at any time."""
        if not isinstance(sys.exception(), OSError):
            super().handle_error(request, client_address)  # type: ignore[arg-type]


class _RequestReader(io.RawIOBase):
    """Reads a request of limited size that has to be complete in time: a client could send a byte
    every few seconds.
    """

    def __init__(self, connection: socket.socket, timeout_s: float) -> None:
        self._connection, self._n_bytes_left = connection, _MAX_REQUEST_BYTES
        self._timeout_s, self._end_s = timeout_s, time.monotonic() + timeout_s

    def readable(self) -> bool:
        return True

    def readinto(self, buffer: Any) -> int:
        left_s = self._end_s - time.monotonic()
        if left_s <= 0:
            raise TimeoutError
        if self._n_bytes_left <= 0:
            raise HTTPException  # `http.server` answers with status 431
        self._connection.settimeout(left_s)
        n_bytes = self._connection.recv_into(buffer)
        self._connection.settimeout(self._timeout_s)
        self._n_bytes_left -= n_bytes
        return n_bytes


class _Handler(BaseHTTPRequestHandler):
    server: LivePage
    server_version, sys_version = "track-range", ""
    default_request_version = "HTTP/1.0"  # an answer to HTTP/0.9 would have no headers

    def setup(self) -> None:
        super().setup()
        self.connection.setsockopt(socket.SOL_SOCKET, socket.SO_SNDBUF, _SEND_BUFFER_BYTES)
        self.rfile = io.BufferedReader(_RequestReader(self.connection, self.server.timeout_s))

    def do_GET(self) -> None:
        page, hosts = self.server, self.headers.get_all("Host", [])
        if page.is_private and not (
            len(hosts) == 1 and _is_loopback(re.sub(r":\d+$", "", hosts[0]).strip("[]"))
        ):
            self.send_error(HTTPStatus.FORBIDDEN)
            return
        match self.path.partition("?")[0]:
            case "/":
                self._send("text/html; charset=utf-8", _page()[0])
            case "/stream.mjpg":
                self._send_stream()
            case "/frame.jpg":
                picture = self._next_picture(0)
                if picture is None:
                    self.send_error(HTTPStatus.SERVICE_UNAVAILABLE)
                else:
                    self._send("image/jpeg", picture[0])
            case "/state":
                self._send("text/plain; charset=utf-8", b"live")
            case "/boxes":
                boxes = page.boxes()
                self._send(
                    "application/json", boxes, HTTPStatus.OK if boxes else HTTPStatus.NO_CONTENT
                )
            case "/favicon.ico":  # browsers request it and report a missing one
                self._send("image/x-icon", b"", HTTPStatus.NO_CONTENT)
            case _:
                self.send_error(HTTPStatus.NOT_FOUND)

    do_HEAD = do_GET  # noqa: N815 - `_send` and `_send_stream` omit the body

    def log_message(self, *_: object) -> None:
        """Log nothing, because the run uses the terminal."""

    def send_error(self, code: int, message: str | None = None, explain: str | None = None) -> None:
        """Answer with an error status and one sentence, without any text of the request."""
        status = HTTPStatus(code)
        sentence = (
            f"{status.value} {status.phrase}" if explain is None or message is not None else explain
        )
        self._send("text/plain; charset=utf-8", sentence.encode(), status)

    def _send(self, kind: str, body: bytes | None, status: HTTPStatus = HTTPStatus.OK) -> None:
        """Answer with a body, or with the headers of a body that follows (None)."""
        self.send_response(status)
        headers = {
            "Content-Type": kind,
            "Connection": "close",
            **_HEADERS,
            "Content-Security-Policy": _page()[1],
        }
        if body is not None:
            headers["Content-Length"] = str(len(body))
        for name, value in headers.items():
            self.send_header(name, value)
        self.end_headers()
        if body and self.command != "HEAD":
            self.wfile.write(body)

    def _send_stream(self) -> None:
        page = self.server
        if not page.free_streams.acquire(blocking=False):
            explain = (
                f"All {page.n_viewers} connections are in use; close another view, or raise "
                "--viewers."
            )
            self.send_error(HTTPStatus.SERVICE_UNAVAILABLE, explain=explain)
            return
        try:
            self._send("multipart/x-mixed-replace; boundary=picture", None)
            if self.command == "HEAD":
                return
            number = 0
            while picture := self._next_picture(number):
                jpeg, number = picture
                head = (
                    f"--picture\r\nContent-Type: image/jpeg\r\nContent-Length: {len(jpeg)}\r\n\r\n"
                )
                self.wfile.write(head.encode() + jpeg + b"\r\n")
            self.wfile.write(b"--picture--\r\n")
        finally:
            page.free_streams.release()

    def _next_picture(self, number: int) -> tuple[bytes, int] | None:
        """The next picture and its number; None = the end of the run; ConnectionAbortedError if the
        client has left.
        """
        while (picture := self.server.next_picture(number, _DISCONNECT_POLL_S)) and not picture[0]:
            self.connection.setblocking(False)
            with suppress(BlockingIOError):  # connected, and nothing more received
                if not self.connection.recv(1, socket.MSG_PEEK):
                    raise ConnectionAbortedError
            self.connection.settimeout(self.server.timeout_s)
        return picture


@cache
def _page() -> tuple[bytes, str]:
    """The page, and the Content-Security-Policy that allows only its own style and script."""
    page = (
        files("track_range.views.live_view").joinpath("live_page.html").read_text(encoding="utf-8")
    )
    hashes = {
        tag: b64encode(
            sha256("".join(re.findall(f"<{tag}>(.*?)</{tag}>", page, re.DOTALL)).encode()).digest()
        ).decode()
        for tag in ("style", "script")
    }
    policy = (
        "default-src 'none'; img-src 'self'; connect-src 'self'; style-src "
        f"'sha256-{hashes['style']}'; script-src 'sha256-{hashes['script']}'; base-uri 'none'; "
        "form-action 'none'; frame-ancestors 'none'"
    )
    return page.encode(), policy


def _is_loopback(host: str) -> bool:
    try:
        return ip_address(host).is_loopback
    except ValueError:
        return host.lower() == "localhost"
