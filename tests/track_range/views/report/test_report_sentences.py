"""The report's sentences, cards and tables."""

from __future__ import annotations

from typing import Any

import pytest

from track_range.views.report.sentences import (
    flattened,
    geometry_sentences,
    run_name,
    sigma_sentences,
)
from track_range.views.tables import accuracy_grids, mot_grid


def row(median_pct: float | None, **more: Any) -> dict[str, Any]:
    return {"coverage": 0.93, "n": 41, "median_relative_error_pct": median_pct, **more}


def alignment(**more: Any) -> dict[str, Any]:
    values = {
        "offset_px": 0.2,
        "bow_px": 0.0,
        "row_offset_px": 0.1,
        "residual_px": 0.1,
        "source": "this drive",
        **more,
    }
    return {"calibration": "rig", "alignment": {"is_applied": True, **values}}


def texts(grid: Any) -> list[list[str]]:
    return [[cell.text for cell in cells] for cells in grid.rows]


def test_run_name() -> None:
    assert (
        run_name({"inputs": {"left": "/long/way/drive/left.mp4", "right": "right.mp4"}})
        == "drive/left.mp4 "
        "+ "
        "right.mp4"
    )
    assert run_name({}) == "A run"


def test_sigma_verdict_depends_on_sample_size() -> None:
    verdicts = [
        sigma_sentences({"methods": {"a": row(1.0, within_1_sigma=0.86) | {"n": n}}})[0]
        for n in (7, 70)
    ]
    assert "about right" in verdicts[0]
    assert "too large" in verdicts[1]
    assert "70 errors" in verdicts[1]


@pytest.mark.parametrize(
    ("changed", "words"),
    [
        ({"offset_px": 0.2}, ("0.20 px too small", "this drive", "corrected")),
        ({"offset_px": -0.2}, ("0.20 px too large",)),
        ({"is_applied": False}, ("not applied",)),
        ({"bow_px": -0.5}, ("0.20 px too small", "0.50 px less")),
        ({"offset_px": 0.0}, ("Disparity error", "this drive")),
        ({"row_offset_px": 0.1}, ("Vertical offset", "+0.10 px")),
        ({"row_offset_px": -0.001}, ("+0.00 px",)),
        ({"row_offset_px": -1.5}, ("-1.50 px", "not fit")),
        ({"residual_px": 0.1}, ("0.10 px", "every sigma")),
    ],
)
def test_alignment_sentences(changed: Any, words: tuple[str, ...]) -> None:
    text = " ".join(geometry_sentences(alignment(**changed)))
    assert all(word in text for word in words)


def test_residual_disparity_in_metres() -> None:
    summary = alignment(residual_px=0.1) | {"focal_px": 1000.0, "baseline_m": 0.5}
    assert "0.10 px (0.50 m at 50 m)" in geometry_sentences(summary)[-1]  # 50^2 0.1 / (1000 0.5)


@pytest.mark.parametrize(
    ("summary", "word"),
    [
        ({"calibration": "rig", "inputs": {"rig": "r.yaml"}}, "r.yaml"),
        ({"calibration": "rig"}, "calibration file"),
        ({"calibration": "focal length"}, "The focal length"),
        ({}, ""),
    ],
)
def test_calibration_sentence(summary: Any, word: str) -> None:
    assert word in " ".join(geometry_sentences(summary))
    assert len(geometry_sentences(summary)) == bool(summary)


def test_uncalibrated_run_names_its_uncertainty() -> None:
    scale = {"n_tracks": 7, "baseline_m": 0.518, "focal_px": 800.2, "relative_sigma": 0.26}
    first, second = geometry_sentences({"calibration": "estimated", "learnt_scale": scale})
    assert first.startswith("Uncalibrated")
    assert all(figure in second for figure in ("7 tracks", "0.52 m", "800 px", "26 %"))


def test_focal_length_of_the_run_is_named_with_its_evidence() -> None:
    learnt = {"focal_px": 1148.2, "focal_sigma": 0.012, "source": "the turn at 0:42", "since_s": 45}
    (sentence,) = geometry_sentences({"calibration": "estimated", "learnt_focal": learnt})
    assert sentence.startswith("Not calibrated")
    assert all(part in sentence for part in ("1,148 px", "1.2 %", "the turn at 0:42", "45.0 s"))


def test_sigma_verdicts() -> None:
    methods = {
        "a": row(1.0, within_1_sigma=0.7),
        "b": row(1.0, within_1_sigma=0.9),
        "c": row(1.0, within_1_sigma=0.4),
        "d": row(None),
    }
    assert [sentence.split(" (")[0] for sentence in sigma_sentences({"methods": methods})] == [
        "a: about right",
        "b: too large",
        "c: too small",
    ]


def test_flattened_settings() -> None:
    tree = {"a": {"b": 1, "c": {"d": None}}, "e": "x", "f": ["l", "r"]}
    assert list(flattened(tree)) == [("a.b", "1"), ("a.c.d", "-"), ("e", "x"), ("f", "l, r")]


def test_errors_by_class() -> None:
    by_class = {
        "Car": {"median_relative_error_pct": 2.0},
        "Van": {"median_relative_error_pct": 9.0},
    }
    methods = {
        "mono": row(3.0, by_class=by_class),
        "stereo": row(1.0, by_class={"Car": {"median_relative_error_pct": 1.0}}),
    }
    grid = accuracy_grids({"methods": methods})[-1]
    assert grid.columns == ("method", "Car %", "Van %")
    assert texts(grid) == [["mono", "2.0", "9.0"], ["stereo", "1.0", "-"]]
    assert [grid.title for grid in accuracy_grids({"methods": {"mono": row(None)}})] == [
        "Coverage of each method"
    ]


def test_tracking_metrics() -> None:
    grid = mot_grid({"n": 3, "hota": 52.06, "idsw": 5, "mota": None, "classes": ["car"]})
    assert texts(grid) == [["HOTA %", "52.1"], ["ID switches", "5"]]


def test_name_of_a_run_on_several_files() -> None:
    assert (
        run_name({"inputs": {"mono": ["/drives/a/1.mp4", "/drives/a/2.mp4", "/drives/a/3.mp4"]}})
        == "a/1.mp4 and 2 more"
    )
    assert (
        run_name({"inputs": {"left": "/drives/l.mp4", "right": ["/drives/r.mp4"]}})
        == "drives/l.mp4 + drives/r.mp4"
    )
