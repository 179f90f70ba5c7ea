"""LivePage: HTTP server of a page with the newest picture of a run, as a stream of JPEG images (MJPEG).

/             the page
/stream.mjpg  every new picture
/frame.jpg    the newest picture
/state        "live" while the run is in progress
/boxes        the newest boxes in px with their time, and the name of the video, as JSON; no content where a known
              distance has no use

By default only this machine is served, and only under loopback names, so that other web pages cannot read the pictures
(DNS rebinding). The number of streams and of connections, the size of a request and the time for it are limited, so
that no client can delay the run or fill the memory.
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
from functools import cache, partial
from hashlib import sha256
from http import HTTPStatus
from http.server import BaseHTTPRequestHandler, ThreadingHTTPServer
from importlib.resources import files
from ipaddress import ip_address
from socketserver import TCPServer
from typing import TYPE_CHECKING

from track_range.foundation.errors import ConfigError
from track_range.foundation.prefetch import lower_thread_priority

if TYPE_CHECKING:
    from _typeshed import WriteableBuffer

DEFAULT_VIEWERS = 16
"""Largest number of streams at a time."""

_SPARE_CONNECTIONS = 32
"""Connections served at a time in addition to the streams; each has a thread."""

_TIMEOUT_S = 5.0
"""Seconds in which a client has to send its request, or to accept a picture; then its connection is closed."""

_MAX_REQUEST_BYTES = 1 << 17
"""Largest size of a request: twice the longest line that `http.server` accepts."""

_SEND_BUFFER_BYTES = 1 << 18
"""Size of a connection's send buffer, about one picture: a slow viewer must not request pictures that it sees late."""

_POLL_S = 0.1
"""Seconds between checks of whether the server is to end."""

_DISCONNECT_POLL_S = 1.0
"""Seconds between checks of whether a viewer who waits for a picture has disconnected."""

_BOUNDARY = "picture"
"""Boundary of the parts of the MJPEG stream."""

_HEADERS = {
    "Cache-Control": "no-store",
    "Cross-Origin-Resource-Policy": "same-origin",
    "Referrer-Policy": "no-referrer",
    "X-Content-Type-Options": "nosniff",
    "X-Frame-Options": "DENY",
}
"""Headers of every answer, in addition to the Content-Security-Policy."""

LOOPBACK = "127.0.0.1"

_LOCAL_NAMES = {"0.0.0.0": LOOPBACK, "::": "[::1]"}  # noqa: S104
"""Loopback address, by the address that means all interfaces of this machine."""


class PageError(ConfigError):
    """The page cannot be served at the given address."""


NextPicture = Callable[[int, float], tuple[bytes, int] | None]
"""Waits for a picture after the given number, at most for the given time in seconds.

Returns it as JPEG with its number, empty bytes if there is none yet, or None at the end of the run.
"""


class _Server(ThreadingHTTPServer):
    """HTTP server with at most `max_connections` threads; further connections are closed with status 503."""

    daemon_threads = True
    block_on_close = False  # a stalled connection must not delay the end of the run
    request_queue_size = 64

    def __init__(self, address: tuple[str, int], handler: Callable[..., _Handler], *, max_connections: int) -> None:
        self._free = threading.BoundedSemaphore(max_connections)
        super().__init__(address, handler)

    def server_bind(self) -> None:
        # not http.server's method, whose reverse DNS lookup can take long
        TCPServer.server_bind(self)

    def process_request(self, request: socket.socket, client_address: object) -> None:  # type: ignore[override]
        if not self._free.acquire(blocking=False):
            with suppress(OSError):
                request.setblocking(False)
                request.send(_REFUSAL)
            self.shutdown_request(request)
            return
        try:
            super().process_request(request, client_address)
        except RuntimeError:  # no thread can be started: memory or processes are limited
            self._free.release()
            self.shutdown_request(request)

    def process_request_thread(self, request: socket.socket, client_address: object) -> None:  # type: ignore[override]
        try:
            super().process_request_thread(request, client_address)
        finally:
            self._free.release()

    def handle_error(self, request: object, client_address: object) -> None:
        if not isinstance(sys.exception(), OSError):  # browsers may disconnect at any time
            super().handle_error(request, client_address)  # type: ignore[arg-type]


class _Server6(_Server):
    address_family = socket.AF_INET6


