"""Data of the charts of errors and of the calibration of sigma."""

from __future__ import annotations

import numpy as np
import pytest

from track_range.results.rows.rows import Rows
from track_range.views.report.content.errors import (
    SCATTER_POINTS,
    calibration_curves,
    error_curves,
    median_by_distance,
)

BANDS = [
    {"from_m": 5.0, "to_m": 10.0, "mean_relative_error_pct": 3.0},
    {"from_m": 10.0, "to_m": 20.0, "mean_relative_error_pct": None},
]


def drive(n: int, *, sigma: float = 0.02, truth: bool = True) -> Rows:
    """Errors of fused are drawn with a relative standard deviation of 2 %."""
    rng = np.random.default_rng(5)
    true_m = rng.uniform(10, 60, n)
    columns = {
        "time_s": np.zeros(n),
        "fused_m": true_m * (1 + 0.02 * rng.standard_normal(n)),
        "fused_sigma_m": true_m * sigma,
        "fused_kf_m": true_m * 1.01,
    }
    return Rows(columns | ({"truth_m": true_m} if truth else {}))


def test_medians_by_hand() -> None:
    distance_m = np.array([10.0, 15, 19.9, 21, 22, 35, 36, 37, np.nan])
    error_pct = np.array([1.0, 5, 2, 9, 9, -1, np.nan, -3, 4])
    middles_m, medians = median_by_distance(distance_m, error_pct)
    assert middles_m.tolist() == [15.0]
    assert medians.tolist() == [2.0]
    assert [len(part) for part in median_by_distance(distance_m[:0], error_pct[:0])] == [0, 0]


def test_errors_are_relative_to_the_truth() -> None:
    columns = {
        "time_s": np.zeros(4),
        "mono_m": np.array([11.0, np.nan, 19.0, 7.0]),
        # a truth of no distance has no relative error
        "truth_m": np.array([10.0, 10.0, 20.0, 0.0]),
    }
    assert error_curves(Rows(columns), {}) == {
        "mono": {"points": [[10.0, 20.0], [10.0, -5.0]], "line": [[], []]}
    }


def test_errors_of_scored_truth_only() -> None:
    columns = {
        "time_s": np.zeros(2),
        "mono_m": np.array([11.0, 30.0]),
        "truth_m": np.array([10.0, 20.0]),
    }
    columns["scored_truth_m"] = np.array([10.0, np.nan])
    assert error_curves(Rows(columns), {})["mono"]["points"] == [[10.0], [10.0]]


def test_many_points_are_thinned() -> None:
    curves = error_curves(drive(5000), {})
    assert len(curves["fused"]["points"][0]) == SCATTER_POINTS
    assert curves["fused_kf"]["points"] == [[], []]
    assert curves["fused_kf"]["line"] == [[15.0, 25.0, 35.0, 45.0, 55.0], [1.0] * 5]


def test_bands_of_the_summary_without_truth() -> None:
    summary = {"methods": {"fused": {"bands": BANDS}, "mono": {"bands": BANDS[1:]}, "sgbm": {}}}
    columns = drive(9, truth=False)
    assert error_curves(columns, summary) == {"fused": {"points": [[], []], "line": [[7.5], [3.0]]}}
    assert error_curves(columns, {}) == {}


@pytest.mark.parametrize(
    ("sigma", "within_1", "within_2"), [(0.02, 68.3, 95.5), (0.04, 95.5, 99.9), (0.01, 38.3, 68.3)]
)
def test_calibrated_sigmas_lie_on_the_diagonal(
    sigma: float, within_1: float, within_2: float
) -> None:
    curves = calibration_curves(drive(20_000, sigma=sigma), {})
    assert set(curves) == {"fused"}  # fused_kf has no sigma here
    expected, observed = (np.array(part) for part in curves["fused"]["line"])
    assert curves["fused"]["n"] == 20_000
    assert np.interp(68.27, expected, observed) == pytest.approx(within_1, abs=1.5)
    assert np.interp(95.0, expected, observed) == pytest.approx(within_2, abs=1.5)


def test_fractions_of_the_summary_without_truth() -> None:
    row = {"within_1_sigma": 0.7, "within_2_sigma": 0.9, "n": 12}
    curves = calibration_curves(
        drive(9, truth=False), {"methods": {"fused": row, "mono": {"within_1_sigma": None}}}
    )
    assert curves == {"fused": {"line": [[68.27, 95.45], [70.0, 90.0]], "n": 12}}
