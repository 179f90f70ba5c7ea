"""LivePage: HTTP server of a page with the newest picture of a run, as a stream of JPEG images (MJPEG).

/             the page
/stream.mjpg  every new picture
/frame.jpg    the newest picture
/state        "live" while the run is in progress

By default only this machine is served, and only under loopback names, so that other web pages cannot read the pictures
(DNS rebinding).
"""

from __future__ import annotations

import errno
import sys
import threading
from collections.abc import Callable
from functools import partial
from http import HTTPStatus
from http.server import BaseHTTPRequestHandler, ThreadingHTTPServer
from importlib.resources import files
from ipaddress import ip_address
from socket import AF_INET6, gaierror, gethostname, socket
from socketserver import TCPServer

from track_range.foundation.errors import ConfigError

_TIMEOUT_S = 5.0
"""Seconds after which a connection that accepts no data is closed."""

_POLL_S = 0.1
"""Seconds between checks of whether the server is to end."""

_BOUNDARY = "picture"
"""Boundary of the parts of the MJPEG stream."""

LOOPBACK = "127.0.0.1"

_LOCAL_NAMES = {"0.0.0.0": LOOPBACK, "::": "[::1]"}  # noqa: S104
"""Loopback address, by the address that means all interfaces of this machine."""


class PageError(ConfigError):
    """The page cannot be served at the given address."""


NextPicture = Callable[[int], tuple[bytes, int]]
"""Waits for a picture after the given number; returns it as JPEG with its number, or empty bytes at the end."""


class _Server(ThreadingHTTPServer):
    daemon_threads = True
    block_on_close = False  # a stalled connection must not delay the end of the run

    def server_bind(self) -> None:
        # not http.server's method, whose reverse DNS lookup can take long
        TCPServer.server_bind(self)

    def handle_error(self, request: object, client_address: object) -> None:
        if not isinstance(sys.exception(), ConnectionError | TimeoutError):  # browsers may disconnect at any time
            super().handle_error(request, client_address)  # type: ignore[arg-type]


class LivePage:
    """HTTP server of the live page, in a thread; serves until closed.

    Args:
        next_picture: source of pictures, called from one thread per connection.
        port: port to listen on; 0 = any free port.
        host: address to listen on; 127.0.0.1 = only this machine.

    Attributes:
        url: address of the page on this machine.
        url_elsewhere: probable address on other machines if all interfaces are served; else None.
        is_private: whether only this machine is served.

    Raises:
        PageError: the port is in use, or the address does not belong to this machine.
    """

    def __init__(self, next_picture: NextPicture, port: int, *, host: str = LOOPBACK) -> None:
        self.next_picture = next_picture
        self.is_private = _is_loopback(host)
        server_class = _Server6 if ":" in host else _Server
        shown = f"[{host}]" if ":" in host else host
        try:
            self._server = server_class((host, port), partial(_Handler, self))
        except OSError as error:
            raise PageError(
                f"--serve {shown}:{port}: cannot listen on this address ({error.strerror or error}); {_advice(error)}."
            ) from error
        port = self._server.server_address[1]
        self.url = f"http://{_LOCAL_NAMES.get(host, shown)}:{port}/"
        self.url_elsewhere = f"http://{gethostname()}:{port}/" if host in _LOCAL_NAMES else None
        self._thread = threading.Thread(
            target=self._server.serve_forever, args=(_POLL_S,), name="live page", daemon=True
        )
        self._thread.start()

    def close(self) -> None:
        """End the server and its streams; may be called again."""
        self._server.shutdown()
        self._server.server_close()
        self._thread.join()


class _Server6(_Server):
    address_family = AF_INET6


class _Handler(BaseHTTPRequestHandler):
    """Handler of the requests of one connection."""

    timeout = _TIMEOUT_S
    server_version, sys_version = "track-range", ""

    def __init__(self, page: LivePage, request: socket, address: tuple[str, int], server: _Server) -> None:
        self._page = page
        super().__init__(request, address, server)

    def do_GET(self) -> None:
        """Answer a GET request."""
        if self._page.is_private and not _is_loopback(_name_of_host(self.headers.get("Host", ""))):
            self.send_error(HTTPStatus.FORBIDDEN)
            return
        answers = {
            "/": self._send_page,
            "/stream.mjpg": self._send_stream,
            "/frame.jpg": self._send_frame,
            "/state": self._send_state,
        }
        answer = answers.get(self.path.partition("?")[0])
        try:
            if answer is None:
                self.send_error(HTTPStatus.NOT_FOUND)
            else:
                answer()
        except (ConnectionError, TimeoutError):
            self.close_connection = True  # the browser has disconnected

    def log_message(self, *_: object) -> None:
        """Log nothing, because the run uses the terminal."""

    def _send_page(self) -> None:
        self._send("text/html; charset=utf-8", files("track_range.live_view").joinpath("live_page.html").read_bytes())

    def _send_state(self) -> None:
        self._send("text/plain", b"live")

    def _send_frame(self) -> None:
        jpeg, _ = self._page.next_picture(0)
        if jpeg:
            self._send("image/jpeg", jpeg)
        else:
            self.send_error(HTTPStatus.SERVICE_UNAVAILABLE)

    def _send_stream(self) -> None:
        self._start_answer(f"multipart/x-mixed-replace; boundary={_BOUNDARY}")
        jpeg, number = self._page.next_picture(0)
        while jpeg:
            head = f"--{_BOUNDARY}\r\nContent-Type: image/jpeg\r\nContent-Length: {len(jpeg)}\r\n\r\n"
            self.wfile.write(head.encode() + jpeg + b"\r\n")
            jpeg, number = self._page.next_picture(number)
        self.wfile.write(f"--{_BOUNDARY}--\r\n".encode())

    def _send(self, kind: str, body: bytes) -> None:
        self._start_answer(kind, length=len(body))
        self.wfile.write(body)

    def _start_answer(self, kind: str, *, length: int | None = None) -> None:
        self.send_response(HTTPStatus.OK)
        self.send_header("Content-Type", kind)
        self.send_header("Cache-Control", "no-store")
        if length is not None:
            self.send_header("Content-Length", str(length))
        self.end_headers()


def _advice(error: OSError) -> str:
    if isinstance(error, gaierror) or error.errno == errno.EADDRNOTAVAIL:
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
