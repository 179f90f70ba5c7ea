"""Reading a summary that was damaged, edited or written by another version."""

from __future__ import annotations

from typing import Any

import pytest

from track_range.results.rows.rows import Rows
from track_range.results.summary_shape import valid_summary
from track_range.views.report.page import report_page

NO_ROWS = Rows()
WHOLE: dict[str, Any] = {
    "frames": 3,
    "wall_s": 1.5,
    "stages_ms": {"read": 2.0},
    "methods": {
        "mono": {
            "n": 3,
            "bands": [{"from_m": 5.0, "to_m": 10.0, "n": 1}],
            "by_class": {"Car": {"n": 3}},
        }
    },
    "common": {},
    "tracks": {"n": 1, "mota": None, "classes": ["car"]},
    "alignment": {"offset_px": 0.1, "source": "this drive", "is_applied": True},
    "learnt_scale": {"n_tracks": 3, "baseline_m": 0.5, "focal_px": 700.0, "relative_sigma": 0.2},
    "learnt_focal": {"focal_px": 7.0, "focal_sigma": 0.1, "source": "the turn", "since_s": 3.0},
    "inputs": {"left": "a.mp4"},
    "files": {"overlay": "overlay.mp4"},
    "versions": {"python": "3"},
    "notes": ["one"],
    "truth": None,
    "of tomorrow": [1, {"a": 2}],
}


def test_valid_summary_is_unchanged() -> None:
    assert valid_summary(WHOLE) == (WHOLE, [])


@pytest.mark.parametrize(
    ("part", "name"),
    [
        ({"frames": "x"}, "frames"),
        ({"wall_s": float("inf")}, "wall_s"),
        ({"starts_s": float("nan")}, "starts_s"),
        ({"stages_ms": 7}, "stages_ms"),
        ({"stages_ms": {"read": "slow", "detect": 3.0}}, "stages_ms.read"),
        ({"methods": 3}, "methods"),
        ({"methods": {"mono": None}}, "methods.mono"),
        ({"methods": {"mono": {"n": [1]}}}, "methods.mono.n"),
        ({"methods": {"mono": {"bands": [1]}}}, "methods.mono.bands.0"),
        ({"methods": {"mono": {"bands": [{"from_m": 5.0}]}}}, "methods.mono.bands.0"),
        ({"methods": {"mono": {"by_class": 3}}}, "methods.mono.by_class"),
        ({"common": []}, "common"),
        ({"tracks": [1]}, "tracks"),
        ({"tracks": {"classes": "car"}}, "tracks.classes"),
        ({"alignment": {"offset_px": "a", "row_offset_px": 0.1}}, "alignment.offset_px"),
        ({"learnt_scale": {"n_tracks": 3}}, "learnt_scale"),
        ({"learnt_focal": {"focal_px": 700.0}}, "learnt_focal"),
        ({"inputs": "left"}, "inputs"),
        ({"versions": 3}, "versions"),
        ({"files": {"overlay": 3}}, "files.overlay"),
        ({"notes": "one"}, "notes"),
        ({"notes": ["one", 2]}, "notes.1"),
        ({"truth": {"a": 1}}, "truth"),
        ({"closing": "fast"}, "closing"),
    ],
)
def test_invalid_values_are_omitted(part: dict[str, Any], name: str) -> None:
    summary, invalid = valid_summary(WHOLE | part)
    assert invalid == [name]
    assert "<h2>Settings</h2>" in report_page(summary, NO_ROWS)


def test_other_values_of_a_section_are_used() -> None:
    notes = ["one", 2, *"abcdefgh", 10, "three"]  # item 10 goes before item 2
    summary, invalid = valid_summary({"stages_ms": {"read": "slow", "detect": 3.0}, "notes": notes})
    assert summary == {"stages_ms": {"detect": 3.0}, "notes": ["one", *"abcdefgh", "three"]}
    assert invalid == ["notes.1", "notes.10", "stages_ms.read"]


@pytest.mark.parametrize(
    ("part", "name"),
    [
        ({"frames": 10**400}, "frames"),
        ({"frames": float("inf")}, "frames"),
        ({"wall_s": 1e300}, "wall_s"),
    ],
)
def test_huge_figures_are_omitted(part: dict[str, Any], name: str) -> None:
    summary, invalid = valid_summary(WHOLE | part)
    assert invalid == [name]
    assert "<html" in report_page(summary, NO_ROWS)


@pytest.mark.parametrize(
    "part", [{"methods": {"fused": {"n": -4, "within_1_sigma": 0.5}}}, {"wall_s": 1e-300}]
)
def test_page_of_impossible_figures(part: dict[str, Any]) -> None:
    summary, _ = valid_summary(WHOLE | part)
    assert "<html" in report_page(summary, NO_ROWS)
