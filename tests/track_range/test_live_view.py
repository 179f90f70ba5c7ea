"""The live page: what it answers, to whom, and that it never holds a run up."""

from __future__ import annotations

import http.client
import socket
import threading
from collections.abc import Iterator

import cv2
import numpy as np
import pytest

from tests.track_range.overlay_results import grey, result
from track_range.foundation.arrays import Image
from track_range.foundation.errors import UsageError
from track_range.live_view.server import PageError
from track_range.live_view.view import LiveView, has_screen, open_view, parse_address
from track_range.run.frame_result import FrameResult


@pytest.fixture
def view() -> Iterator[LiveView]:
    with LiveView("127.0.0.1", 0) as opened:
        yield opened


def ask(view: LiveView, path: str, *, host: str | None = None) -> http.client.HTTPResponse:
    port = int(view.page.url.rstrip("/").rpartition(":")[2])
    connection = http.client.HTTPConnection("127.0.0.1", port, timeout=20)
    connection.request("GET", path, headers={} if host is None else {"Host": host})
    return connection.getresponse()


def told(view: LiveView, path: str, *, host: str | None = None) -> tuple[int, bytes]:
    with ask(view, path, host=host) as answer:
        return answer.status, answer.read()


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


def test_the_page_shows_the_stream_and_needs_nothing_from_elsewhere(view: LiveView) -> None:
    status, page = told(view, "/")
    assert status == 200
    assert b"/stream.mjpg" in page
    assert b"://" not in page
    assert told(view, "/state") == (200, b"live")
    assert told(view, "/elsewhere")[0] == 404


def test_the_newest_picture_is_shown_and_older_ones_are_never_drawn(view: LiveView) -> None:
    drawn: list[int] = []

    def draw(found: FrameResult) -> Image:
        drawn.append(int(found.frame.left.mean()))
        return found.frame.left

    assert view.page.url in view.begin(draw)
    for level in (40, 80, 120):
        view.offer(shade(level))
    assert drawn == []
    assert level_of(told(view, "/frame.jpg")[1]) == 120
    assert level_of(told(view, "/frame.jpg?again")[1]) == 120
    assert drawn == [120]


def test_a_stream_follows_the_run_and_ends_with_it() -> None:
    with LiveView("127.0.0.1", 0) as view:
        view.offer(shade(40))
        with ask(view, "/stream.mjpg") as stream, ask(view, "/stream.mjpg") as other:
            assert stream.headers["Content-Type"] == "multipart/x-mixed-replace; boundary=picture"
            assert [level_of(next_part(stream)), level_of(next_part(other))] == [40, 40]
            view.offer(shade(200))
            assert [level_of(next_part(stream)), level_of(next_part(other))] == [200, 200]
            view.__exit__(None, None, None)
            assert [next_part(stream), next_part(other)] == [b"", b""]


def test_who_waits_for_a_first_picture_is_told_when_there_will_be_none() -> None:
    answers: list[int] = []
    with LiveView("127.0.0.1", 0) as view:
        port = int(view.page.url.rstrip("/").rpartition(":")[2])
        connection = http.client.HTTPConnection("127.0.0.1", port, timeout=20)
        connection.request("GET", "/frame.jpg")
        waiting = threading.Thread(target=lambda: answers.append(connection.getresponse().status))
        waiting.start()
        told(view, "/state")  # the request before this one has been taken by now
    waiting.join(20)
    connection.close()
    assert answers == [503]


def test_a_viewer_who_reads_nothing_does_not_hold_up_the_run(view: LiveView) -> None:
    view.begin(lambda found: found.frame.left)
    with ask(view, "/stream.mjpg"):
        noise = np.random.default_rng(1).integers(0, 255, (600, 800, 3), np.uint8)
        for _ in range(200):
            view.offer(result([], image=noise))


def test_only_this_machines_names_are_answered(view: LiveView) -> None:
    for host in ("127.0.0.1", "127.0.0.1:8000", "localhost:80", "LOCALHOST", "[::1]:9"):
        assert told(view, "/state", host=host)[0] == 200
    for host in ("evil.example", "evil.example:8000", "10.0.0.7", ""):
        assert told(view, "/state", host=host)[0] == 403


def test_all_names_are_answered_where_others_are_to_see_it() -> None:
    with LiveView("0.0.0.0", 0) as view:  # noqa: S104 - what the test is about
        assert told(view, "/state", host="car.example")[0] == 200
        port = view.page.url.rstrip("/").rpartition(":")[2]
        words = view.begin(lambda _: grey())
    assert view.page.url == f"http://127.0.0.1:{port}/"  # 0.0.0.0 cannot be opened
    assert f"http://{socket.gethostname()}:{port}/ on other machines" in words


def test_a_port_in_use_is_one_sentence(view: LiveView) -> None:
    port = int(view.page.url.rstrip("/").rpartition(":")[2])
    with pytest.raises(PageError, match=rf"^--serve 127\.0\.0\.1:{port}: .*in use"):
        LiveView("127.0.0.1", port)


def test_an_address_that_is_not_this_machines_is_one_sentence() -> None:
    with pytest.raises(PageError, match=r"^--serve 192\.0\.2\.1:8000: .*address"):
        LiveView("192.0.2.1", 8000)


def test_a_name_that_nobody_knows_is_one_sentence() -> None:
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
def test_where_the_page_goes(text: str, place: tuple[str, int]) -> None:
    assert parse_address(text) == place


@pytest.mark.parametrize("text", ["", "port", "70000", "host:", "http://x:80", "8000:8000:", "-1"])
def test_what_is_no_place_is_wrong_usage(text: str) -> None:
    with pytest.raises(UsageError, match=r"^--serve: "):
        parse_address(text)


def test_a_view_is_opened_only_when_wanted(monkeypatch: pytest.MonkeyPatch) -> None:
    assert open_view(show=False, serve=None) is None
    for name in ("DISPLAY", "WAYLAND_DISPLAY"):
        monkeypatch.delenv(name, raising=False)
    shown = open_view(show=True, serve=None)
    assert shown is not None
    with shown as view:
        assert view.page.url.startswith("http://127.0.0.1:")
        assert "open http" in view.begin(lambda _: grey())


@pytest.mark.skipif("sys.platform != 'linux'", reason="elsewhere there always is a screen")
def test_a_screen_is_known_by_its_variables(monkeypatch: pytest.MonkeyPatch) -> None:
    for name in ("DISPLAY", "WAYLAND_DISPLAY"):
        monkeypatch.delenv(name, raising=False)
    assert not has_screen()
    monkeypatch.setenv("WAYLAND_DISPLAY", "wayland-0")
    assert has_screen()
