"""The page of a fleet in a headless Chromium; skipped, with the reason, if there is none."""

from __future__ import annotations

import pytest

from tests.track_range.fleet.fleet_results import write_fleet
from track_range.fleet.report.fleet_figures import fleet_figures
from track_range.fleet.report.fleet_page import fleet_page
from track_range.fleet.storage.location import Location

pytestmark = pytest.mark.slow


@pytest.fixture
def address(tmp_path):
    """Address of the page of a fleet."""
    out = Location.of(tmp_path / "out")
    write_fleet(out, tmp_path)
    page = tmp_path / "out/fleet.html"
    page.write_text(fleet_page(fleet_figures(out), out, Location.of(page)))
    return page.as_uri()


@pytest.mark.parametrize(("width", "scheme"), [(1280, "light"), (1280, "dark"), (390, "light")])
def test_page_is_drawn_without_network(browser, address, width, scheme):
    page = browser.new_page(viewport={"width": width, "height": 900}, color_scheme=scheme)
    complaints = []
    page.on("console", lambda message: complaints.append(message.text))
    page.on("pageerror", lambda error: complaints.append(str(error)))
    page.on("request", lambda asked: asked.url.startswith("file:") or complaints.append(asked.url))
    page.goto(address)
    for figure in ("row_offset_px", "offset_px"):
        chart = page.locator(f"#drift-{figure}")
        chart.scroll_into_view_if_needed()
        chart.locator("svg svg path").nth(1).wait_for(state="attached")  # a line and its dots
    assert page.evaluate("document.documentElement.scrollWidth") <= width
    colour = page.evaluate("getComputedStyle(document.body).backgroundColor")
    assert (colour < "rgb(2") == (scheme == "dark")
    page.get_by_role("button", name="time in the clip s").first.click()
    assert page.locator("#closest th[aria-sort=ascending]").count() == 1
    page.close()
    assert complaints == []
