"""The demo's screen: how accurate it is."""

import pytest

from track_range.cli.commands.demo import accuracy_lines


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