class LivePage:
    """HTTP server of the live page, in a thread; serves until closed.

    Args:
        next_picture: source of pictures, called from one thread per connection.
        port: port to listen on; 0 = any free port.
        host: address to listen on; 127.0.0.1 = only this machine.
        n_viewers: largest number of streams at a time; the next one is refused with status 503.
        boxes: returns the content of /boxes; empty = none.

    Attributes:
        url: address of the page on this machine.
        url_elsewhere: probable address on other machines if all interfaces are served; else None.
        is_private: whether only this machine is served.

    Raises:
        PageError: the port is in use, or the address does not belong to this machine.
    """

    def __init__(
        self,
        next_picture: NextPicture,
        port: int,
        *,
        host: str = LOOPBACK,
        n_viewers: int = DEFAULT_VIEWERS,
        boxes: Callable[[], bytes] = bytes,
    ) -> None:
        self.next_picture, self.boxes = next_picture, boxes
        self.is_private = _is_loopback(host)
        self.n_viewers = n_viewers
        self.free_streams = threading.BoundedSemaphore(n_viewers)
        server_class = _Server6 if ":" in host else _Server
        shown = f"[{host}]" if ":" in host else host
        try:
            self._server = server_class(
                (host, port), partial(_Handler, self), max_connections=n_viewers + _SPARE_CONNECTIONS
            )
        except OSError as error:
            raise PageError(
                f"--serve {shown}:{port}: cannot listen on this address ({error.strerror or error}); {_advice(error)}."
            ) from error
        port = self._server.server_address[1]
        self.url = f"http://{_LOCAL_NAMES.get(host, shown)}:{port}/"
        self.url_elsewhere = f"http://{socket.gethostname()}:{port}/" if host in _LOCAL_NAMES else None
        self._thread = threading.Thread(target=self._serve, name="live page", daemon=True)
        self._thread.start()

    def close(self) -> None:
        """End the server and its streams; may be called again."""
        self._server.shutdown()
        self._server.server_close()
        self._thread.join()

    def _serve(self) -> None:
        lower_thread_priority()  # also that of the connections' threads
        self._server.serve_forever(_POLL_S)


class _RequestTooLongError(ConnectionError):
    """The request has more than `_MAX_REQUEST_BYTES`."""


class _RequestReader(io.RawIOBase):
    """Reader of a request that limits its size and the time until it is complete.

    A timeout of the socket limits each read only, so that a client could send a byte every few seconds.
    """

    def __init__(self, connection: socket.socket) -> None:
        self._connection = connection
        self._end_s = time.monotonic() + _TIMEOUT_S
        self._n_bytes_left = _MAX_REQUEST_BYTES

    def readable(self) -> bool:
        return True

    def readinto(self, buffer: WriteableBuffer) -> int:
        left_s = self._end_s - time.monotonic()
        if left_s <= 0.0:
            raise TimeoutError
        if self._n_bytes_left <= 0:
            raise _RequestTooLongError
        self._connection.settimeout(left_s)
        n_bytes = self._connection.recv_into(buffer)
        self._connection.settimeout(_TIMEOUT_S)
        self._n_bytes_left -= n_bytes
        return n_bytes


