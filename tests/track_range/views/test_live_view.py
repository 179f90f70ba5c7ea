"""The live page: answers, access, and no delay of the run."""

from __future__ import annotations

import http.client
import json
import socket
import threading
import time
from collections.abc import Callable, Iterator
from contextlib import ExitStack, suppress

import cv2
import numpy as np
import pytest

from tests.support.results.overlay_results import grey, result
from track_range.foundation.arrays import Image
from track_range.foundation.errors import UsageError
from track_range.pipeline.frame_result import FrameResult
from track_range.views.live_view import server
from track_range.views.live_view.server import PageError
from track_range.views.live_view.view import LiveView, has_screen, open_view, parse_address


@pytest.fixture
def view() -> Iterator[LiveView]:
    with LiveView("127.0.0.1", 0) as opened:
        yield opened


def port_of(view: LiveView) -> int:
    return int(view.page.url.rstrip("/").rpartition(":")[2])


def ask(view: LiveView, path: str, *, host: str | None = None) -> http.client.HTTPResponse:
    connection = http.client.HTTPConnection("127.0.0.1", port_of(view), timeout=20)
    connection.request("GET", path, headers={} if host is None else {"Host": host})
    return connection.getresponse()


def get(view: LiveView, path: str, *, host: str | None = None) -> tuple[int, bytes]:
    with ask(view, path, host=host) as answer:
        return answer.status, answer.read()


def wait_until(condition: Callable[[], bool]) -> None:
    for _ in range(2000):
        if condition():
            return
        time.sleep(0.01)
    pytest.fail("the condition was not met within 20 s")


def shade(level: int) -> FrameResult:
    return result([], image=np.full((48, 64, 3), level, np.uint8))


def level_of(jpeg: bytes) -> int:
    return round(float(cv2.imdecode(np.frombuffer(jpeg, np.uint8), cv2.IMREAD_COLOR).mean()))


def next_part(stream: http.client.HTTPResponse) -> bytes:
    """The next picture of a stream; empty = there are no more."""
    length = 0
    while (line := stream.readline().strip()) != b"":
        if line == b"--picture--":
            return b""
        if line.startswith(b"Content-Length:"):
            length = int(line.split()[1])
    picture = stream.read(length)
    stream.readline()
    return picture


def test_page_is_self_contained(view: LiveView) -> None:
    status, page = get(view, "/")
    assert status == 200
    assert b"/stream.mjpg" in page
    assert b"://" not in page
    assert get(view, "/state") == (200, b"live")
    assert get(view, "/elsewhere")[0] == 404


def test_only_the_newest_picture_is_drawn(view: LiveView) -> None:
    drawn: list[int] = []

    def draw(shown: FrameResult) -> Image:
        drawn.append(int(shown.frame.left.mean()))
        return shown.frame.left

    assert view.page.url in view.begin(draw)
    for level in (40, 80, 120):
        view.offer(shade(level))
    assert drawn == []
    assert level_of(get(view, "/frame.jpg")[1]) == 120
    assert level_of(get(view, "/frame.jpg?again")[1]) == 120
    assert drawn == [120]


def test_stream_follows_the_run() -> None:
    with LiveView("127.0.0.1", 0) as view:
        view.offer(shade(40))
        with ask(view, "/stream.mjpg") as stream, ask(view, "/stream.mjpg") as other:
            assert stream.headers["Content-Type"] == "multipart/x-mixed-replace; boundary=picture"
            assert [level_of(next_part(stream)), level_of(next_part(other))] == [40, 40]
            view.offer(shade(200))
            assert [level_of(next_part(stream)), level_of(next_part(other))] == [200, 200]
            view.__exit__(None, None, None)
            assert [next_part(stream), next_part(other)] == [b"", b""]


def test_request_without_any_picture_fails() -> None:
    answers: list[int] = []
    with LiveView("127.0.0.1", 0) as view:
        connection = http.client.HTTPConnection("127.0.0.1", port_of(view), timeout=20)
        connection.request("GET", "/frame.jpg")
        waiting = threading.Thread(target=lambda: answers.append(connection.getresponse().status))
        waiting.start()
        get(view, "/state")  # the request before this one has been taken by now
    waiting.join(20)
    connection.close()
    assert answers == [503]


