"""The demo's screen: what was found, how accurate it is, where the files are."""

import pyarrow as pa
import pytest

from track_range.cli.commands.demo import accuracy_lines, track_grid


def rows(*values):
    names = ("time_s", "track_id", "class", "observed", "fused_kf_m", "closing_mps", "ttc_front_s")
    return pa.table({name: [row[k] for row in values] for k, name in enumerate(names)})


def test_tracks_per_class():
    grid = track_grid(
        rows(
            (0.0, 1, "car", True, 20.0, None, None),
            (0.5, 1, "car", True, 15.0, 10.0, 1.5),
            (1.0, 1, "car", False, 3.0, 30.0, 0.1),  # predicted
            (0.0, 2, "car", True, 40.0, -2.0, None),
            (0.5, 3, "person", True, 8.5, 1.25, 6.8),
        )
    )
    assert [[cell.text for cell in row] for row in grid.rows] == [
        ["person", "1", "0.0", "8.5", "1.2", "6.8"],
        ["car", "2", "0.5", "15.0", "10.0", "1.5"],
    ]


def test_no_tracks():
    assert track_grid(rows()).rows == ()


@pytest.mark.parametrize(
    ("fused", "expected"),
    [
        (
            {"median_relative_error_pct": 0.41, "mean_relative_error_pct": 1.4, "n": 416},
            "median error 0.4 %, mean 1.4 %, over 416 boxes",
        ),
        ({"n": 0}, "median error - %, mean - %, over 0 boxes"),
    ],
)
def test_accuracy_of_distance(fused, expected):
    summary = {
        "methods": {"fused_kf": fused},
        "closing": {},
        "tracks": {"n": 3, "idf1": 45.2, "mota": 26.1, "idsw": 12},
    }
    lines = dict(accuracy_lines(summary))
    assert lines["distance"] == expected
    assert lines["tracks"] == "IDF1 45 %, MOTA 26 %, 12 identity switches"
