"""LiveView: the overlay of a run in progress, in a browser; only the newest frame is drawn, and
only on request.

results --> [ newest ] <-- connection threads, which share one drawing of each result      (`offer` does not block)
"""

from __future__ import annotations

import json
import os
import re
import sys
import threading
import webbrowser
from collections.abc import Callable
from typing import Self

import cv2
import numpy as np

from track_range.detection.classes import ROAD_CLASSES
from track_range.foundation.arrays import Image
from track_range.foundation.errors import UsageError
from track_range.pipeline.frame_result import FrameResult
from track_range.views.live_view.server import DEFAULT_VIEWERS, LOOPBACK, TIMEOUT_S, LivePage

_QUALITY = 80  # JPEG quality in per cent; at 100 a picture is three times as large
_ADDRESS = re.compile(r"(?:(?P<host>[^\s/]+):)?(?P<port>\d{1,5})")


class LiveView:
    """Live page with the newest result of a run; a context manager. PageError if it cannot be
    served at this address.

    `opens_browser`: whether to open a browser, if there is a screen; for the other arguments see
    `LivePage`.
    """

    def __init__(
        self,
        host: str,
        port: int,
        *,
        opens_browser: bool = False,
        n_viewers: int = DEFAULT_VIEWERS,
        timeout_s: float = TIMEOUT_S,
    ) -> None:
        self._opens_browser = opens_browser
        self._picture: Callable[[FrameResult], Image] = lambda result: result.frame.left
        self._newest: FrameResult | None = None
        self._number, self._is_over = 0, False
        self._changed = threading.Condition()
        self._drawing, self._drawn = threading.Lock(), (b"", 0)
        self._video: str | None = None
        self.page = LivePage(
            self.next_picture,
            port,
            host=host,
            n_viewers=n_viewers,
            boxes=self.boxes,
            timeout_s=timeout_s,
        )

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_error: object) -> None:
        with self._changed:
            self._is_over = True
            self._changed.notify_all()
        self.page.close()

    def begin(self, draw: Callable[[FrameResult], Image], *, video: str | None = None) -> str:
        """Set `draw`, which draws results, called by one thread at a time; returns a message with
        the page's address.

        `video` is the name of a one-camera recording that known distances can calibrate; None =
        there is none.
        """
        self._picture, self._video = draw, video
        if self._opens_browser and has_screen() and webbrowser.open(self.page.url):
            return f"Live view in your browser: {self.page.url}"
        elsewhere = self.page.url_elsewhere
        others = (
            f", or {elsewhere} on other machines (visible to anyone who can reach this port)"
            if elsewhere
            else ""
        )
        return f"Live view: open {self.page.url} in a browser{others}."

    def offer(self, result: FrameResult) -> None:
        """Replace the newest result; returns immediately."""
        with self._changed:
            self._newest, self._number = result, self._number + 1
            self._changed.notify_all()

    def next_picture(self, number: int, wait_s: float) -> tuple[bytes, int] | None:
        """JPEG and number of a result after `number`; b"" = none within `wait_s`; None = the run is
        over.
        """
        with self._changed:
            self._changed.wait_for(lambda: self._is_over or self._number > number, wait_s)
            if self._number <= number:
                return None if self._is_over else (b"", number)
        with self._drawing:
            with self._changed:
                newest, newest_number = self._newest, self._number
            if newest is not None and self._drawn[1] < newest_number:
                _, jpeg = cv2.imencode(
                    ".jpg", self._picture(newest), (cv2.IMWRITE_JPEG_QUALITY, _QUALITY)
                )
                self._drawn = (jpeg.tobytes(), newest_number)
            return self._drawn

    def boxes(self) -> bytes:
        """Observed boxes of the newest result as JSON, for the command that calibrates the camera;
        empty = none.

        Keys: `video`, its name; `time_s`; `boxes`, a list of objects with `name` and `xyxy`, whole
        pixels.
        """
        newest = self._newest
        if newest is None or self._video is None:
            return b""
        tracks = newest.tracks
        boxes = [
            {
                "name": ROAD_CLASSES[tracks.class_id[row]],
                "xyxy": [round(edge) for edge in tracks.xyxy_px[row].tolist()],
            }
            for row in np.flatnonzero(tracks.observed)
        ]
        return json.dumps(
            {"video": self._video, "time_s": round(newest.time_s, 3), "boxes": boxes}
        ).encode()


def open_view(
    *, show: bool, serve: str | None, n_viewers: int = DEFAULT_VIEWERS
) -> LiveView | None:
    """Live view for the options `--show` and `--serve`, with at most `n_viewers` streams; None
    without both.

    UsageError if `serve` is not a port or an address with a port; PageError if the page cannot be
    served at this address.
    """
    if not show and serve is None:
        return None
    host, port = (LOOPBACK, 0) if serve is None else parse_address(serve)
    return LiveView(host, port, opens_browser=show, n_viewers=n_viewers)


def parse_address(text: str) -> tuple[str, int]:
    """Host and port of `--serve [HOST:]PORT`; without a host, the loopback address. UsageError for
    another text.
    """
    match = _ADDRESS.fullmatch(text)
    if match is None or int(match["port"]) > 65535:
        raise UsageError(f"--serve: expected a port such as 8000, or HOST:PORT, got '{text}'.")
    return (match["host"] or LOOPBACK).strip("[]"), int(match["port"])


def has_screen() -> bool:
    """Whether this machine seems to have a screen, so that a browser can be opened."""
    if not sys.platform.startswith("linux"):
        return True
    return any(os.environ.get(name) for name in ("DISPLAY", "WAYLAND_DISPLAY"))
