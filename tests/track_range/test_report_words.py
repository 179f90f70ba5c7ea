"""The report's sentences, cards and tables."""

from __future__ import annotations

from typing import Any

import pytest

from track_range.report.grids import accuracy_grids, mot_grid, speed_grids, stage_bars
from track_range.report.sentences import best_method, cards, flattened, geometry_words, run_name, sigma_words


def row(median_pct: float | None, **more: Any) -> dict[str, Any]:
    return {"coverage": 0.93, "n": 41, "median_relative_error_pct": median_pct, **more}


def alignment(**more: Any) -> dict[str, Any]:
    found = {"offset_px": 0.2, "bow_px": 0.0, "row_offset_px": 0.1, "residual_px": 0.1, "source": "this drive", **more}
    return {"calibration": "rig", "alignment": {"is_applied": True, **found}}


def texts(grid: Any) -> list[list[str]]:
    return [[cell.text for cell in cells] for cells in grid.rows]


def test_a_run_is_named_after_its_inputs() -> None:
    assert (
        run_name({"inputs": {"left": "/long/way/drive/left.mp4", "right": "right.mp4"}}) == "drive/left.mp4 + right.mp4"
    )
    assert run_name({}) == "A run"


def test_cards_say_what_is_known() -> None:
    assert [card["name"] for card in cards({"frames": 3})] == ["frames", "tracks"]
    found = {"frames": 3, "wall_s": 1.5, "tracks": {"n": 1, "hota": 50.04, "idsw": 1}, "methods": {"mono": row(4.0)}}
    assert [(card["value"], card["detail"]) for card in cards(found)] == [
        ("3", "in 1.5 s"),
        ("2.0", "all stages, wall clock"),
        ("1", "confirmed road users"),
        ("4.0 %", "mono, the best where it measured"),
        ("50.0 %", "1 identity switch"),
    ]


def test_what_is_said_of_errors_is_of_the_fused_distance() -> None:
    found = {"methods": {"fused": row(2.0), "stereo": row(1.5)}}
    assert [card["detail"] for card in cards(found)][-1] == (
        "fused in 41 track-frames; best: stereo 1.5 % where it measured"
    )
    assert [card["value"] for card in cards(found)][-1] == "2.0 %"
    found["methods"]["fused"] = row(1.0)
    assert [card["detail"] for card in cards(found)][-1] == "fused, the best where it measured"


def test_few_errors_cannot_tell_a_sigma_wrong() -> None:
    told = [sigma_words({"methods": {"a": row(1.0, within_1_sigma=0.86) | {"n": n}}})[0] for n in (7, 70)]
    assert told == [
        "a: about right (86 % of its 7 errors within one sigma, 68 % expected)",
        "a: too wide (86 % of its 70 errors within one sigma, 68 % expected)",
    ]


def test_common_coverage_decides_which_method_is_best() -> None:
    methods = {"mono": row(7.9), "stereo": row(3.4)}
    assert best_method({"methods": methods, "common": {"mono": row(2.5), "stereo": row(2.6)}}) == (
        "mono",
        2.5,
        "on common coverage",
    )
    assert best_method({"methods": methods, "common": {"mono": row(None)}}) == ("stereo", 3.4, "where it measured")
    assert best_method({}) is None


@pytest.mark.parametrize(
    ("found", "words"),
    [
        ({"offset_px": 0.2}, "Disparities read 0.20 px too small, as told by this drive: corrected."),
        ({"offset_px": -0.2}, "Disparities read 0.20 px too large, as told by this drive: corrected."),
        ({"is_applied": False}, "too little to be sure of, so they are taken as they are."),
        ({"bow_px": -0.5}, "0.20 px too small, and by 0.50 px less at the side edges"),
        ({"offset_px": 0.0}, "The disparities' own error: this drive."),
        ({"row_offset_px": 0.1}, "Left and right agree in their rows (+0.10 px)"),
        ({"row_offset_px": -0.001}, "Left and right agree in their rows (+0.00 px)"),
        ({"row_offset_px": -1.5}, "Left and right are -1.50 px apart in their rows"),
        ({"residual_px": 0.1}, "A doubt of 0.10 px is left; it is part of every sigma."),
    ],
)
def test_alignment_is_told_in_plain_words(found: Any, words: str) -> None:
    assert words in " ".join(geometry_words(alignment(**found)))


