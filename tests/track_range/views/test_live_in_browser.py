"""The live page in a headless Chromium: its pictures, its security policy and its sentences."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from typing import Any

import numpy as np
import pytest

from tests.support.results.overlay_results import result
from track_range.views.live_view.view import LiveView

LEVEL_JS = """() => {
  const image = document.querySelector("img"), canvas = document.createElement("canvas")
  if (!image.naturalWidth) return -1
  canvas.width = canvas.height = 1
  const context = canvas.getContext("2d")
  context.drawImage(image, 0, 0, 1, 1)
  return context.getImageData(0, 0, 1, 1).data[0]
}"""
"""Grey level of the picture shown; -1 = none."""


@pytest.fixture
def open_live_page(browser: Any) -> Iterator[Callable[[LiveView], tuple[Any, list[str]]]]:
    """Opens the page of a view; returns it with the list of its console messages."""
    opened: list[Any] = []

    def open_page(view: LiveView) -> tuple[Any, list[str]]:
        page = browser.new_page()
        opened.append(page)
        messages: list[str] = []
        page.on("console", lambda message: messages.append(message.text))
        page.on("pageerror", lambda error: messages.append(str(error)))
        page.goto(view.page.url, wait_until="commit")
        page.wait_for_selector("#state")
        return page, messages

    yield open_page
    for page in opened:
        page.close()


def offer(view: LiveView, level: int) -> None:
    view.offer(result([], image=np.full((48, 64, 3), level, np.uint8)))


def wait_for_level(page: Any, view: LiveView, level: int) -> None:
    for _ in range(200):
        offer(view, level)
        if abs(page.evaluate(LEVEL_JS) - level) <= 3:
            return
        page.wait_for_timeout(50)
    pytest.fail(f"expected the grey level {level}, got {page.evaluate(LEVEL_JS)}")


def test_stream_is_shown(open_live_page: Callable[[LiveView], tuple[Any, list[str]]]) -> None:
    with LiveView("127.0.0.1", 0) as view:
        page, messages = open_live_page(view)
        for level in (60, 160, 220):
            wait_for_level(page, view, level)
        # the style is applied
        assert page.evaluate("getComputedStyle(document.body).margin") == "0px"
        assert page.inner_text("#state") == "Live"
        assert messages == []
    page.wait_for_selector("#state:has-text('ended')")
    assert abs(page.evaluate(LEVEL_JS) - 220) <= 3


def test_further_viewer_gets_a_sentence(
    open_live_page: Callable[[LiveView], tuple[Any, list[str]]],
) -> None:
    with LiveView("127.0.0.1", 0, n_viewers=1) as view:
        first, _ = open_live_page(view)
        wait_for_level(first, view, 100)
        second, _ = open_live_page(view)
        second.wait_for_selector("#state:has-text('--viewers')")
        first.close()
        wait_for_level(second, view, 200)
        second.wait_for_selector("#state:has-text('Live')")


def test_injected_script_is_blocked(
    open_live_page: Callable[[LiveView], tuple[Any, list[str]]],
) -> None:
    with LiveView("127.0.0.1", 0) as view:
        page, messages = open_live_page(view)
        page.evaluate(
            "document.body.insertAdjacentHTML('beforeend', '<img src=x "
            'onerror="document.title=1">\')'
        )
        page.wait_for_timeout(300)
        assert page.title() == "track-range, live"
        assert any("Content Security Policy" in message for message in messages)


def test_known_distance_gives_a_command(
    open_live_page: Callable[[LiveView], tuple[Any, list[str]]],
) -> None:
    with LiveView("127.0.0.1", 0) as view:
        view.begin(lambda shown: shown.frame.left, video="my drive.mp4")
        page, messages = open_live_page(view)
        view.offer(
            result(
                [[10.0, 8.0, 40.0, 30.0], [44.0, 8.0, 60.0, 20.0]],
                image=np.full((48, 64, 3), 90, np.uint8),
            )
        )
        page.wait_for_selector("#measure")
        page.click("#measure")
        page.wait_for_selector("rect")
        page.click("rect >> nth=0")
        page.fill("#metres", "12.4")
        page.click("#distance button")
        command = page.inner_text("#command")
        assert "--mono 'my drive.mp4'" in command
        assert "--known-distance '0.723,10,8,40,30,car=12.4'" in command
        assert messages == []