class _Handler(BaseHTTPRequestHandler):
    """Handler of the request of one connection."""

    timeout = _TIMEOUT_S
    server_version, sys_version = "track-range", ""
    default_request_version = "HTTP/1.0"  # an answer to HTTP/0.9 would have no headers
    requestline = command = ""

    def __init__(self, page: LivePage, request: socket.socket, address: tuple[str, int], server: _Server) -> None:
        self._page = page
        super().__init__(request, address, server)

    def setup(self) -> None:
        """Open the connection, with limits on the request."""
        self.request.setsockopt(socket.SOL_SOCKET, socket.SO_SNDBUF, _SEND_BUFFER_BYTES)
        super().setup()
        self.rfile = io.BufferedReader(_RequestReader(self.connection), 8192)

    def handle(self) -> None:
        """Answer the request."""
        self.request_version = self.default_request_version
        self.close_connection = True
        try:
            self.handle_one_request()
        except _RequestTooLongError:
            self.send_error(HTTPStatus.REQUEST_HEADER_FIELDS_TOO_LARGE)

    def do_GET(self) -> None:
        """Answer a GET request."""
        if self._page.is_private and not self._is_for_loopback():
            self.send_error(HTTPStatus.FORBIDDEN)
            return
        answers = {
            "/": self._send_page,
            "/stream.mjpg": self._send_stream,
            "/frame.jpg": self._send_frame,
            "/state": self._send_state,
            "/boxes": self._send_boxes,
            "/favicon.ico": self._send_no_icon,
        }
        answer = answers.get(self.path.partition("?")[0])
        if answer is None:
            self.send_error(HTTPStatus.NOT_FOUND)
        else:
            answer()

    def do_HEAD(self) -> None:
        """Answer a HEAD request: like GET, but `_send` and `_send_stream` omit the body."""
        self.do_GET()

    def _is_for_loopback(self) -> bool:
        """Whether the request has one Host header, with a loopback name."""
        hosts = self.headers.get_all("Host", [])
        return len(hosts) == 1 and _is_loopback(_name_of_host(hosts[0]))

    def log_message(self, *_: object) -> None:
        """Log nothing, because the run uses the terminal."""

    def send_error(self, code: int, message: str | None = None, explain: str | None = None) -> None:
        """Answer with an error status and one sentence, without any text of the request."""
        status = HTTPStatus(code)
        sentence = explain if message is None and explain else f"{status.value} {status.phrase}"
        self._send("text/plain; charset=utf-8", sentence.encode(), status)

    def end_headers(self) -> None:
        """Send the headers of every answer."""
        for name, value in _HEADERS.items():
            self.send_header(name, value)
        self.send_header("Content-Security-Policy", _page()[1])
        super().end_headers()

    def _send_page(self) -> None:
        self._send("text/html; charset=utf-8", _page()[0])

    def _send_state(self) -> None:
        self._send("text/plain; charset=utf-8", b"live")

    def _send_boxes(self) -> None:
        boxes = self._page.boxes()
        self._send("application/json", boxes, HTTPStatus.OK if boxes else HTTPStatus.NO_CONTENT)

    def _send_no_icon(self) -> None:
        self._send("image/x-icon", b"", HTTPStatus.NO_CONTENT)  # browsers request it and report a missing one

    def _send_frame(self) -> None:
        picture = self._next_picture(0)
        if picture is None:
            self.send_error(HTTPStatus.SERVICE_UNAVAILABLE)
        else:
            self._send("image/jpeg", picture[0])

    def _send_stream(self) -> None:
        if not self._page.free_streams.acquire(blocking=False):
            n = self._page.n_viewers
            self.send_error(
                HTTPStatus.SERVICE_UNAVAILABLE,
                explain=f"All places for viewers ({n}) are taken; close another view, or raise --viewers.",
            )
            return
        try:
            self._start_answer(f"multipart/x-mixed-replace; boundary={_BOUNDARY}")
            if self.command != "HEAD":
                self._stream()
        finally:
            self._page.free_streams.release()

    def _stream(self) -> None:
        number = 0
        while picture := self._next_picture(number):
            jpeg, number = picture
            head = f"--{_BOUNDARY}\r\nContent-Type: image/jpeg\r\nContent-Length: {len(jpeg)}\r\n\r\n"
            self.wfile.write(head.encode() + jpeg + b"\r\n")
        self.wfile.write(f"--{_BOUNDARY}--\r\n".encode())

    def _next_picture(self, number: int) -> tuple[bytes, int] | None:
        """The next picture after `number`, and its number; None at the end of the run.

        Raises:
            ConnectionAbortedError: the client has disconnected.
        """
        while (picture := self._page.next_picture(number, _DISCONNECT_POLL_S)) and not picture[0]:
            self._check_connected()
        return picture

    def _check_connected(self) -> None:
        self.connection.setblocking(False)
        try:
            if not self.connection.recv(1, socket.MSG_PEEK):
                raise ConnectionAbortedError
        except BlockingIOError:
            pass  # connected, and nothing more received
        finally:
            self.connection.settimeout(_TIMEOUT_S)

    def _send(self, kind: str, body: bytes, status: HTTPStatus = HTTPStatus.OK) -> None:
        self._start_answer(kind, length=len(body), status=status)
        if self.command != "HEAD":
            self.wfile.write(body)

    def _start_answer(self, kind: str, *, length: int | None = None, status: HTTPStatus = HTTPStatus.OK) -> None:
        self.send_response(status)
        self.send_header("Content-Type", kind)
        if length is not None:
            self.send_header("Content-Length", str(length))
        self.send_header("Connection", "close")
        self.end_headers()


@cache
def _page() -> tuple[bytes, str]:
    """The page, and the Content-Security-Policy that allows only its own style and script."""
    page = files("track_range.views.live_view").joinpath("live_page.html").read_text(encoding="utf-8")
    hashes = {
        tag: b64encode(sha256("".join(re.findall(f"<{tag}>(.*?)</{tag}>", page, re.DOTALL)).encode()).digest()).decode()
        for tag in ("style", "script")
    }
    policy = (
        f"default-src 'none'; img-src 'self'; connect-src 'self'; style-src 'sha256-{hashes['style']}'; "
        f"script-src 'sha256-{hashes['script']}'; base-uri 'none'; form-action 'none'; frame-ancestors 'none'"
    )
    return page.encode(), policy


_REFUSAL = (
    "HTTP/1.0 503 Service Unavailable\r\nContent-Type: text/plain; charset=utf-8\r\n"
    + "".join(f"{name}: {value}\r\n" for name, value in _HEADERS.items())
    + "Content-Security-Policy: default-src 'none'\r\nConnection: close\r\n\r\nToo many connections.\n"
).encode()
"""Answer to a connection for which there is no thread."""


def _advice(error: OSError) -> str:
    if isinstance(error, socket.gaierror) or error.errno == errno.EADDRNOTAVAIL:
        return "give an address of this machine, such as 0.0.0.0 for all interfaces"
    return "choose a port above 1023" if error.errno == errno.EACCES else "choose another port"


def _name_of_host(header: str) -> str:
    """Host name of a Host header, without the port."""
    name = header.rpartition(":")[0] if header.rpartition(":")[2].isdigit() else header
    return name.strip("[]")


def _is_loopback(host: str) -> bool:
    """Whether a host name or address is a loopback address."""
    try:
        return ip_address(host).is_loopback
    except ValueError:
        return host.lower() == "localhost"
