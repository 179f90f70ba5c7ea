"""The figure of false alarms against lead time."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest

from tests.track_range.views.report.test_report import columns, summary
from track_range.views.report import page
from track_range.views.report.page import curve_figure, packaged_curve, report_page

CURVE: dict[str, Any] = {
    "protocol": "Three hours of <simulated> driving.",
    "methods": {"mono": [[10.0, 2.0, 0.5], [0.0, 1.0, 0.25]], "fused": [[1.0, 3.0, 1.0], [0.5, None, 0.0]]},
}


def test_points_on_their_axes() -> None:
    figure = curve_figure(CURVE)
    mono, fused = figure["lines"]
    inner = figure["inner"]
    assert [tick["text"] for tick in figure["x_ticks"]] == ["0.1", "1", "10"]
    assert [tick["text"] for tick in figure["y_ticks"]] == ["0 s", "1 s", "2 s", "3 s", "4 s"]
    assert [dot["x"] for dot in mono["dots"]] == [inner["left"], inner["right"]]  # 0 per hour is at the lowest rate
    assert [dot["y"] for dot in fused["dots"]] == [figure["y_ticks"][3]["at"]]
    assert mono["dots"][0]["r"] < mono["dots"][1]["r"] < fused["dots"][0]["r"]
    assert "mono: 0.0 per hour with 1.0 s, 10.0 per hour with 2.0 s" in figure["alternative"]


def test_curve_without_values() -> None:
    assert curve_figure({"methods": {"mono": []}})["lines"][0]["path"] == ""


def test_packaged_curve_can_be_drawn() -> None:
    content = packaged_curve()
    if content is None:
        pytest.skip("no curve is packaged")
    assert {"mono", "stereo", "fused"} <= {line["name"] for line in curve_figure(content)["lines"]}
    assert content["protocol"].endswith(".")


def test_section_of_runs_with_warnings(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(page, "packaged_curve", lambda: CURVE)
    rows: dict[str, Any] = columns(10)
    assert "false alarms per hour" not in report_page(summary(), rows, ())
    rows["contact_probability"] = np.full(10, 0.1)
    text = report_page(summary(), rows, ())
    assert "Three hours of &lt;simulated&gt; driving." in text
    assert text.count('fill="none" stroke="#') == 2
    monkeypatch.setattr(page, "packaged_curve", lambda: None)
    assert "false alarms per hour" not in report_page(summary(), rows, ())
