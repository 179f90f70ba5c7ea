"""The report in a headless Chromium; skipped, with the reason, if there is none.

The brightness of each frame of the small overlay encodes its number, so that a screenshot shows
which one is displayed.
"""

from __future__ import annotations

import json
import re
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import pytest

from track_range.pipeline.colours import method_colours
from track_range.results.events.event import Event
from track_range.results.formats.poses_file import Poses
from track_range.results.rows.columns import column_names
from track_range.views.report.comparison import ComparedRun
from track_range.views.report.page import write_comparison, write_report
from track_range.views.videos.video_writer import VideoWriter

playwright = pytest.importorskip(
    "playwright.sync_api", reason="playwright is not installed (extra dev)"
)

STEP_S, N_FRAMES = 0.1, 25
EVIL = (
    "<img src=x "
    "onerror=\"document.title='hacked'\"></script><script>document.title='hacked'</script>"
)


@pytest.fixture
def page_of(browser: Any) -> Iterator[Callable[..., Any]]:
    """Opens a file; fails at the end if there were console messages or network requests."""
    opened, complaints = [], []

    def open_page(path: Path, **options: Any) -> Any:
        page = browser.new_page(**{"viewport": {"width": 1280, "height": 900}, **options})
        opened.append(page)
        page.on("console", lambda message: complaints.append(message.text))
        page.on("pageerror", lambda error: complaints.append(str(error)))
        page.on(
            "request",
            lambda asked: (
                None if asked.url.startswith(("file:", "data:")) else complaints.append(asked.url)
            ),
        )
        page.goto(path.as_uri())
        return page

    yield open_page
    for page in opened:
        page.close()
    assert complaints == []


def rows(
    *lengths: int, name: str = "car", truth: bool = True, from_s: float = 0.0
) -> dict[str, Any]:
    """tracks.csv with one track of each length; the distance of each falls by a metre per frame,
    the truth likewise."""
    n = sum(lengths)
    number = (
        np.concatenate([np.arange(length, dtype=np.float64) for length in lengths])
        if lengths
        else np.zeros(0)
    )
    changed: dict[str, Any] = {column: np.full(n, np.nan) for column in column_names()}
    changed |= {
        "frame": number,
        "time_s": from_s + number * STEP_S,
        "track_id": np.repeat(np.arange(1.0, len(lengths) + 1), lengths),
        "class": np.full(n, name),
        "observed": np.where(number == 3, 0.0, 1.0),
        "fused_m": 60.0 - number,
        "fused_sigma_m": np.full(n, 0.5),
        "fused_kf_m": 60.0 - number,
    }
    for method, factor in (("mono", 1.1), ("stereo", 0.99), ("sgbm", 1.01)):
        changed |= {f"{method}_m": (60.0 - number) * factor, f"{method}_sigma_m": np.full(n, 1.0)}
    u_px = 300 + 20 * number + 100 * changed["track_id"]  # at f = 1000 px and cx = 600 px
    changed |= {
        "x1_px": u_px - 20,
        "y1_px": np.full(n, 100.0),
        "x2_px": u_px + 20,
        "y2_px": np.full(n, 140.0),
    }
    changed |= {
        "x_m": (u_px - 600) / 1000 * changed["fused_m"],
        "ttc_s": np.where(number > 0, 5.0, np.nan),
    }
    return changed | ({"truth_m": 60.0 - number} if truth else {})


def event(kind: Any, start_s: float, end_s: float, **changes: Any) -> Event:
    values: dict[str, Any] = {
        "kind": kind,
        "start_s": start_s,
        "peak_s": end_s,
        "end_s": end_s,
        "warning_s": start_s,
    }
    values |= {
        "frame": round(end_s / STEP_S),
        "track_id": 1,
        "class_name": "car",
        "min_distance_m": 40.0,
    }
    values |= {"min_distance_sigma_m": 0.5, "min_ttc_s": 2.0, "closing_mps": 6.0, "ego_mps": 14.0}
    return Event(**{**values, "probability": 0.8, "reason": EVIL, "headway_s": 1.5, **changes})


EVENTS = (
    event("forward_collision", 0.5, 0.9),
    event("cut_in", 1.2, 1.6, track_id=2),
    event("near_miss", 2.0, 2.2),
)