def test_stalled_viewer_does_not_block_the_run(view: LiveView) -> None:
    view.begin(lambda shown: shown.frame.left)
    noise = np.random.default_rng(1).integers(0, 255, (600, 800, 3), np.uint8)

    def offer() -> None:
        for _ in range(200):
            view.offer(result([], image=noise))

    with ask(view, "/stream.mjpg"):
        run = threading.Thread(target=offer, daemon=True)
        run.start()
        run.join(20)
        assert not run.is_alive()


def test_only_loopback_names_are_answered(view: LiveView) -> None:
    for host in ("127.0.0.1", "127.0.0.1:8000", "localhost:80", "LOCALHOST", "[::1]:9"):
        assert get(view, "/state", host=host)[0] == 200
    for host in ("evil.example", "evil.example:8000", "10.0.0.7", ""):
        assert get(view, "/state", host=host)[0] == 403


def test_all_names_are_answered_on_all_interfaces() -> None:
    with LiveView("0.0.0.0", 0) as view:  # noqa: S104 - what the test is about
        assert get(view, "/state", host="car.example")[0] == 200
        port = view.page.url.rstrip("/").rpartition(":")[2]
        words = view.begin(lambda _: grey())
    assert view.page.url == f"http://127.0.0.1:{port}/"  # 0.0.0.0 cannot be opened
    assert f"http://{socket.gethostname()}:{port}/ on other machines" in words


def test_port_in_use(view: LiveView) -> None:
    port = port_of(view)
    with pytest.raises(PageError, match=rf"^--serve 127\.0\.0\.1:{port}: .*in use"):
        LiveView("127.0.0.1", port)


def test_address_of_another_machine() -> None:
    with pytest.raises(PageError, match=r"^--serve 192\.0\.2\.1:8000: .*address"):
        LiveView("192.0.2.1", 8000)


def test_unknown_host_name() -> None:
    with pytest.raises(PageError, match="no such name"):
        LiveView("no such name", 8000)


@pytest.mark.parametrize(
    ("text", "place"),
    [
        ("8000", ("127.0.0.1", 8000)),
        ("0", ("127.0.0.1", 0)),
        ("0.0.0.0:80", ("0.0.0.0", 80)),  # noqa: S104 - what the test is about
        ("[::1]:8000", ("::1", 8000)),
        ("my-car:8000", ("my-car", 8000)),
    ],
)
def test_parse_address(text: str, place: tuple[str, int]) -> None:
    assert parse_address(text) == place


@pytest.mark.parametrize("text", ["", "port", "70000", "host:", "http://x:80", "8000:8000:", "-1"])
def test_invalid_addresses(text: str) -> None:
    with pytest.raises(UsageError, match=r"^--serve: "):
        parse_address(text)


def test_view_is_opened_only_on_request(monkeypatch: pytest.MonkeyPatch) -> None:
    assert open_view(show=False, serve=None) is None
    for name in ("DISPLAY", "WAYLAND_DISPLAY"):
        monkeypatch.delenv(name, raising=False)
    shown = open_view(show=True, serve=None)
    assert shown is not None
    with shown as view:
        assert view.page.url.startswith("http://127.0.0.1:")
        assert "open http" in view.begin(lambda _: grey())


@pytest.mark.skipif("sys.platform != 'linux'", reason="elsewhere there always is a screen")
def test_screen_is_detected_from_the_environment(monkeypatch: pytest.MonkeyPatch) -> None:
    for name in ("DISPLAY", "WAYLAND_DISPLAY"):
        monkeypatch.delenv(name, raising=False)
    assert not has_screen()
    monkeypatch.setenv("WAYLAND_DISPLAY", "wayland-0")
    assert has_screen()


