"""Closest approaches: which approach_rows count, and the moment of each extreme."""

import numpy as np

from tests.support.results.approach_rows import NAN, ROWS
from track_range.results.approaches import closest_approaches, row_of_smallest, track_extremes
from track_range.results.rows.rows import Rows


def test_detected_and_certain_rows_count():
    person, car, bus = closest_approaches(ROWS)  # nearest first, unknown last
    assert (person["track_id"], person["min_distance_m"], person["min_distance_sigma_m"]) == (
        2,
        8.5,
        None,
    )
    assert person["max_closing_mps"] is None  # it goes away
    assert car == {
        "track_id": 1,
        "class": "car",
        "min_distance_m": 15.0,
        "min_distance_sigma_m": 0.3,
        "min_distance_m_at_s": 0.5,
        "max_closing_mps": 10.0,
        "max_closing_sigma_mps": 1.0,
        "max_closing_mps_at_s": 0.5,
        "min_ttc_front_s": 1.5,
        "min_ttc_s": 1.5,
        "min_ttc_s_at_s": 0.5,
        "min_ttc_front_s_at_s": 0.5,
    }
    assert {value for key, value in bus.items() if key not in ("track_id", "class")} == {None}


def test_extremes_of_all_tracks():
    assert [row["track_id"] for row in track_extremes(ROWS)] == [1, 2, 3, 4]


def test_fused_distance_without_a_filter():
    columns = {
        "time_s": np.array([0.0, 0.1, 0.2, 0.3]),
        "track_id": np.ones(4),
        "class": np.array(["car"] * 4),
        "fused_m": [NAN, 7.0, 7.0, 7.0],
    }
    (row,) = closest_approaches(Rows(columns))
    assert (row["min_distance_m"], row["min_distance_sigma_m"], row["min_ttc_front_s"]) == (
        7.0,
        None,
        None,
    )


def test_no_rows():
    assert closest_approaches(ROWS.select(slice(0))) == []


def test_row_of_the_smallest_known_value():
    values = np.array([1.0, np.nan, 3.0, 2.0, 2.0])
    assert row_of_smallest(values, np.array([1, 2, 3, 4])) == 3
    assert row_of_smallest(values, np.array([1])) is None
