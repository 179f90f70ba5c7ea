"""Tables, headlines and histogram of a camera that stands still."""

import pytest

from track_range.views.report.content import counts

USERS = [
    {"track_id": i, "class": name, "speed_kmh": v, "speed_sigma_kmh": s, "from_s": 1.0 * i, "to_s": 9.0}
    for i, (name, v, s) in enumerate(
        [("car", 48.0, 2.0), ("car", 61.4, 3.2), ("person", 4.0, 1.0), ("car", None, None)], start=1
    )
]  # fmt: skip
LINE = {
    "n": 3,
    "by_direction": {"down": 2, "up": 1},
    "by_class": {"car": {"down": 1, "up": 1}, "person": {"down": 1}},
    "n_unsure": 0,
    "n_speeds": 3,
    "median_speed_kmh": 48.0,
    "p85_speed_kmh": 57.4,
}
ZONE = {"n_enter": 2, "n_exit": 2, "median_dwell_s": 3.25, "mean_speed_kmh": None}
SUMMARY = {
    "fixed_camera": {"ground": None, "road_users": USERS},
    "counts": {"lines": {"gate": LINE}, "zones": {"stop": ZONE}},
}


def texts(grid):
    return [[cell.text for cell in row] for row in grid.rows]


def test_headlines_are_counts_median_and_fastest():
    first, second, third = counts.fixed_headlines(SUMMARY)
    assert first["figure"] == "3 crossings"
    assert second["figure"] == "48 km/h"
    assert (third["figure"], third["time_s"]) == ("61 ±3 km/h", 2.0)
    without = {"fixed_camera": {"road_users": USERS[3:]}}
    assert [one["figure"] for one in counts.fixed_headlines(without)] == ["1 road user", "No speed"]


def test_tables():
    assert texts(counts.line_grid(SUMMARY))[:2] == [
        ["gate", "down", "2", "1", "1"],
        ["gate", "up", "1", "1", "0"],
    ]
    assert texts(counts.zone_grid(SUMMARY)) == [["stop", "2", "2", "3.2", "-"]]
    assert texts(counts.speed_grid(SUMMARY))[0] == [
        "car",
        "3",
        "2",
        "55",
        "61 ±3 km/h: car 2 at 2.0 s",
    ]
    assert not counts.line_grid({"fixed_camera": {}}).rows


def test_histogram_has_a_bar_for_each_speed():
    histogram = counts.speed_histogram(SUMMARY)
    heights = [bar["height"] for bar in histogram["bars"]]
    assert sum(height > 0 for height in heights) == 3
    assert histogram["bars"][-1]["words"] == "1 road user from 60 to 65 km/h"
    assert counts.speed_histogram({"fixed_camera": {"road_users": []}}) is None


@pytest.mark.parametrize("summary", [{}, {"fixed_camera": None}])
def test_other_runs_are_not_fixed(summary):
    assert not counts.is_fixed(summary)