def raw(view: LiveView, request: bytes) -> bytes:
    """The whole answer to bytes sent as they are; empty if the connection is closed without one."""
    with socket.create_connection(("127.0.0.1", port_of(view)), timeout=20) as connection:
        # the server may refuse the request and disconnect before all of it is sent
        with suppress(OSError):
            connection.sendall(request)
            connection.shutdown(socket.SHUT_WR)
        answer = b""
        with suppress(ConnectionError):
            while received := connection.recv(65536):
                answer += received
        return answer


@pytest.mark.parametrize(
    "request_line",
    [
        b"GET / HTTP/1.1",
        b"HEAD / HTTP/1.1",
        b"GET /nothing HTTP/1.1",
        b"GET /state HTTP/9.9",
        b"GET /state",
        b"POST / HTTP/1.1",
        b"\x16\x03\x01\x02",
        b"GET / x y HTTP/1.1",
    ],
)
def test_headers_of_every_answer(view: LiveView, request_line: bytes) -> None:
    head = (
        raw(view, request_line + b"\r\nHost: localhost\r\n\r\n").partition(b"\r\n\r\n")[0].decode()
    )
    headers = dict(line.split(": ", 1) for line in head.splitlines()[1:])
    assert headers["X-Content-Type-Options"] == "nosniff"
    assert headers["Cross-Origin-Resource-Policy"] == "same-origin"
    assert headers["Referrer-Policy"] == "no-referrer"
    assert headers["X-Frame-Options"] == "DENY"
    assert "default-src 'none'" in headers["Content-Security-Policy"]
    assert "frame-ancestors 'none'" in headers["Content-Security-Policy"]
    assert "unsafe" not in headers["Content-Security-Policy"]


@pytest.mark.parametrize("path", ["/", "/state", "/frame.jpg", "/stream.mjpg", "/nothing"])
def test_head_request(view: LiveView, path: str) -> None:
    view.offer(shade(40))
    answered, headers_of = {}, {}
    for method in ("GET", "HEAD"):
        connection = http.client.HTTPConnection("127.0.0.1", port_of(view), timeout=20)
        connection.request(method, path)
        with connection.getresponse() as answer:
            answered[method] = answer.status
            headers_of[method] = {
                name: value for name, value in answer.getheaders() if name != "Date"
            }
            if method == "HEAD":
                assert answer.read() == b""
        connection.close()
    assert answered["HEAD"] == answered["GET"]
    assert headers_of["HEAD"] == headers_of["GET"]


@pytest.mark.parametrize(
    ("request_bytes", "status"),
    [
        (b"GET /" + b"a" * 70_000 + b" HTTP/1.1\r\n\r\n", b"414"),
        (b"GET / HTTP/1.1\r\nX: " + b"a" * 70_000 + b"\r\n\r\n", b"431"),
        (b"GET / HTTP/1.1\r\n" + b"X: y\r\n" * 101 + b"\r\n", b"431"),
        (b"GET / HTTP/1.1\r\n" + (b"X: " + b"a" * 60_000 + b"\r\n") * 3, b"431"),
        (b"DELETE / HTTP/1.1\r\n\r\n", b"501"),
        (bytes(range(256)) * 4 + b"\r\n\r\n", b"400"),
    ],
)
def test_hostile_requests(
    view: LiveView, capfd: pytest.CaptureFixture[str], request_bytes: bytes, status: bytes
) -> None:
    answer = raw(view, request_bytes)
    # the answer is lost if the client is still sending
    assert answer == b"" or answer.split()[1] == status
    assert get(view, "/state") == (200, b"live")
    assert capfd.readouterr().err == ""


