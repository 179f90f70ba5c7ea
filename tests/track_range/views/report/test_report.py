"""The report: one self-contained page with all figures, escaped text, written atomically."""

from __future__ import annotations

import base64
import hashlib
import json
import math
import re
from html.parser import HTMLParser
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from tests.track_range.views.report.report_rows import columns, method_summary, summary
from track_range.foundation.files.output_files import OutputError
from track_range.results.events.event import Event
from track_range.results.rows.rows import Rows
from track_range.views.report.comparison import ComparedRun
from track_range.views.report.page import (
    comparison_page,
    embedded,
    report_page,
    run_content,
    write_comparison,
    write_report,
)

VOID = {"meta", "link", "br", "img", "input", "hr"}


class Page(HTMLParser):
    """A page's text, elements and addresses; every element must be closed by its own tag."""

    def __init__(self, text: str) -> None:
        super().__init__()
        self.open: list[str] = []
        self.counts: dict[str, int] = {}
        self.addresses: list[str] = []
        self.handlers: list[str] = []
        self.words: list[str] = []
        self.scripts: list[str] = []
        self.feed(text)
        self.close()
        assert self.open == []
        self.content = json.loads(self.scripts[0])
        self.text = " ".join(" ".join(self.words).split())

    def handle_starttag(self, tag: str, attrs: list[tuple[str, str | None]]) -> None:
        self.counts[tag] = self.counts.get(tag, 0) + 1
        self.addresses += [
            value or "" for name, value in attrs if name.split(":")[-1] in ("src", "href", "action")
        ]
        self.handlers += [name for name, _ in attrs if name.startswith("on")]
        if tag not in VOID:
            self.open.append(tag)

    def handle_startendtag(self, tag: str, attrs: list[tuple[str, str | None]]) -> None:
        self.handle_starttag(tag, attrs)
        if tag not in VOID:
            self.open.pop()

    def handle_endtag(self, tag: str) -> None:
        assert self.open.pop() == tag

    def handle_data(self, data: str) -> None:
        if self.open and self.open[-1] not in ("style", "script"):
            self.words.append(data)
        elif self.open[-1:] == ["script"]:
            self.scripts.append(data)


def test_page_shows_the_summary() -> None:
    page = Page(report_page(summary(), columns(9, 5, 7)))
    for words in (
        "drive/left.mp4 + drive/right.mp4",
        "8.2",
        "61.70",
        "MOTA % 88.1 IDF1 % 91.4 ID switches 0",
        "The rig was taken from calib.txt.",
        "Ground truth: the visible surface.",
        "rig.file calib.txt",
        "rig.note -",
        "numpy 2.4.6",
    ):
        assert words in page.text


def test_page_is_self_contained() -> None:
    text = report_page(summary(), columns(700, 5, 7))
    page = Page(text)
    # the name of the SVG language
    assert set(re.findall(r"https?://[^\"']+", text)) == {"http://www.w3.org/2000/svg"}
    assert "@import" not in text
    assert "url(" not in text
    assert "link" not in page.counts
    assert page.handlers == []
    assert {address for address in page.addresses if address[:1] != "#"} == {"overlay.mp4"}


def test_content_security_policy() -> None:
    text = report_page(summary(), columns(5))
    page = Page(text)
    assert page.counts["script"] == 2  # the data, and the script
    checksum = base64.b64encode(hashlib.sha256(page.scripts[1].encode()).digest()).decode()
    assert f"default-src 'none'; script-src 'sha256-{checksum}';" in text


def test_longest_tracks_come_first() -> None:
    tracks = Page(report_page(summary(), columns(5, 9, 7))).content["tracks"]
    assert [track["id"] for track in tracks] == [2, 3, 1]


def test_classes_files_and_notes_cannot_become_markup() -> None:
    evil = "<img src=x onerror=alert(1)>$&{{7*7}}"
    changed = summary(
        notes=[evil],
        truth=evil,
        inputs={"left": evil, evil: evil},
        methods={evil: method_summary(1.0)},
        stages_ms={evil: 3.0},
        files={"overlay": 'x/"><script>alert(1)</script>.mp4'},
    )
    text = report_page(changed, columns(5, class_name=evil))
    page = Page(text)
    assert "img" not in page.counts
    assert page.counts["script"] == 2
    assert page.content["tracks"][0]["name"] == evil
    assert "<" not in text[text.index('id="run-content">') + 17 : text.index("</script>")]
    assert page.handlers == []
    assert page.text.count(evil) >= 7


