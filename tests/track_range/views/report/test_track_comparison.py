"""Road users of two runs on one video: matching, disagreement, and their pictures."""

from dataclasses import replace

import numpy as np
import pytest

from tests.track_range.views.report.report_rows import track_rows as rows
from track_range.results.rows.rows import Rows
from track_range.views.report.comparison import ComparedRun, compared_tracks
from track_range.views.report.page import comparison_page
from track_range.views.report.track_comparison import picture, track_differences
from track_range.views.tables import SIGMA
from track_range.views.videos.video_writer import VideoWriter

INPUTS = {"left": "drive/left.mp4", "right": "drive/right.mp4"}


def measured(*tracks, sigma_m=1.0, factor=1.0):
    """Rows of tracks at a distance of 20 m times a factor."""
    columns = rows(*tracks)
    columns["fused_m"] = factor * np.full(len(columns["frame"]), 20.0)
    columns["fused_sigma_m"] = np.full(len(columns["frame"]), sigma_m)
    columns["closing_mps"] = np.full(len(columns["frame"]), 2.0 * factor)
    return Rows(columns)


def farther(rows):
    """The first track 6 m farther in frame 7."""
    rows["fused_m"][7] += 6.0
    return rows


def test_largest_disagreement_of_matched_tracks_comes_first():
    first = measured((1, 300.0), (2, 700.0), (3, 1100.0))
    second = farther(measured((8, 700.0), (9, 305.0), sigma_m=0.5))
    (two, one), matched = track_differences(first, second)
    assert matched.tolist() == [[1.0, 2.0], [9.0, 8.0]]
    assert (two["names"], one["names"]) == (["car 2", "car 8"], ["car 1", "car 9"])
    assert (two["frames"], two["time_s"]) == (40, 0.7)
    assert two["sigmas"] == pytest.approx(6 / np.hypot(1.0, 0.5))
    assert two["words"] == ["20.0 ±1.0 m", "26.0 ±0.5 m"]
    assert [box[0] for box in one["boxes"]] == [300.0, 305.0]
    assert (two["difference_pct"], one["sigmas"]) == (0.0, 0.0)


def test_medians_of_all_common_frames():
    (one,), _ = track_differences(measured((1, 300.0)), measured((1, 300.0), factor=1.1))
    assert (one["difference_pct"], one["closing_mps"]) == (pytest.approx(10.0), pytest.approx(0.2))
    for other in (measured((1, 800.0)), Rows()):
        differences, matched = track_differences(measured((1, 300.0)), other)
        assert (differences, matched.shape) == ([], (2, 0))


def test_road_users_of_one_run_are_named():
    runs = [
        ComparedRun(
            name="stereo",
            summary={"inputs": INPUTS},
            settings={},
            rows=measured((1, 300.0), (2, 700.0)),
        ),
        ComparedRun(
            name="mono",
            summary={"inputs": {"mono": INPUTS["left"]}},
            settings={},
            rows=measured((5, 300.0)),
        ),
    ]
    (pair,) = compared_tracks(runs)
    assert pair["sentences"] == [
        "1 road user in both runs.",
        "Only in stereo: car 2 (20.0 m at 0.2 s).",
    ]
    assert [cell.text for cell in pair["grid"].rows[0]][:3] == [
        "car 1 / car 5",
        "0.0",
        "20.0 ±1.0 m → 20.0 ±1.0 m",
    ]
    assert pair["pictures"] == []  # no disagreement
    other = replace(runs[1], summary={"inputs": {"mono": "other/left.mp4"}})
    assert compared_tracks([runs[0], other]) == []
    assert "no other run is of the same video" in comparison_page([runs[0], other], [])


def test_road_users_with_few_common_distances_are_in_both_runs():
    """The second has two common distances; the first is a car in most frames, in some a truck."""
    first, second = (measured((1, 300.0), (2, 700.0)) for _ in range(2))
    second = second.with_columns({"class": np.where(np.arange(80) < 15, "truck", "car")})
    second["fused_m"][42:] = np.nan
    second["fused_m"][5] += 6.0  # the largest disagreement is in a frame of the other class
    runs = [
        ComparedRun(name=name, summary={"inputs": INPUTS}, settings={}, rows=columns)
        for name, columns in (("a", first), ("b", second))
    ]
    (pair,) = compared_tracks(runs)
    assert pair["sentences"] == ["1 road user in both runs."]
    assert [row[0].text for row in pair["grid"].rows] == ["car 1"]


def test_pictures_of_disagreements(tmp_path):
    overlay = tmp_path / "overlay.mp4"
    with VideoWriter(overlay, width_px=640, height_px=360, fps=10) as writer:
        for number in range(9):
            writer.write(np.full((360, 640, 3), 10 * number, np.uint8), number / 10)
    first = ComparedRun(
        name="a",
        summary={"inputs": INPUTS},
        settings={},
        rows=measured((1, 300.0)),
        overlay=overlay,
    )
    second = replace(first, name="b", rows=farther(measured((1, 300.0))), overlay=None)
    page = comparison_page([first, second], compared_tracks([first, second]))
    assert page.count('src="data:image/jpeg;base64,') == 1
    assert "b: 26.0 ±1.0 m (no overlay)" in page
    assert f"4.2 {SIGMA} apart" in page
    assert picture(overlay, 30.0, np.array([300.0, 100, 400, 200])) == ""
    assert picture(overlay, 0.0, np.array([3000.0, 100, 4000, 200])) == ""
