"""Compact encoding of tracks: decoded values equal the originals to the centimetre."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
from hypothesis import given, settings, strategies as st

from track_range.results.rows.rows import Rows
from track_range.views.report.content.series import (
    LINE_POINTS,
    MOST_CELLS,
    packed,
    thinned,
    track_records,
)


def unpacked(text: str, ticks_per_unit: float) -> list[float]:
    """Decoding as in the script of the page."""
    values, last = [], 0
    for cell in text.split(","):
        last += int(cell or 0)
        values.append(last / ticks_per_unit if cell else np.nan)
    return values


def drive(*lengths: int, **more: Any) -> Rows:
    n = sum(lengths)
    number = np.concatenate([np.arange(float(length)) for length in lengths])
    columns = {
        "time_s": number / 10,
        "track_id": np.repeat(np.arange(1.0, len(lengths) + 1), lengths),
        "class": np.full(n, "car"),
        "observed": np.ones(n),
        "fused_m": 50.0 - number,
        "fused_sigma_m": np.full(n, 0.5),
        **more,
    }
    return Rows(columns)


def test_packing_by_hand() -> None:
    assert packed(np.array([25.261, np.nan, 25.102]), 100) == "2526,,-16"
    assert packed(np.array([np.nan, np.nan]), 100) == ","
    assert packed(np.array([1.0]), 1000) == "1000"
    assert packed(np.zeros(0), 100) == ""


@settings(deadline=None)
@given(st.lists(st.floats(-1e4, 1e4) | st.just(np.nan), min_size=1, max_size=40))
def test_packing_round_trip(values: list[float]) -> None:
    np.testing.assert_allclose(unpacked(packed(np.array(values), 100), 100), values, atol=0.0051)


def test_smallest_distance_is_rounded_once() -> None:
    (record,) = track_records(drive(3, fused_m=np.array([12.1, 12.648, 12.2])))
    assert record["near_m"] == 12.6


def test_track_record() -> None:
    truth_m = np.array([40.0, np.nan, 48.0])
    rows = drive(
        3,
        truth_m=truth_m,
        ttc_front_s=np.array([9.0, 7.5, np.nan]),
        closing_mps=np.array([np.nan, 1.25, 3.0]),
        observed=np.array([1.0, 0.0, 1.0]),
    ).with_columns({"class": np.array(["van", "car", "car"])})
    assert list(track_records(rows)) == [
        {
            "id": 1,
            "name": "car",
            "colour": "#537eff",
            "is_user": True,
            "n": 3,
            "from_s": 0.0,
            "to_s": 0.2,
            "near_m": None,  # of two frames that count, which support no extreme
            "ttc_s": None,
            "error_pct": 12.5,  # of 25 % and 0 %
            "t": "0,100,100",
            "truth": "4000,,800",
            "closing": ",12,18",
            "observed": "101",
            "m": {"fused": "5000,-100,-100"},
            "s": {"fused": "50,0,0"},
        }
    ]


def test_rows_of_several_tracks_interleaved() -> None:
    records = list(track_records(drive(2, 3).select(np.array([2, 0, 3, 1, 4]))))
    assert [(track["id"], track["n"], track["t"]) for track in records] == [
        (2, 3, "0,100,100"),
        (1, 2, "0,100"),
    ]


def test_no_track_no_record() -> None:
    assert list(track_records(drive(1).select(slice(0)))) == []


def test_measured_methods_in_column_order() -> None:
    empty = np.full(2, np.nan)
    rows = drive(
        2, sgbm_m=empty, mono_m=np.ones(2), truth_m=np.ones(2), x_m=np.ones(2), y_m=np.ones(2)
    )
    assert rows.methods_measured == ["fused", "mono"]


def test_long_line_is_thinned() -> None:
    assert thinned(5, 5).tolist() == [0, 1, 2, 3, 4]
    kept = thinned(10 * LINE_POINTS, LINE_POINTS)
    assert len(kept) == LINE_POINTS
    assert (kept[0], kept[-1]) == (0, 10 * LINE_POINTS - 1)
    (track,) = track_records(drive(10 * LINE_POINTS))
    assert track["n"] == 10 * LINE_POINTS
    assert len(track["t"].split(",")) == LINE_POINTS


def test_only_long_tracks_are_thinned() -> None:
    records = list(track_records(drive(*[1000] * 900, 20)))
    cells = sum(
        len(text.split(","))
        for track in records
        for text in (track["t"], track["m"]["fused"], track["s"]["fused"])
    )
    assert 0.3 * MOST_CELLS < cells <= MOST_CELLS
    assert len(records[-1]["t"].split(",")) == 20


@pytest.mark.parametrize("limit", [2, 7, 100])
def test_thinning_is_even(limit: int) -> None:
    steps = np.diff(thinned(1000, limit))
    assert steps.max() - steps.min() <= 1