def test_address_of_the_video() -> None:
    page = Page(report_page(summary(files={"overlay": "out dir/overlay 1.mp4"}), columns(5)))
    assert "out%20dir/overlay%201.mp4" in page.addresses
    assert page.counts["video"] == 1
    for files in ({}, {"overlay": None}, None):
        assert "video" not in Page(report_page(summary(files=files), columns(5))).counts


def test_run_without_truth() -> None:
    changed = summary(truth=None, methods={"mono": method_summary(None)}, tracks={"n": 3})
    page = Page(report_page(changed, columns(9, truth=False)))
    assert "No ground truth was given" in page.text
    assert "median distance error" not in page.text
    assert page.content["errors"] == page.content["calibration"] == {}
    assert not {"#errors", "#sigma", "#tracking"} & set(page.addresses)
    assert "Coverage" in page.text


def event(**changes: Any) -> Event:
    values: dict[str, Any] = {
        "kind": "cut_in",
        "start_s": 0.2,
        "peak_s": 0.3,
        "end_s": 0.4,
        "warning_s": 0.25,
    }
    values |= {
        "frame": 3,
        "track_id": 1,
        "class_name": "car",
        "min_distance_m": 12.0,
        "min_distance_sigma_m": 0.5,
    }
    values |= {
        "min_ttc_s": 2.0,
        "closing_mps": 6.0,
        "ego_mps": 14.0,
        "probability": 0.8,
        "headway_s": math.nan,
    }
    return Event(**{**values, "reason": "A car moved into the lane.", **changes})


def test_first_screen_precedes_tables() -> None:
    text = report_page(summary(), columns(9, 5), [event()])
    places = [
        text.index(f'id="{name}"')
        for name in ("stage", "timeline", "events", "tracks", "accuracy", "settings")
    ]
    assert places == sorted(places)
    page = Page(text)
    assert "cut-in warning at 0.2 s car 1" in page.text
    assert "A car moved into the lane." in page.text
    assert page.content["events"][0]["start_s"] == 0.2


def test_three_headlines() -> None:
    text = report_page(summary(), columns(9, 5), [event()])
    assert text.count('class="headline"') == 3
    assert "<b>1 warning</b>" in text
    assert "<b>39.4 m</b>" in text


def test_run_without_events() -> None:
    assert 'id="events"' not in report_page(summary(), columns(5))
    assert "events-heading" not in report_page(summary(), columns(5))
    page = Page(report_page(summary(), columns(5), []))
    assert "No event" in page.text
    assert page.content["events"] == []


def test_many_events_stay_small() -> None:
    text = report_page(
        summary(), columns(50), [event(start_s=i / 1000, end_s=1.0) for i in range(3000)]
    )
    assert len(Page(text).content["events"]) == 500
    assert "2500 more" in text
    assert len(text) < 1_000_000


def test_texts_of_events_are_escaped() -> None:
    evil = "</script><img src=x onerror=alert(1)>"
    page = Page(report_page(summary(), columns(5), [event(reason=evil, class_name=evil)]))
    assert "img" not in page.counts
    assert page.counts["script"] == 2
    assert page.text.count(evil) >= 2


def test_positions_are_in_the_page() -> None:
    changed = columns(9)
    left_px = np.linspace(100, 900, 9)
    changed |= {
        "x1_px": left_px,
        "y1_px": np.full(9, 10.0),
        "x2_px": left_px + 50,
        "y2_px": np.full(9, 60.0),
    }
    changed["x_m"] = (left_px + 25 - 600) / 1000 * changed["fused_m"]
    text = report_page(summary(), changed)
    page = Page(text)
    assert 'id="road"' in text
    assert page.content["camera"]["focal_px"] == pytest.approx(1000, abs=0.1)
    assert page.content["tracks"][0]["x"].startswith("-1900,")
    assert [method["name"] for method in page.content["methods"]] == ["mono", "stereo", "fused"]
    assert 'id="road"' not in report_page(summary(), columns(9))


