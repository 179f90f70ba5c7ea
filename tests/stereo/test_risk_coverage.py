"""Tests of risk-coverage curves and of the confidence measures of dense matching."""

from __future__ import annotations

import numpy as np
import pytest

from tests.support.recordings.kitti_folder import noise
from track_range.stereo.evaluation.dense_confidence import (
    MEASURES,
    confidence_measures,
    consistent_pixels,
)
from track_range.stereo.evaluation.disparity_errors import (
    MatcherColumn,
    certain_first,
    risk_coverage,
)
from track_range.stereo.matching.sgbm import SgbmSettings

TRUE_PX = np.array([20.0, 20.0, 20.0, 20.0])
COLUMN = MatcherColumn(np.array([16.0, 20.0, np.nan, 19.0]), np.array([2.0, 0.1, np.nan, 0.5]))
"""Errors of 25, 0 and 5.26 %; the third box has no value."""


def test_order_is_by_relative_sigma():
    assert certain_first(COLUMN).tolist() == [1, 3, 0, 2]
    assert certain_first(COLUMN, np.array([0.0, 1.0, 0.0, np.nan])).tolist() == [0, 1, 3, 2]
    assert certain_first(COLUMN, np.zeros(4)).tolist() == [1, 3, 0, 2]


def test_areas_by_hand():
    result = risk_coverage(COLUMN, TRUE_PX)
    assert result["area_failures_pct"] == pytest.approx(100 * (0 + 0 + 1 / 3 + 2 / 4) / 4, abs=1e-3)
    means = (0.0, 100 / 19 / 2, (100 / 19 + 25.0) / 3)
    assert result["area_error_pct"] == pytest.approx(sum(means) / 3, abs=1e-3)


def test_curve_by_hand():
    rows = {row["answered_pct"]: row for row in risk_coverage(COLUMN, TRUE_PX)["curve"]}
    assert list(rows) == list(range(5, 101, 5))
    assert [rows[fraction]["n"] for fraction in (5, 25, 50, 75, 100)] == [1, 1, 2, 3, 4]
    assert [rows[fraction]["failures_pct"] for fraction in (50, 75, 100)] == [
        0.0,
        pytest.approx(100 / 3, abs=1e-3),
        50.0,
    ]
    assert rows[50]["mean_relative_error_pct"] == pytest.approx(100 / 19 / 2, abs=1e-3)
    assert rows[75]["p95_relative_error_pct"] == rows[100]["p95_relative_error_pct"]


def test_curve_without_values():
    nothing = MatcherColumn(np.full(2, np.nan), np.full(2, np.nan))
    result = risk_coverage(nothing, np.ones(2))
    assert (result["area_failures_pct"], result["area_error_pct"]) == (100.0, None)
    assert result["curve"][-1]["mean_relative_error_pct"] is None
    empty = risk_coverage(MatcherColumn(np.zeros(0), np.zeros(0)), np.zeros(0))
    assert (empty["area_failures_pct"], empty["curve"][0]["n"]) == (None, 0)


def test_consistent_pixels_by_hand():
    left_px = np.array([[np.nan, 1.0, 2.0, 1.0, 9.0]], np.float32)
    right_px = np.array([[1.0, 5.0, 1.0, np.nan, 3.0]], np.float32)
    assert consistent_pixels(left_px, right_px).tolist() == [[False, True, True, True, False]]


def test_measures_of_a_flat_pair():
    wall = noise(0, width_px=368)
    left, right = wall[:, :360].copy(), wall[:, 8:].copy()
    right[:, 192:222] = noise(5, width_px=30)  # the second box has no match
    boxes = np.array(
        [[40.0, 20.0, 160.0, 100.0], [200.0, 20.0, 230.0, 100.0], [400.0, 0.0, 420.0, 20.0]]
    )
    measures = confidence_measures(left, right, boxes, SgbmSettings(n_disparities=32, mode="hh"))
    assert tuple(measures) == MEASURES
    for values in measures.values():
        assert values[0] < 0.05
        assert np.isnan(values[2])
        assert not values[1] <= values[0]