@pytest.mark.parametrize(
    ("request_bytes", "status"),
    [
        (b"GET / x y HTTP/1.1\r\n", b"400"),
        (b"GET / HTTP/9.9\r\n", b"505"),
        (b"GET /".ljust(65_537, b"a"), b"414"),
        (b"GET / HTTP/1.1\r\n" + b"X: ".ljust(65_537, b"a"), b"431"),
        (b"GET / HTTP/1.1\r\n" + b"X: y\r\n" * 101, b"431"),
        (
            b"GET / HTTP/1.1\r\n"
            + (b"X: ".ljust(60_000, b"a") + b"\r\n") * 2
            + b"X: ".ljust(11_052, b"a"),
            b"431",
        ),
        (b"GET /state HTTP/1.1\nHost: localhost\n\n", b"200"),
    ],
)
def test_answer_comes_without_waiting_for_more(request_bytes: bytes, status: bytes) -> None:
    """A request that cannot become valid is refused before its end, and a blank line ends the
    others."""
    with (
        LiveView("127.0.0.1", 0, timeout_s=60.0) as view,
        socket.create_connection(("127.0.0.1", port_of(view))) as connection,
    ):
        connection.settimeout(20.0)
        connection.sendall(request_bytes)
        assert connection.recv(65536).split()[1] == status


def test_unfinished_request_is_dropped() -> None:
    """A client that sends a byte at a time has no more time than one that sends nothing."""
    with (
        LiveView("127.0.0.1", 0, timeout_s=0.3) as view,
        socket.create_connection(("127.0.0.1", port_of(view))) as connection,
    ):
        connection.settimeout(0.05)
        connection.sendall(b"GET /state HTTP/1.1\r\n")
        for _ in range(400):
            with suppress(TimeoutError, ConnectionError):
                connection.sendall(b"X")
                if not connection.recv(1):
                    return
        pytest.fail("the connection is still open")


def test_viewers_are_limited() -> None:
    with LiveView("127.0.0.1", 0, n_viewers=2) as view:
        view.offer(shade(40))
        with ask(view, "/stream.mjpg") as first, ask(view, "/stream.mjpg") as second:
            assert next_part(first)
            assert next_part(second)
            status, sentence = get(view, "/stream.mjpg")
            assert status == 503
            assert b"2" in sentence
            assert b"--viewers" in sentence
            assert get(view, "/frame.jpg")[0] == 200  # only streams are counted
        wait_until(lambda: view.page.free_streams.acquire(blocking=False))


def test_connections_are_limited(view: LiveView) -> None:
    n_before = threading.active_count()
    with ExitStack() as opened:
        for _ in range(100):
            connection = opened.enter_context(
                socket.create_connection(("127.0.0.1", port_of(view)), timeout=20)
            )
        received = connection.recv(4096)
        assert received.startswith(b"HTTP/1.0 503 ")
        assert b"nosniff" in received
        assert threading.active_count() - n_before <= server.DEFAULT_VIEWERS + 32
    wait_until(lambda: threading.active_count() <= n_before)
    assert get(view, "/state") == (200, b"live")


def test_viewer_that_reads_nothing_is_dropped() -> None:
    noise = np.random.default_rng(1).integers(0, 255, (600, 800, 3), np.uint8)
    with (
        LiveView("127.0.0.1", 0, n_viewers=1, timeout_s=0.2) as view,
        ask(view, "/stream.mjpg"),
    ):
        view.begin(lambda shown: shown.frame.left)

        def is_free() -> bool:
            view.offer(result([], image=noise))
            return view.page.free_streams.acquire(blocking=False)

        wait_until(is_free)


def test_two_host_headers(view: LiveView) -> None:
    answer = raw(
        view,
        b"GET /state HTTP/1.1\r\nHost: localhost\r\nHost: other.example\r\nConnection: close\r\n\r\n",
    )
    assert b" 403 " in answer.partition(b"\r\n")[0]


def test_boxes_for_known_distances(view: LiveView) -> None:
    assert get(view, "/boxes") == (204, b"")
    view.offer(result([[4.0, 5.2, 30.0, 25.0]]))
    assert get(view, "/boxes") == (204, b"")  # not a recording without a calibration
    view.begin(lambda shown: shown.frame.left, video="drive.mp4")
    status, content = get(view, "/boxes")
    assert status == 200
    assert json.loads(content)["video"] == "drive.mp4"
    assert json.loads(content)["boxes"] == [{"name": "car", "xyxy": [4, 5, 30, 25]}]
