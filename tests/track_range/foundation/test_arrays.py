from __future__ import annotations

from typing import Any

import numpy as np
import pytest
from hypothesis import given, strategies as st

from track_range.detection.detections import Detections
from track_range.foundation.arrays import row_numbers
from track_range.tracking.tracks import Tracks

N = 4
DETECTIONS = Detections.of(np.tile([0.0, 0.0, 1.0, 1.0], (N, 1)), np.arange(N) / 10, np.arange(N))
TRACKS = Tracks(
    np.arange(N), DETECTIONS.xyxy_px, DETECTIONS.class_id, DETECTIONS.score, np.ones(N, np.bool_)
)

SELECTIONS = [
    [],
    [2, 0, 2],
    (1, -1),
    [True, False, False, True],
    range(3),
    slice(1, None),
    slice(None, None, -2),
    slice(2, 100),
    np.array([3, -4], np.int8),
    np.array([1, 2], np.uint64),
    np.zeros(0, np.int64),
    np.array([False, True, True, False]),
]


@pytest.mark.parametrize("rows", SELECTIONS, ids=repr)
def test_selected_rows_are_those_of_numpy(rows: Any) -> None:
    expected = np.arange(N)[list(rows) if isinstance(rows, tuple | range) else rows].tolist()
    assert DETECTIONS.select(rows).class_id.tolist() == expected
    assert TRACKS.select(rows).track_id.tolist() == expected


@pytest.mark.parametrize(
    "rows",
    [
        np.ones(N - 1, bool),
        np.ones(N + 1, bool),
        np.zeros(0, bool),
        [True],
        np.array([N]),
        [-N - 1],
        [0.5],
    ],
)
def test_rows_that_do_not_exist(rows: Any) -> None:
    for select in (DETECTIONS.select, TRACKS.select):
        with pytest.raises(IndexError):
            select(rows)


@given(st.lists(st.booleans(), max_size=8))
def test_masks_and_row_numbers(mask: list[bool]) -> None:
    rows = row_numbers(np.array(mask, np.bool_), len(mask))
    assert rows.tolist() == [i for i, is_selected in enumerate(mask) if is_selected]
    assert row_numbers(rows, len(mask)) is rows