def test_run_without_tracks_or_figures() -> None:
    page = Page(report_page({"frames": 0}, columns()))
    assert "No track was confirmed in this run." in page.text
    assert "contains no results" in page.text
    assert page.content["tracks"] == page.content["methods"] == []


def test_run_of_one_frame() -> None:
    (track,) = Page(report_page(summary(), columns(1))).content["tracks"]
    assert (track["n"], track["from_s"], track["to_s"], track["near_m"]) == (1, 0.0, 0.0, None)
    assert track["t"] == "0"
    assert track["m"] == {"mono": "4400", "stereo": "3960", "fused": "4000"}


def test_single_camera_without_distances() -> None:
    changed = columns(4, truth=False)
    changed |= {
        name: np.full(4, np.nan) for name in ("mono_m", "stereo_m", "fused_m", "fused_sigma_m")
    }
    page = Page(report_page(summary(truth=None, methods={}, inputs={"video": "dash.mp4"}), changed))
    assert "dash.mp4" in page.text
    assert page.content["tracks"][0]["m"] == {}
    assert page.content["tracks"][0]["near_m"] is None


def test_two_thousand_tracks_stay_small() -> None:
    text = report_page(summary(), columns(*([30] * 2000)))
    assert len(text.encode()) < 10_000_000
    assert len(Page(text).content["tracks"]) == 2000


def test_colours_of_methods_and_hidden_filtered_ones() -> None:
    changed = columns(9) | {
        "fused_kf_m": np.full(9, 30.0),
        "radar_m": np.full(9, 30.0),
        "only_kf_m": np.full(9, 30.0),
    }
    methods = {
        method["name"]: method for method in run_content(summary(), Rows(changed))["methods"]
    }
    assert [name for name, method in methods.items() if not method["shown"]] == ["fused_kf"]
    assert methods["fused"]["colour"] == methods["fused_kf"]["colour"] != methods["radar"]["colour"]


def test_start_of_the_video() -> None:
    assert run_content(summary(starts_s=4.2), Rows(columns(9)))["starts_s"] == 4.2
    assert run_content(summary(), Rows(columns(9)))["starts_s"] == 0.0


def test_data_cannot_end_its_element() -> None:
    text = embedded({"name": "</script><!--&amp;\u2028"})
    assert not set("<>&") & set(text)
    assert json.loads(text) == {"name": "</script><!--&amp;\u2028"}


def test_comparison_page() -> None:
    runs = [
        ComparedRun(name="a", summary=summary(), settings={"size_px": 640}, link="a b/report.html"),
        ComparedRun(
            name="<b>", summary=summary(truth=None), settings={"size_px": 320}, notes=("gone",)
        ),
    ]
    page = Page(comparison_page(runs, []))
    for words in (
        "Comparison of 2 runs",
        "a 16 8.2 3",
        "<b> gone",
        "size_px 640 320",
        "same kind of ground truth",
    ):
        assert words in page.text
    assert page.addresses.count("a%20b/report.html") == 1
    assert page.content == {"lines": []}


def test_comparison_that_cannot_be_written(tmp_path: Path) -> None:
    with pytest.raises(OutputError, match=r"c\.html: cannot be written"):
        write_comparison(
            tmp_path / "missing" / "c.html", [ComparedRun(name="a", summary={}, settings={})], []
        )


def test_report_replaces_an_earlier_one(tmp_path: Path) -> None:
    path = tmp_path / "report.html"
    path.write_text("old", encoding="utf-8")
    write_report(path, summary(notes=["caf\udce9 \N{SNOWMAN}"]), columns(5))
    text = path.read_text(encoding="utf-8")
    assert text.rstrip().endswith("</html>")
    assert "caf? \N{SNOWMAN}" in text
    assert [file.name for file in tmp_path.iterdir()] == ["report.html"]


def test_missing_folder(tmp_path: Path) -> None:
    with pytest.raises(OutputError, match=r"report\.html: cannot be written"):
        write_report(tmp_path / "missing" / "report.html", summary(), columns(3))
