"""LiveView: the overlay while a run goes on, in a browser: the newest frame only, drawn when somebody asks for it.

results --> [ the newest ] <-- viewers' threads: draw, once for all of them         offering a result never waits
"""

from __future__ import annotations

import os
import re
import sys
import threading
import webbrowser
from collections.abc import Callable
from types import TracebackType
from typing import Self

import cv2

from track_range.foundation.arrays import Image
from track_range.foundation.errors import UsageError
from track_range.live_view.server import LOOPBACK, LivePage
from track_range.run.frame_result import FrameResult
from track_range.run.prefetch import lower_thread_priority

_QUALITY = 80  # of JPEG; at 100 a picture takes thrice the bytes
_WHERE = re.compile(r"(?:(?P<host>[^\s/]+):)?(?P<port>\d{1,5})")


class LiveView:
    """Serves a run's newest results on a page; a context manager.

    Args:
        host, port: where; port 0 = any that is free.
        wants_browser: whether to open one, where there is a screen.

    Attributes:
        page: the page.

    Raises:
        PageError: the page cannot be served there.
    """

    def __init__(self, host: str, port: int, *, wants_browser: bool = False) -> None:
        self._wants_browser = wants_browser
        self._picture: Callable[[FrameResult], Image] = lambda result: result.frame.left
        self._newest: FrameResult | None = None
        self._number, self._is_over = 0, False
        self._changed = threading.Condition()
        self._drawing, self._drawn = threading.Lock(), (b"", 0)
        self.page = LivePage(self.next_picture, port, host=host)

    def __enter__(self) -> Self:
        return self

    def __exit__(self, kind: type[BaseException] | None, error: BaseException | None, at: TracebackType | None) -> None:
        with self._changed:
            self._is_over = True
            self._changed.notify_all()
        self.page.close()

    def begin(self, draw: Callable[[FrameResult], Image]) -> str:
        """Results are about to come, to be drawn so, in one thread at a time; a sentence for the user."""
        self._picture = draw
        if self._wants_browser and has_screen() and webbrowser.open(self.page.url):
            return f"Live view in your browser: {self.page.url}"
        elsewhere = self.page.url_elsewhere
        others = f", or {elsewhere} on other machines; whoever reaches this port sees it" if elsewhere else ""
        return f"Live view: open {self.page.url} in a browser{others}."

    def offer(self, result: FrameResult) -> None:
        """Take a result in place of the last one offered, drawn or not."""
        with self._changed:
            self._newest, self._number = result, self._number + 1
            self._changed.notify_all()

    def next_picture(self, number: int) -> tuple[bytes, int]:
        """The newest result as JPEG and its number, once there is one after `number`; empty = the run is over."""
        with self._changed:
            self._changed.wait_for(lambda: self._is_over or self._number > number)
            if self._number <= number:
                return b"", number
        with self._drawing:
            with self._changed:
                newest, newest_number = self._newest, self._number
            if newest is not None and self._drawn[1] < newest_number:
                lower_thread_priority()
                _, jpeg = cv2.imencode(".jpg", self._picture(newest), (cv2.IMWRITE_JPEG_QUALITY, _QUALITY))
                self._drawn = (jpeg.tobytes(), newest_number)
            return self._drawn


def open_view(*, show: bool, serve: str | None) -> LiveView | None:
    """The view that `--show` and `--serve` ask for; None = neither is wanted.

    Raises:
        UsageError: `serve` makes no sense.
        PageError: it cannot be served there.
    """
    if not show and serve is None:
        return None
    host, port = (LOOPBACK, 0) if serve is None else place_of_page(serve)
    return LiveView(host, port, wants_browser=show)


def place_of_page(text: str) -> tuple[str, int]:
    """Host and port of `--serve PORT` or `--serve HOST:PORT`; without a host, this machine alone.

    Raises:
        UsageError: neither.
    """
    found = _WHERE.fullmatch(text)
    if found is None or int(found["port"]) > 65535:
        raise UsageError(f"--serve: a port such as 8000, or an address and a port, not '{text}'.")
    return (found["host"] or LOOPBACK).strip("[]"), int(found["port"])


def has_screen() -> bool:
    """Whether a browser with windows can be expected here."""
    if not sys.platform.startswith("linux"):
        return True
    return any(os.environ.get(name) for name in ("DISPLAY", "WAYLAND_DISPLAY"))
