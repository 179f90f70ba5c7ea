"""LivePage: a page that shows the newest picture of a run, as a stream of JPEG images (MJPEG).

/             the page              Unless told otherwise only this machine is answered, and only by names of its own,
/stream.mjpg  every new picture     so that no web page that the user happens to look at can read the pictures.
/frame.jpg    the newest one
/state        whether the run goes on
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

_PATIENCE_S = 5.0  # a viewer who takes nothing for so long is gone
_POLL_S = 0.1  # how soon the server notices that it is to end
_BOUNDARY = "picture"
LOOPBACK = "127.0.0.1"
_HERE = {"0.0.0.0": LOOPBACK, "::": "[::1]"}  # noqa: S104 - all addresses of this machine, and one to call it by


class PageError(ConfigError):
    """The page cannot be served where it was asked for."""


NextPicture = Callable[[int], tuple[bytes, int]]
"""The newest JPEG picture and its number, once there is one after the number given; empty = there will be none."""


class _Server(ThreadingHTTPServer):
    daemon_threads = True
    block_on_close = False  # a viewer who takes nothing would keep the run from ending

    def server_bind(self) -> None:
        TCPServer.server_bind(
            self
        )  # http.server's own asks the network for a name of this machine, which can take long

    def handle_error(self, request: object, client_address: object) -> None:
        if not isinstance(sys.exception(), ConnectionError | TimeoutError):  # viewers come and go
            super().handle_error(request, client_address)  # type: ignore[arg-type]


class LivePage:
    """Serves until closed.

    Args:
        next_picture: called from a thread per viewer.
        port: 0 = any that is free.
        host: the address to listen on; 127.0.0.1 = this machine alone.

    Attributes:
        url: where the page is, as this machine sees it.
        url_elsewhere: as other machines probably see it, where it is served on all of this one's addresses; else None.
        is_private: whether it is for this machine alone.

    Raises:
        PageError: the port is taken, or the address is not this machine's.
    """

    def __init__(self, next_picture: NextPicture, port: int, *, host: str = LOOPBACK) -> None:
        self.next_picture = next_picture
        self.is_private = _is_loopback(host)
        kind = _Server6 if ":" in host else _Server
        shown = f"[{host}]" if ":" in host else host
        try:
            self._server = kind((host, port), partial(_Viewer, self))
        except OSError as error:
            raise PageError(
                f"--serve {shown}:{port}: cannot be served there ({error.strerror or error}); {_advice(error)}."
            ) from error
        port = self._server.server_address[1]
        self.url = f"http://{_HERE.get(host, shown)}:{port}/"
        self.url_elsewhere = f"http://{gethostname()}:{port}/" if host in _HERE else None
        self._thread = threading.Thread(
            target=self._server.serve_forever, args=(_POLL_S,), name="live page", daemon=True
        )
        self._thread.start()

    def close(self) -> None:
        """End the server; streams end with their pictures. May be called again."""
        self._server.shutdown()
        self._server.server_close()
        self._thread.join()


class _Server6(_Server):
    address_family = AF_INET6


class _Viewer(BaseHTTPRequestHandler):
    """Answers one browser."""

    timeout = _PATIENCE_S
    server_version, sys_version = "track-range", ""

    def __init__(self, page: LivePage, request: socket, address: tuple[str, int], server: _Server) -> None:
        self._page = page
        super().__init__(request, address, server)

    def do_GET(self) -> None:
        """Answer a request, as `http.server` calls it."""
        if self._page.is_private and not _is_loopback(_name_of_host(self.headers.get("Host", ""))):
            self.send_error(HTTPStatus.FORBIDDEN)
            return
        answers = {
            "/": self._page_itself,
            "/stream.mjpg": self._stream,
            "/frame.jpg": self._frame,
            "/state": self._state,
        }
        answer = answers.get(self.path.partition("?")[0])
        try:
            if answer is None:
                self.send_error(HTTPStatus.NOT_FOUND)
            else:
                answer()
        except (ConnectionError, TimeoutError):
            self.close_connection = True  # the viewer has gone

    def log_message(self, *_: object) -> None:
        """Say nothing: the terminal belongs to the run."""

    def _page_itself(self) -> None:
        self._send("text/html; charset=utf-8", files("track_range.live_view").joinpath("live_page.html").read_bytes())

    def _state(self) -> None:
        self._send("text/plain", b"live")

    def _frame(self) -> None:
        jpeg, _ = self._page.next_picture(0)
        if jpeg:
            self._send("image/jpeg", jpeg)
        else:
            self.send_error(HTTPStatus.SERVICE_UNAVAILABLE)

    def _stream(self) -> None:
        self._begin(f"multipart/x-mixed-replace; boundary={_BOUNDARY}")
        jpeg, number = self._page.next_picture(0)
        while jpeg:
            head = f"--{_BOUNDARY}\r\nContent-Type: image/jpeg\r\nContent-Length: {len(jpeg)}\r\n\r\n"
            self.wfile.write(head.encode() + jpeg + b"\r\n")
            jpeg, number = self._page.next_picture(number)
        self.wfile.write(f"--{_BOUNDARY}--\r\n".encode())

    def _send(self, kind: str, body: bytes) -> None:
        self._begin(kind, length=len(body))
        self.wfile.write(body)

    def _begin(self, kind: str, *, length: int | None = None) -> None:
        self.send_response(HTTPStatus.OK)
        self.send_header("Content-Type", kind)
        self.send_header("Cache-Control", "no-store")
        if length is not None:
            self.send_header("Content-Length", str(length))
        self.end_headers()


def _advice(error: OSError) -> str:
    if isinstance(error, gaierror) or error.errno == errno.EADDRNOTAVAIL:
        return "give an address of this machine, such as 0.0.0.0 for all of them"
    return "choose a port from 1024 on" if error.errno == errno.EACCES else "choose another port"


def _name_of_host(header: str) -> str:
    """The host of a Host header, without its port."""
    name = header.rpartition(":")[0] if header.rpartition(":")[2].isdigit() else header
    return name.strip("[]")


def _is_loopback(host: str) -> bool:
    """Whether a name means this machine, seen from itself."""
    try:
        return ip_address(host).is_loopback
    except ValueError:
        return host.lower() == "localhost"
