"""Tables of a summary: figures, marks of the best ones, and omitted columns."""

from __future__ import annotations

import io
from typing import Any

import pytest
from rich.console import Console

from track_range.cli.shared.console import print_grid, print_summary
from track_range.views.tables import (
    SIGMA,
    Cell,
    Grid,
    frames_per_s,
    grids,
    markdown,
    method_grid,
)

STEREO = {
    "coverage": 0.984,
    "n": 120,
    "mean_relative_error_pct": 4.31,
    "median_relative_error_pct": 3.26,
    "bias_pct": -1.42,
    "within_1_sigma": 0.61,
    "within_2_sigma": 0.95,
    "bands": [
        {"from_m": 5, "to_m": 10, "n": 0, "mean_relative_error_pct": None},
        {"from_m": 10, "to_m": 20, "n": 60, "mean_relative_error_pct": 2.04},
    ],
}
MONO = {
    "coverage": 1.0,
    "n": 122,
    "mean_relative_error_pct": 9.96,
    "median_relative_error_pct": 7.9,
    "bias_pct": 0.4,
    "within_1_sigma": 0.70,
    "within_2_sigma": 0.99,
    "bands": [{"from_m": 10, "to_m": 20, "n": 62, "mean_relative_error_pct": 8.0}],
}
UNMEASURED = dict.fromkeys(["n", *(key for key in STEREO if key not in ("coverage", "n", "bands"))])
SUMMARY: dict[str, Any] = {
    "frames": 16,
    "wall_s": 2.0,
    "frames_per_s": 8.0,
    "stages_ms": {"read": 2.0, "detect": 62.5, "lane": None, "sgbm": 0.0},
    "methods": {"mono": MONO, "stereo": STEREO},
    "common": {"mono": {**MONO, "n": 118}, "stereo": {**STEREO, "n": 118}},
    "tracks": {"n": 5, "mota": 88.12, "idf1": 91.0, "idsw": 0},
    "notes": ["The rig was taken from calib.txt."],
    "truth": "the visible surface",
}


def texts(rows: tuple[tuple[Cell, ...], ...]) -> list[list[str]]:
    return [[cell.text for cell in row] for row in rows]


def bests(rows: tuple[tuple[Cell, ...], ...]) -> list[list[str]]:
    return [[cell.text for cell in row if cell.best] for row in rows]


def test_closing_speed_table() -> None:
    closing = {
        "coverage": 0.694,
        "n": 308,
        "mean_error_mps": 0.4025,
        "median_error_mps": 0.217,
        "bias_mps": 0.0145,
        "within_1_sigma": 0.9026,
        "within_2_sigma": None,
        "median_sigma_mps": 0.7,
    }
    closing_grids = [
        grid
        for grid in grids({**SUMMARY, "closing": closing})
        if grid.title == "Error of the closing speed"
    ]
    assert closing_grids[0].columns == (
        "method",
        "coverage %",
        "n",
        "mean m/s",
        "median m/s",
        "bias m/s",
        f"\u22641{SIGMA} %",
        f"{SIGMA} m/s",
    )
    assert texts(closing_grids[0].rows) == [
        ["fused_kf", "69", "308", "0.40", "0.22", "+0.01", "90", "0.70"]
    ]
    assert not any(grid.title == "Error of the closing speed" for grid in grids(SUMMARY))


def test_method_rows_by_hand() -> None:
    grid = method_grid("Distance", {"mono": MONO, "stereo": STEREO})
    assert grid.columns == (
        *(
            "method",
            "coverage %",
            "n",
            "mean %",
            "median %",
            "bias %",
            "\u22641\u03c3 %",
            "\u22642\u03c3 %",
        ),
        "10-20 m",
    )
    assert texts(grid.rows) == [
        ["mono", "100", "122", "10.0", "7.9", "+0.4", "70", "99", "8.0"],
        ["stereo", "98", "120", "4.3", "3.3", "-1.4", "61", "95", "2.0"],
    ]


def test_best_value_of_each_column() -> None:
    grid = method_grid("Distance", {"mono": MONO, "stereo": STEREO})
    assert bests(grid.rows) == [["100", "+0.4", "70"], ["4.3", "3.3", "95", "2.0"]]


def test_best_bias_is_nearest_to_zero() -> None:
    grid = method_grid("Distance", {"a": {"bias_pct": -30.0}, "b": {"bias_pct": 2.0}})
    assert bests(grid.rows) == [[], ["+2.0"]]


def test_equal_texts_are_equally_good() -> None:
    grid = method_grid(
        "Distance", {"a": {"mean_relative_error_pct": 2.01}, "b": {"mean_relative_error_pct": 2.04}}
    )
    assert bests(grid.rows) == [["2.0"], ["2.0"]]


def test_single_method_is_not_marked_best() -> None:
    assert bests(method_grid("Distance", {"mono": MONO}).rows) == [[]]


def test_missing_values_and_empty_columns() -> None:
    methods = {"mono": MONO, "sgbm": {"coverage": float("nan"), **UNMEASURED, "bands": []}}
    grid = method_grid("Distance", methods)
    assert texts(grid.rows)[1] == ["sgbm"] + ["-"] * 8
    without_truth = method_grid(
        "Distance", {"mono": {"coverage": 0.5, **UNMEASURED, "bands": None}}
    )
    assert without_truth.columns == ("method", "coverage %")
    assert texts(without_truth.rows) == [["mono", "50"]]