def test_the_doubt_is_told_in_metres_where_the_rig_is_known() -> None:
    found = alignment(residual_px=0.1) | {"focal_px": 1000.0, "baseline_m": 0.5}
    assert "0.10 px is left, which is 0.50 m at 50 m" in geometry_words(found)[-1]  # 50^2 0.1 / (1000 0.5)


@pytest.mark.parametrize(
    ("found", "words"),
    [
        ({"calibration": "rig", "inputs": {"rig": "r.yaml"}}, ["Metres come from a calibration: r.yaml."]),
        ({"calibration": "rig"}, ["Metres come from a calibration found beside the video."]),
        (
            {"calibration": "focal length"},
            ["Metres come from the focal length that was given; nobody has calibrated the lens."],
        ),
        ({}, []),
    ],
)
def test_where_metres_come_from(found: Any, words: list[str]) -> None:
    assert geometry_words(found) == words


def test_an_uncalibrated_run_says_how_wrong_it_may_be() -> None:
    scale = {"n_tracks": 7, "baseline_m": 0.518, "focal_px": 800.2, "relative_sigma": 0.26}
    first, second = geometry_words({"calibration": "estimated", "learnt_scale": scale})
    assert first.startswith("Uncalibrated")
    assert second == (
        "The sizes of 7 tracks say a baseline of 0.52 m at a focal length of 800 px: all distances may be wrong by "
        "26 % together."
    )


def test_sigmas_are_judged() -> None:
    methods = {
        "a": row(1.0, within_1_sigma=0.7),
        "b": row(1.0, within_1_sigma=0.9),
        "c": row(1.0, within_1_sigma=0.4),
        "d": row(None),
    }
    assert [sentence.split(" (")[0] for sentence in sigma_words({"methods": methods})] == [
        "a: about right",
        "b: too wide",
        "c: too narrow",
    ]


def test_nested_settings_become_dotted_names_and_lists_lines() -> None:
    tree = {"a": {"b": 1, "c": {"d": None}}, "e": "x", "f": ["l", "r"]}
    assert list(flattened(tree)) == [("a.b", "1"), ("a.c.d", "-"), ("e", "x"), ("f", "l, r")]


def test_errors_by_kind_of_road_user() -> None:
    by_class = {"Car": {"median_relative_error_pct": 2.0}, "Van": {"median_relative_error_pct": 9.0}}
    methods = {
        "mono": row(3.0, by_class=by_class),
        "stereo": row(1.0, by_class={"Car": {"median_relative_error_pct": 1.0}}),
    }
    grid = accuracy_grids({"methods": methods})[-1]
    assert grid.columns == ("method", "Car %", "Van %")
    assert texts(grid) == [["mono", "2.0", "9.0"], ["stereo", "1.0", "-"]]
    assert [grid.title for grid in accuracy_grids({"methods": {"mono": row(None)}})] == ["Coverage of each method"]


def test_metrics_of_tracking_that_were_measured() -> None:
    grid = mot_grid({"n": 3, "hota": 52.06, "idsw": 5, "mota": None, "classes": ["car"]})
    assert texts(grid) == [["HOTA %", "52.1"], ["id switches", "5"]]


def test_bars_of_stages_that_ran() -> None:
    summary = {"stages_ms": {"read": 2.0, "detect": 8.0, "lane": 0.0, "sgbm": None}}
    assert stage_bars(summary) == [
        {"name": "read", "text": "2.0", "share_pct": 25.0},
        {"name": "detect", "text": "8.0", "share_pct": 100.0},
    ]
    assert stage_bars({}) == speed_grids({}) == []