def summary(**more: Any) -> dict[str, Any]:
    row = {
        "coverage": 1.0,
        "n": 25,
        "median_relative_error_pct": 2.0,
        "within_1_sigma": 0.7,
        "within_2_sigma": 0.9,
    }
    bands = [{"from_m": 20.0, "to_m": 30.0, "mean_relative_error_pct": 1.0}]
    return {
        "frames": N_FRAMES,
        "wall_s": 2.0,
        "stages_ms": {"read": 2.0, "detect": 61.7},
        "methods": {
            "mono": {**row, "median_relative_error_pct": 10.0},
            "stereo": row,
            "fused": {**row, "bands": bands},
        },
        "tracks": {"n": 2, "mota": 88.1, "idf1": 91.4, "idsw": 0, "hota": 70.2},
        "truth": "the surface",
        "notes": ["A note."],
        "inputs": {"left": "drive/left.mp4"},
        "files": {"overlay": "overlay.mp4"},
        **more,
    }


@pytest.fixture(scope="module")
def run(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A report beside an overlay whose frames get brighter."""
    folder = tmp_path_factory.mktemp("run")
    with VideoWriter(folder / "overlay.mp4", width_px=320, height_px=180, fps=1 / STEP_S) as video:
        for number in range(N_FRAMES):
            video.write(np.full((180, 320, 3), 10 * number, np.uint8), number * STEP_S)
    write_report(folder / "report.html", summary(), rows(N_FRAMES, 12), EVENTS)
    return folder


def frame_shown(page: Any) -> float:
    """Number of the displayed overlay frame, from the brightness above the player controls."""
    page.mouse.move(2, 2)
    picture = cv2.imdecode(
        np.frombuffer(page.locator("#video").screenshot(), np.uint8), cv2.IMREAD_GRAYSCALE
    )
    height, width = picture.shape
    return (
        float(np.median(picture[height // 8 : height // 3, width * 4 // 10 : width * 6 // 10])) / 10
    )


def wait_for_video(page: Any) -> None:
    page.wait_for_function(
        "() => { const v = document.getElementById('video'); return v.readyState >= 2 && "
        "!v.seeking; }"
    )


def first_chart(page: Any) -> Any:
    """The first track's chart, scrolled to and drawn."""
    chart = page.locator("#track-list .chart").first
    chart.scroll_into_view_if_needed()
    chart.locator("svg svg").wait_for()
    return chart


def click_at(
    page: Any, time_s: float, *, first_s: float = 0.0, last_s: float = (N_FRAMES - 1) * STEP_S
) -> None:
    """Click in the first chart at a time."""
    chart = first_chart(page)
    plot = chart.locator("> svg > svg").bounding_box()
    box = chart.bounding_box()
    x = plot["x"] - box["x"] + (time_s - first_s) / (last_s - first_s) * plot["width"]
    chart.click(position={"x": x, "y": box["height"] / 2})


def test_click_in_a_chart_moves_the_video(page_of: Callable[..., Any], run: Path) -> None:
    page = page_of(run / "report.html")
    wait_for_video(page)
    for number in (12, 3, 24, 0):
        click_at(page, number * STEP_S)
        wait_for_video(page)
        page.wait_for_function(
            f"() => Math.abs(document.getElementById('video').currentTime - {number * STEP_S}) < "
            "0.01"
        )
        assert abs(frame_shown(page) - number) < 0.5
        readout = page.locator(".readout").first.inner_text()
        assert f"{number * STEP_S:.2f} s" in readout
        assert f"truth {60 - number:.1f} m" in readout


def test_cursor_follows_the_video(page_of: Callable[..., Any], run: Path) -> None:
    page = page_of(run / "report.html")
    wait_for_video(page)
    first_chart(page)
    lines = (
        "() => [...document.querySelectorAll('.cursor')].map((line) => +line.getAttribute('x1'))"
    )
    before = page.evaluate(lines)
    page.evaluate("() => document.getElementById('video').play()")
    page.wait_for_function("() => document.getElementById('video').ended")
    page.wait_for_function(
        "() => document.querySelector('.readout').textContent.startsWith('2.40 s')"
    )
    after = page.evaluate(lines)
    assert after[0] > before[0] + 500
    # its track ended before
    assert "no box at this time" in page.locator(".readout").nth(1).inner_text()
    assert page.locator("#now button").all_inner_texts() == ["car 1 36.0 m"]


def test_keys_of_the_page(page_of: Callable[..., Any], run: Path) -> None:
    page = page_of(run / "report.html")
    wait_for_video(page)
    starts_s = sorted({one.start_s for one in EVENTS if one.start_s > 0.05})
    for key, time_s in (
        ("j", starts_s[0]),
        ("j", starts_s[1]),
        ("k", starts_s[0]),
        ("ArrowRight", starts_s[0] + 1),
    ):
        page.keyboard.press(key)
        assert page.locator("#clock").inner_text().startswith(f"{time_s:.2f} s")
    page.keyboard.press("Home")  # scrolls the page, and leaves the time
    page.keyboard.press("Shift+ArrowLeft")
    assert page.locator("#clock").inner_text().startswith("1.4")  # a frame before 1.5 s
    page.keyboard.press(" ")
    page.wait_for_function("() => !document.getElementById('video').paused")
    page.locator("#find").fill("")
    page.locator("#find").press_sequentially("jk ")
    assert page.locator("#find").input_value() == "jk "


def test_keys_step_through_a_chart_and_start_the_video(
    page_of: Callable[..., Any], run: Path
) -> None:
    page = page_of(run / "report.html")
    wait_for_video(page)
    chart = page.get_by_role("slider", name="Distance over time of car 1")
    chart.focus()
    for key, number in (
        ("End", 24),
        ("ArrowLeft", 23),
        ("PageDown", 13),
        ("ArrowRight", 14),
        ("Home", 0),
        ("ArrowLeft", 0),
    ):
        page.keyboard.press(key)
        assert float(str(chart.get_attribute("aria-valuenow"))) == pytest.approx(number * STEP_S)
        assert f"fused {60 - number:.1f} ± 0.5 m" in str(chart.get_attribute("aria-valuetext"))
        page.wait_for_function(
            f"() => Math.abs(document.getElementById('video').currentTime - {number * STEP_S}) < "
            "0.01"
        )
    page.keyboard.press("Enter")
    page.wait_for_function("() => document.getElementById('video').currentTime > 0.15")


def test_probability_of_contact_in_the_cards(
    page_of: Callable[..., Any], run: Path, tmp_path: Path
) -> None:
    """Drawn with the thresholds of the run for tracks whose probability is known; old runs have
    none."""
    columns = rows(N_FRAMES, 12)
    is_first = columns["track_id"] == 1
    columns["contact_probability"] = np.where(is_first, 0.04 * columns["frame"], np.nan)
    columns["mdrac_mps2"] = np.where(columns["frame"] < 5, 2.5, 8.0)
    settings = {"warning_options": {"on_probability": 0.5}}
    write_report(tmp_path / "report.html", summary(settings=settings, files={}), columns, EVENTS)
    page = page_of(tmp_path / "report.html")
    charts = page.locator("#events .probability")
    assert charts.count() == 2  # the second event is of a track without a probability
    label = str(charts.first.get_attribute("aria-label"))
    assert "car 1; alarm from 50 % where hard braking is needed, off below 10 %" in label
    assert "first seen at 0.0 s, warning at 0.5 s, most critical at 0.9 s" in label
    limit = str(charts.first.locator("path.limit").get_attribute("d"))
    heights = [float(point.split()[1]) for point in re.split("[ML]", limit)[1:]]
    # 80 % where normal braking is enough, then 50 %: from 5 px at 100 % to 43 px at 0 %
    assert heights == pytest.approx([12.6] * 5 + [24.0] * 15)
    shown = charts.first.locator(".line").get_attribute("d")
    assert len(str(shown).split("L")) == 20  # frames 0 to 19: 1 s after the end at 0.9 s
    assert page_of(run / "report.html").locator("#events .probability").count() == 0


def test_timeline_and_play_button(page_of: Callable[..., Any], run: Path) -> None:
    page = page_of(run / "report.html")
    wait_for_video(page)
    video, timeline = page.locator("#video"), page.get_by_role("slider", name="Time in the video")
    has_controls = lambda: video.evaluate("video => video.controls")  # noqa: E731
    assert not has_controls()
    video.hover()
    assert has_controls()
    page.mouse.move(2, 2)
    assert not has_controls()
    box = timeline.bounding_box()
    timeline.click(
        position={"x": box["width"] * 1.2 / (N_FRAMES * STEP_S), "y": box["height"] - 25}
    )
    page.wait_for_function(
        "() => Math.abs(document.getElementById('video').currentTime - 1.2) < 0.05"
    )
    assert page.locator("#clock").inner_text().startswith("1.2")
    timeline.focus()
    for key, time_s in (
        ("Home", 0.0),
        ("ArrowRight", 1.0),
        ("Shift+ArrowRight", 1.1),
        ("ArrowLeft", 0.1),
        ("End", 2.5),
    ):
        page.keyboard.press(key)
        assert float(str(timeline.get_attribute("aria-valuenow"))) == pytest.approx(
            time_s, abs=0.02
        )
        wait_for_video(page)
    assert "road user" in str(timeline.get_attribute("aria-valuetext"))
    page.keyboard.press("Home")
    play = page.locator("#play")
    play.press("Enter")
    page.wait_for_function("() => document.getElementById('play').textContent === 'Pause'")
    play.press("Enter")
    page.wait_for_function("() => document.getElementById('play').textContent === 'Play'")


def shown_time(page: Any) -> float:
    return float(page.locator("#road-view > svg").get_attribute("data-time"))


def wait_until(page: Any, time_s: float) -> None:
    """Wait until the video, the bird's-eye view and the timeline are at a time."""
    page.wait_for_function(
        f"() => Math.abs(document.getElementById('video').currentTime - {time_s}) < 0.06"
        f" && Math.abs(document.querySelector('#road-view > svg').dataset.time - {time_s}) < 0.06"
        f" && Math.abs(document.getElementById('timeline').ariaValueNow - {time_s}) < 0.06"
    )


def test_click_on_an_event_jumps_to_it(page_of: Callable[..., Any], run: Path) -> None:
    page = page_of(run / "report.html")
    wait_for_video(page)
    buttons = page.locator("#events .event")
    assert buttons.count() == 3
    for number, time_s in ((1, 1.2), (0, 0.5), (2, 2.0)):
        buttons.nth(number).click()
        wait_until(page, time_s)
        wait_for_video(page)
        assert abs(frame_shown(page) - time_s / STEP_S) < 0.5
        assert buttons.nth(number).get_attribute("aria-current") == "true"
    assert page.locator("#events .event[aria-current]").count() == 1
    page.locator(".event-mark").nth(0).click()
    wait_until(page, 0.5)
    page.locator("#next").click()
    wait_until(page, 1.2)
    page.locator("#previous").click()
    wait_until(page, 0.5)


def test_keys_in_the_list_of_events(page_of: Callable[..., Any], run: Path) -> None:
    page = page_of(run / "report.html")
    wait_for_video(page)
    page.locator("#events .event").first.focus()
    focused = "() => [...document.querySelectorAll('.event')].indexOf(document.activeElement)"
    for key, index in (
        ("ArrowDown", 1),
        ("ArrowDown", 2),
        ("ArrowDown", 2),
        ("ArrowUp", 1),
        ("Home", 0),
        ("End", 2),
    ):
        page.keyboard.press(key)
        assert page.evaluate(focused) == index
    page.keyboard.press("Enter")
    wait_until(page, 2.0)
    assert page.evaluate("() => document.querySelectorAll('.event[tabindex=\"0\"]').length") == 1


def test_focus_order_and_visible_focus(page_of: Callable[..., Any], run: Path) -> None:
    page = page_of(run / "report.html")
    wait_for_video(page)
    names = []
    for _ in range(60):
        page.keyboard.press("Tab")
        names.append(
            page.evaluate(
                "() => document.activeElement.id || document.activeElement.classList[0] || ''"
            )
        )
        if names[-1] == "event":
            break
    order = [
        names.index(name)
        for name in ("skip", "theme", "headline", "zoom-in", "play", "timeline", "event")
    ]
    assert order == sorted(order)
    assert (
        page.evaluate("() => parseFloat(getComputedStyle(document.activeElement).outlineWidth)")
        >= 2
    )


def test_birds_eye_view_follows_the_video(page_of: Callable[..., Any], run: Path) -> None:
    page = page_of(run / "report.html")
    wait_for_video(page)
    dot = "() => +document.querySelector('.user[data-track=\"1\"] .dot').getAttribute('cy')"
    wait_until(page, 0.0)
    before = page.evaluate(dot)
    assert page.locator(".user .sigma-area").count() == 2
    page.evaluate("() => document.getElementById('video').play()")
    page.wait_for_function("() => document.getElementById('video').currentTime > 0.5")
    page.evaluate("() => document.getElementById('video').pause()")
    page.wait_for_timeout(200)
    assert shown_time(page) == pytest.approx(
        page.evaluate("() => document.getElementById('video').currentTime"), abs=0.06
    )
    assert page.evaluate(dot) > before
    assert page.locator(".user .course").count() > 0
    assert page.locator(".user .trail").first.get_attribute("d").count("L") >= 4
    assert "car 1" in page.locator("#road-view > svg").get_attribute("aria-label")
    page.locator("#zoom-in").click()
    nearer = page.evaluate(dot)
    page.locator("#zoom-out").click()
    assert page.evaluate(dot) != nearer
    page.locator("#timeline").press("End")
    # the other track has ended
    page.wait_for_function("() => document.querySelectorAll('.user').length === 1")


def test_ended_tracks_are_not_shown(page_of: Callable[..., Any], run: Path) -> None:
    page = page_of(run / "report.html")
    wait_for_video(page)
    for time_s, n_users in ((1.1, 2), (1.2, 1)):  # the second track has twelve frames
        page.goto((run / "report.html").as_uri() + f"#t={time_s}")
        wait_until(page, time_s)
        assert page.locator(".user").count() == n_users
        assert f"{n_users} road user" in page.locator("#clock").inner_text()


def test_link_to_a_moment(page_of: Callable[..., Any], run: Path) -> None:
    page = page_of(run / "report.html")
    page.goto((run / "report.html").as_uri() + "#t=1.5")
    wait_until(page, 1.5)
    page.locator(".headline[data-time]").last.click()
    page.wait_for_function(
        "() => Math.abs(document.querySelector('#road-view > svg').dataset.time - 1.5) > 0.05"
    )


def test_run_without_video_plays(page_of: Callable[..., Any], tmp_path: Path) -> None:
    write_report(tmp_path / "report.html", summary(files={}), rows(N_FRAMES, 12), EVENTS)
    page = page_of(tmp_path / "report.html")
    page.locator("#events .event").nth(1).click()
    page.wait_for_function(
        "() => document.querySelector('#road-view > svg').dataset.time === '1.200'"
    )
    page.locator("#play").press("Enter")
    page.wait_for_function("() => document.querySelector('#road-view > svg').dataset.time > 1.5")
    # at the end
    page.wait_for_function("() => document.getElementById('play').textContent === 'Play'")
    assert shown_time(page) == pytest.approx(2.5, abs=0.01)


def test_map_follows_the_time_and_moves_it(page_of: Callable[..., Any], tmp_path: Path) -> None:
    step = np.arange(N_FRAMES, dtype=np.float64)
    poses = Poses(step, STEP_S * step, 2.0 * step, 0 * step, 0 * step, np.zeros((N_FRAMES, 3)))
    given = rows(N_FRAMES, 12)
    given |= {
        "world_x_m": 30 + given["frame"],
        "world_y_m": 3.0 * given["track_id"],
        "state": given["class"],
    }
    write_report(tmp_path / "report.html", summary(files={}), given, EVENTS, poses=poses)
    page = page_of(tmp_path / "report.html")
    page.locator("#map-chart").scroll_into_view_if_needed()
    page.wait_for_selector("#map-chart .map-camera")
    assert page.locator("#map-chart path[data-track]").count() == 2
    assert page.locator("#map-chart .map-now circle").count() == 3
    start, width = (
        float(page.locator(".map-camera").get_attribute("cx")),
        page.locator(".map-ego").bounding_box(),
    )
    page.mouse.click(width["x"] + width["width"] - 2, width["y"])
    page.wait_for_function(
        "() => document.querySelector('#road-view > svg').dataset.time === '2.400'"
    )
    assert float(page.locator(".map-camera").get_attribute("cx")) > start + 100
    assert page.locator("#map-chart .map-now circle").count() == 2  # the shorter track has ended


def test_small_video_beside_the_charts(page_of: Callable[..., Any], run: Path) -> None:
    page = page_of(run / "report.html")
    wait_for_video(page)
    mini = page.locator("#mini")
    assert "small" not in str(mini.get_attribute("class"))
    page.locator("#track-list figure").last.scroll_into_view_if_needed()
    page.locator("#mini.small").wait_for()
    page.get_by_role("button", name="Close the small video").click()
    page.wait_for_function("() => !document.getElementById('mini').classList.contains('small')")


@pytest.mark.parametrize("happened", [(), EVENTS[:1]])
@pytest.mark.parametrize(("width_px", "height_px"), [(1400, 900), (1920, 1080)])
def test_video_is_in_its_place_at_the_top_of_the_page(
    page_of: Callable[..., Any],
    run: Path,
    happened: tuple[Event, ...],
    width_px: int,
    height_px: int,
) -> None:
    long = summary(notes=["A long note. " * 500])  # the charts are out of view at first
    write_report(run / "top.html", long, rows(N_FRAMES, 12), happened)
    page = page_of(run / "top.html", viewport={"width": width_px, "height": height_px})
    wait_for_video(page)
    places = """async (y) => {
      scrollTo(0, y);
      await new Promise((done) => setTimeout(done, 100));
      const boxes = ["video", "picture"].map((id) => document.getElementById(id).getBoundingClientRect());
      return boxes.map((box) => [box.x, box.y, box.width, box.height]);
    }"""
    place, slot = page.evaluate(places, 0)
    assert place == slot
    assert place[3] == pytest.approx(min(0.45 * height_px, place[2] * 9 / 16), abs=1)
    for scrolled in (100, 5000):
        assert page.evaluate(places, scrolled)[1][2:] == slot[2:]
        assert page.evaluate(places, 0) == [place, slot]


@pytest.mark.parametrize("scheme", ["light", "dark"])
@pytest.mark.parametrize("width_px", [360, 800, 1280])
def test_first_screen_contains_its_parts(
    page_of: Callable[..., Any], run: Path, width_px: int, scheme: Any
) -> None:
    page = page_of(
        run / "report.html", viewport={"width": width_px, "height": 800}, color_scheme=scheme
    )
    wait_for_video(page)
    boxes = {
        name: page.locator(f"#{name}").bounding_box()
        for name in ("video", "timeline", "road", "events")
    }
    assert all(box["x"] >= 0 and box["x"] + box["width"] <= width_px for box in boxes.values())
    assert boxes["video"]["y"] + boxes["video"]["height"] <= boxes["timeline"]["y"]
    if width_px > 1000:
        assert boxes["road"]["x"] > boxes["video"]["x"] + boxes["video"]["width"]
        assert boxes["events"]["y"] < 800
    else:
        assert boxes["timeline"]["y"] < 800
    assert page.evaluate("() => document.documentElement.scrollWidth") == width_px
    if width_px > 700:
        is_cut = (
            "() => [...document.querySelectorAll('.wide')].some((box) => box.scrollWidth > "
            "box.clientWidth)"
        )
        assert not page.evaluate(is_cut)


def test_unneeded_controls_are_hidden(page_of: Callable[..., Any], run: Path) -> None:
    page = page_of(run / "report.html")
    first_chart(page)
    assert page.locator("#count").inner_text() == "2 of 2 shown (road users: 2)"
    assert not page.get_by_role("button", name="Show more").is_visible()
    assert not page.locator("#video-missing").is_visible()


def test_button_below_the_video_leads_to_its_chart(page_of: Callable[..., Any], run: Path) -> None:
    write_report(run / "many.html", summary(), rows(*([N_FRAMES] * 30), 9))
    page = page_of(run / "many.html")
    first_chart(page)
    # the list begins with twenty
    assert page.locator("#track-list figure[data-track='24']").count() == 0
    page.locator("#now button").last.click()
    assert page.locator("#track-list figure").first.get_attribute("data-track") == "24"
    chart = page.locator("#track-list .chart:focus")
    chart.locator("svg svg").wait_for()
    page.wait_for_function(
        "() => document.activeElement.getBoundingClientRect().top"
        " >= document.getElementById('watch').getBoundingClientRect().bottom - 1"
    )


def test_run_that_starts_late(page_of: Callable[..., Any], run: Path) -> None:
    write_report(run / "late.html", summary(starts_s=5.0), rows(N_FRAMES, from_s=5.0))
    page = page_of(run / "late.html")
    wait_for_video(page)
    click_at(page, 5.7, first_s=5.0, last_s=5.0 + (N_FRAMES - 1) * STEP_S)
    wait_for_video(page)
    assert abs(frame_shown(page) - 7) < 0.5


def test_tables_sort_by_mouse_and_by_key(page_of: Callable[..., Any], run: Path) -> None:
    page = page_of(run / "report.html")
    table = page.locator("table.sortable").first
    names = lambda: table.locator("tbody th").all_inner_texts()  # noqa: E731
    heading = table.get_by_role("columnheader", name="median %")
    assert names() == ["mono", "stereo", "fused"]
    heading.get_by_role("button").click()
    assert names() == ["stereo", "fused", "mono"]
    assert heading.get_attribute("aria-sort") == "ascending"
    page.keyboard.press("Enter")
    assert names() == ["mono", "stereo", "fused"]
    assert heading.get_attribute("aria-sort") == "descending"
    banded = table.get_by_role("columnheader", name="20-30 m").get_by_role("button")
    for _ in range(2):
        banded.click()
        assert names()[0] == "fused"  # missing values stay at the bottom in both orders


def test_methods_are_switched_in_all_charts(page_of: Callable[..., Any], run: Path) -> None:
    page = page_of(run / "report.html")
    first_chart(page)
    strokes = (
        "() => [...document.querySelector('#track-list .chart').querySelectorAll('path[stroke]')]"
        ".map((path) => path.getAttribute('stroke'))"
    )
    assert method_colours()["mono"] in page.evaluate(strokes)
    page.locator("#legend").get_by_role("button", name="mono", exact=True).click()
    assert method_colours()["mono"] not in page.evaluate(strokes)
    pressed = page.locator(".legend button[data-method=mono]").evaluate_all(
        "all => all.map((b) => b.ariaPressed)"
    )
    assert pressed == ["false"] * 3
    assert "mono" not in page.locator(".readout").first.inner_text()


def test_theme_follows_the_system(page_of: Callable[..., Any], run: Path) -> None:
    page = page_of(run / "report.html", color_scheme="dark")
    background = "() => getComputedStyle(document.body).backgroundColor"
    dark = page.evaluate(background)
    theme = page.get_by_role("button", name="Theme")
    theme.click()
    assert theme.inner_text() == "Theme: light"
    assert page.evaluate(background) != dark
    page.reload()
    assert theme.inner_text() == "Theme: light"
    theme.click()
    assert page.evaluate(background) == dark


def test_no_horizontal_scrolling_on_a_phone(page_of: Callable[..., Any], run: Path) -> None:
    page = page_of(run / "report.html", viewport={"width": 360, "height": 740})
    first_chart(page)
    page.locator("#sigma-chart").scroll_into_view_if_needed()
    page.locator("#sigma-chart svg svg").wait_for()
    assert page.evaluate("() => document.documentElement.scrollWidth") == 360


def test_two_thousand_tracks_in_the_browser(page_of: Callable[..., Any], tmp_path: Path) -> None:
    path = tmp_path / "report.html"
    write_report(path, summary(files={}), rows(*([30] * 2000)))
    assert path.stat().st_size < 10_000_000
    page = page_of(path)
    assert page.locator("#count").inner_text() == "20 of 2000 shown (road users: 2000)"
    first_chart(page)
    assert 0 < page.locator("#track-list .chart svg svg").count() < 10
    page.get_by_label("Filter").fill("1999")
    assert page.locator("#track-list figcaption").first.inner_text().startswith("car 1999")
    assert page.locator("#count").inner_text() == "1 of 1 shown (road users: 1)"
    page.get_by_label("Filter").fill("")
    page.get_by_role("button", name="Show more").click()
    assert page.locator("#track-list figure").count() == 40


def test_names_cannot_become_markup(page_of: Callable[..., Any], tmp_path: Path) -> None:
    changed = summary(
        notes=[EVIL], truth=EVIL, inputs={"left": EVIL, EVIL: EVIL}, files={}, stages_ms={EVIL: 3.0}
    )
    write_report(
        tmp_path / "report.html",
        {**changed, "methods": {EVIL: changed["methods"]["mono"]}},
        rows(9, name=EVIL),
    )
    page = page_of(tmp_path / "report.html")
    first_chart(page)
    assert page.locator("#track-list figcaption").first.inner_text().startswith(EVIL)
    assert page.locator("img").count() == 0
    assert page.title() != "hacked"
    assert page.locator("script").count() == 2


def test_missing_video(page_of: Callable[..., Any], tmp_path: Path) -> None:
    (tmp_path / "overlay.mp4").write_bytes(b"no video")
    write_report(tmp_path / "report.html", summary(), rows(9))
    page = page_of(tmp_path / "report.html")
    page.get_by_text("The overlay cannot be played").wait_for()
    assert not page.locator("#video").is_visible()
    click_at(page, 0.4, last_s=0.8)
    assert "0.40 s" in page.locator(".readout").first.inner_text()


@pytest.mark.parametrize(
    ("changed", "lengths", "truth"),
    [
        ({}, (1,), True),
        ({"truth": None, "methods": {}}, (5, 3), False),
        ({"truth": None, "methods": {}}, (), False),
    ],
    ids=["one frame", "no truth", "no track"],
)
def test_incomplete_runs(
    page_of: Callable[..., Any], tmp_path: Path, changed: Any, lengths: Any, truth: bool
) -> None:
    write_report(
        tmp_path / "report.html", summary(files={}, **changed), rows(*lengths, truth=truth)
    )
    page = page_of(tmp_path / "report.html")
    assert page.locator("h1").inner_text() == "drive/left.mp4"
    if lengths:
        first_chart(page)
        page.locator("#track-list .chart").first.press("ArrowRight")
    else:
        assert page.get_by_text("No track was confirmed in this run.").is_visible()
    assert page.locator("#error-chart svg").count() == 0 or truth


def test_several_runs_are_compared(page_of: Callable[..., Any], tmp_path: Path) -> None:
    runs = [
        ComparedRun(name=name, summary=summary(), settings={}, link=f"{name}/report.html")
        for name in ("one", EVIL)
    ]
    write_comparison(tmp_path / "comparison.html", runs, [])
    page = page_of(tmp_path / "comparison.html")
    page.locator("#run-chart").scroll_into_view_if_needed()
    page.locator("#run-chart .chart svg svg path").first.wait_for(state="attached")
    assert [
        text.strip() for text in page.locator("#run-chart .legend > span").all_inner_texts()
    ] == ["one", EVIL]
    assert json.loads(page.locator("#run-content").inner_text())["lines"][0]["x"] == [25.0]
    assert (
        page.get_by_role("link", name="one", exact=True).get_attribute("href") == "one/report.html"
    )


def test_known_distance_gives_a_command(page_of: Callable[..., Any], tmp_path: Path) -> None:
    uncalibrated = summary(calibration="estimated", inputs={"mono": "my drive.mp4"}, files={})
    write_report(tmp_path / "report.html", uncalibrated, rows(10))
    page = page_of(tmp_path / "report.html")
    page.goto((tmp_path / "report.html").as_uri() + "#t=0.25")
    page.click("#known summary")
    page.fill("#known-metres", "12.4")
    page.click("#known-add")
    command = page.inner_text("#known-command")
    assert "--mono 'my drive.mp4'" in command
    assert "--known-distance '0.200,420,100,460,140,car=12.4'" in command
    page.click("#known-list button")
    assert not page.is_visible("#known-result")
    write_report(
        tmp_path / "report.html",
        summary(calibration="rig", inputs={"mono": "a.mp4"}, files={}),
        rows(10),
    )
    page.reload()
    assert page.query_selector("#known") is None