def test_uncertainty_and_run_time_without_truth() -> None:
    summary = {
        "methods": {
            "mono": {"median_sigma_pct": 7.31},
            "fused": {"median_sigma_pct": 4.0},
            "lane": {"coverage": 0.0},
        },
        "stages_ms": {"mono": 0.104, "fuse": 1.0, "lane": 0.0},
    }
    table = grids(summary)[1]
    assert table.columns == ("method", "\u03c3 %", "ms/frame")
    assert texts(table.rows) == [
        ["mono", "7.3", "0.10"],
        ["fused", "4.0", "1.00"],
        ["lane", "-", "-"],
    ]


def test_speed_rows() -> None:
    speed = grids(SUMMARY)[2]
    assert texts(speed.rows) == [
        ["read", "2.00", "500.0"],
        ["detect", "62.50", "16.0"],
        ["whole run", "125.00", "8.0"],
    ]


def test_frame_rate_of_a_run() -> None:
    assert frames_per_s({"frames": 16, "wall_s": 2.0}) == 8.0
    assert frames_per_s({"frames": 16, "wall_s": 2.0, "frames_per_s": 7.5}) == 7.5
    assert frames_per_s({"frames": 16, "wall_s": None}) is None
    assert frames_per_s({"frames": 0, "wall_s": 2.0}) is None
    assert frames_per_s({}) is None


def test_titles() -> None:
    titles = [grid.title for grid in grids(SUMMARY)]
    assert "118" in titles[1]
    assert "Run time" in titles[2]
    assert titles[3] == "Tracks"
    assert texts(grids(SUMMARY)[3].rows) == [["all", "5", "88.1", "91.0", "0"]]


@pytest.mark.parametrize(
    "empty", [{}, {"methods": {}, "common": None, "tracks": None, "stages_ms": {}}]
)
def test_empty_summary_has_no_tables(empty: dict[str, Any]) -> None:
    assert grids(empty) == []
    assert printed(empty, width=80) == ""
    assert markdown(empty) == ""


def test_markdown_with_best_figures_bold() -> None:
    lines = markdown(SUMMARY).splitlines()
    assert "| stereo | 98 | 120 | **4.3** | **3.3** | -1.4 | 61 | **95** | **2.0** |" in lines
    assert "Ground truth: the visible surface" in lines
    assert lines[-1] == "- The rig was taken from calib.txt."
    assert {line.count("|") for line in lines if line.startswith("| ")} == {10, 4, 6}


def test_markdown_escapes_pipes() -> None:
    assert "| a\\|b | 100 |" in markdown({"methods": {"a|b": {"coverage": 1}}})


def printed(summary: dict[str, Any], *, width: int) -> str:
    console = Console(file=io.StringIO(), width=width, force_terminal=False)
    print_summary(console, summary)
    file = console.file
    assert isinstance(file, io.StringIO)
    return file.getvalue()


def test_five_bands_fit_into_80_columns() -> None:
    bands = [
        {"from_m": low, "to_m": high, "n": 100, "mean_relative_error_pct": 10.5}
        for low, high in ((5, 10), (10, 20), (20, 30), (30, 50), (50, 100))
    ]
    shown = printed({"methods": {"stereo_kf": {**STEREO, "n": 12345, "bands": bands}}}, width=80)
    assert "…" not in shown
    assert "12345" in shown
    assert "50-100" in shown
    assert shown.count("bias") == 1  # not split


def test_rich_markup_in_a_name_is_literal() -> None:
    assert "[red]x[/]" in printed({"methods": {"[red]x[/]": {"coverage": 1.0}}}, width=80)


def wide_grid(n_columns: int) -> Grid:
    columns = tuple(f"figure{i:02d}" for i in range(n_columns))
    return Grid(
        "Many",
        ("method", *columns),
        ((Cell("mono"), *(Cell(f"{i}.12345") for i in range(n_columns))),),
    )


@pytest.mark.parametrize(("width", "n_parts"), [(30, 6), (80, 2), (200, 1)])
def test_wide_grid_is_split_between_columns(width: int, n_parts: int) -> None:
    console = Console(file=io.StringIO(), width=width, force_terminal=False)
    print_grid(console, wide_grid(12))
    assert isinstance(console.file, io.StringIO)
    shown = console.file.getvalue()
    figures = [word for word in shown.split() if word.endswith(".12345")]
    assert figures == [f"{i}.12345" for i in range(12)]
    assert max(map(len, shown.splitlines())) <= width
    assert shown.count("method") == n_parts
    assert shown.count("Many") == 1


def test_methods_that_are_only_shown_are_marked() -> None:
    row = {"coverage": 1.0, "median_sigma_pct": 0.1}
    methods = dict.fromkeys(("mono", "depth", "depth_kf", "depth-b"), row)
    summary = {"methods": methods, "shown_only": ["depth"], "stages_ms": {"depth": 12.0}}
    names = ["mono", "depth (not fused)", "depth_kf (not fused)", "depth-b"]
    tables_of_run = [grid for grid in grids(summary) if grid.columns[0] == "method"]
    assert [[one[0].text for one in grid.rows] for grid in tables_of_run] == [names] * 2
    (times,) = [grid for grid in tables_of_run if "ms/frame" in grid.columns]
    assert times.rows[1][-1].text == "12.00"
