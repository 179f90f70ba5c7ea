"""Figures of matchers by hand, as properties, and on real pairs."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given, settings, strategies as st

from track_range.stereo.alignment.from_reference import fit_reference
from track_range.stereo.evaluation.box_matchers import measure_pairs
from track_range.stereo.evaluation.disparity_errors import (
    MatcherColumn,
    Objects,
    common_figures,
    corrected,
    figures,
    folds,
    left_out_alignments,
    matcher_figures,
)
from track_range.stereo.evaluation.kitti_2015 import read_pairs
from track_range.stereo.geometry.alignment import Alignment
from track_range.stereo.geometry.camera import PinholeCamera

CAMERA = PinholeCamera(700.0, 700.0, 600.0, 180.0, 1200, 360)
NAN = np.nan


def column(disparity_px: list[float], sigma_px: list[float] | None = None) -> MatcherColumn:
    measured = np.array(disparity_px, np.float64)
    return MatcherColumn(measured, np.where(np.isfinite(measured), sigma_px or 1.0, NAN))


def objects(
    true_px: list[float], *, group: list[int] | None = None, pair: list[int] | None = None
) -> Objects:
    n = len(true_px)
    number = np.array(pair if pair is not None else range(n))
    return Objects(
        true_px=np.array(true_px),
        focal_baseline_m=np.full(n, 400.0),
        x_px=np.full(n, 600.0),
        pair=number,
        group=number if group is None else np.array(group),
        cameras=(CAMERA,) * (int(number.max()) + 1),
    )


def test_figures_by_hand() -> None:
    # distances 40, 20, 10, 8 m; errors -4.76 %, 0, +33.3 % (a failure), no value (another)
    result = figures(
        column([10.5, 20.0, 30.0, NAN], [0.6, 0.1, 6.0, 1.0]), np.array([10.0, 20.0, 40.0, 50.0])
    )
    assert (result["n"], result["n_measured"]) == (4, 3)
    assert (result["coverage"], result["failures_pct"]) == (0.75, 50.0)
    assert result["median_relative_error_pct"] == pytest.approx(100 / 21, abs=1e-4)
    assert result["mean_relative_error_pct"] == pytest.approx(
        (100 / 21 + 0 + 100 / 3) / 3, abs=1e-4
    )
    # 90 % of the way from the second to the third of three
    assert result["p95_relative_error_pct"] == pytest.approx(
        100 / 21 + 0.9 * (100 / 3 - 100 / 21), abs=1e-4
    )
    assert result["bias_pct"] == 0.0
    assert result["median_abs_error_px"] == 0.5
    assert (result["within_1_sigma"], result["within_2_sigma"]) == (
        pytest.approx(2 / 3, abs=1e-4),
        1.0,
    )


def test_figures_without_values_or_objects() -> None:
    result = figures(column([NAN, NAN]), np.array([10.0, 20.0]))
    assert (result["coverage"], result["failures_pct"], result["n_measured"]) == (0.0, 100.0, 0)
    assert result["median_relative_error_pct"] is result["within_1_sigma"] is None
    empty = figures(column([]), np.zeros(0))
    assert (empty["n"], empty["coverage"], empty["failures_pct"]) == (0, None, None)


def test_a_failure_is_beyond_15_per_cent() -> None:
    true_px = np.array([10.0, 10.0, 10.0, 10.0])
    result = figures(column([10 / 1.149, 10 / 1.151, 10 / 0.851, 10 / 0.849]), true_px)
    assert result["failures_pct"] == 50.0


def test_bands_of_true_distance() -> None:
    # 400 px m: 5, 14.99, 15, 30, 59.9 m, and 4 and 80 m in no band
    true_px = [80.0, 400 / 14.99, 400 / 15, 400 / 30, 400 / 59.9, 100.0, 5.0]
    result = matcher_figures({"a": column(true_px)}, objects(true_px))["a"]
    assert [(band["from_m"], band["to_m"], band["n"]) for band in result["bands"]] == [
        (5.0, 15.0, 2),
        (15.0, 30.0, 1),
        (30.0, 60.0, 2),
    ]
    assert result["n"] == 7


def test_common_figures() -> None:
    all_objects = objects([10.0, 20.0, 40.0])
    result = common_figures(
        {"a": column([10.0, NAN, 40.0]), "b": column([11.0, 20.0, 50.0])}, all_objects
    )
    assert [row["n"] for row in result.values()] == [2, 2]
    assert [row["coverage"] for row in result.values()] == [1.0, 1.0]
    assert result["b"]["failures_pct"] == 50.0
    none_common = common_figures(
        {"a": column([10.0, NAN, NAN]), "b": column([NAN, 20.0, 50.0])}, all_objects
    )
    assert none_common["a"]["n"] == 0


def test_intervals_resample_groups() -> None:
    # Two tracks, each of one error: whatever is drawn, the median error is 0, 5 or between.
    true_px = [10.0] * 8
    measured = column([10.0] * 4 + [10 / 1.05] * 4)
    all_objects = objects(true_px, group=[0] * 4 + [1] * 4)
    ends = matcher_figures({"a": measured}, all_objects)["a"]["intervals"][
        "median_relative_error_pct"
    ]
    assert ends == pytest.approx([0.0, 5.0])  # each track is drawn twice in a quarter of the draws
    alone = matcher_figures({"a": measured}, objects(true_px, group=[0] * 8))["a"]
    assert alone["intervals"] == {}
    by_object = matcher_figures(
        {"a": column([10 / (1 + 0.01 * k) for k in range(8)])}, objects(true_px)
    )["a"]
    low, high = by_object["intervals"]["mean_relative_error_pct"]
    assert 0.5 < low < by_object["mean_relative_error_pct"] == 3.5 < high < 6.5
    assert "n" not in by_object["intervals"]


def test_intervals_are_seeded() -> None:
    all_objects, measured = (
        objects([10.0] * 8),
        {"a": column([10 / (1 + 0.01 * k) for k in range(8)])},
    )
    assert matcher_figures(measured, all_objects, seed=1) == matcher_figures(
        measured, all_objects, seed=1
    )
    assert matcher_figures(measured, all_objects, seed=1) != matcher_figures(
        measured, all_objects, seed=2
    )


def test_pairs_are_corrected_by_their_alignment() -> None:
    all_objects = replace(
        objects([10.0, 10.0, 10.0], pair=[0, 1, 1]), x_px=np.array([600.0, 1200.0, 600.0])
    )
    alignments = {
        0: Alignment(offset_px=0.5, residual_px=3.0),
        1: Alignment(offset_px=-1.0, curvature_px=2.0, residual_px=0.0),
    }
    result = corrected(column([9.0, 9.0, 0.5], [4.0, 0.25, 0.25]), all_objects, alignments)
    # the second is at the image edge: -1 + 2
    assert result.disparity_px[:2].tolist() == [9.5, 10.0]
    assert np.isnan(result.disparity_px[2])  # negative
    assert result.sigma_px[:2].tolist() == [5.0, 0.25]
    assert np.isnan(result.sigma_px[2])


def test_folds_take_pairs_in_order() -> None:
    assert [list(fold) for fold in folds(5)] == [[0, 1], [2, 3], [4]]
    assert len(folds(16)) == 8


def mean_offset(measured_px: np.ndarray, true_px: np.ndarray, **where: object) -> Alignment:
    return Alignment(offset_px=float((true_px - measured_px).mean()), source=f"{where['groups']}")


def test_alignments_exclude_their_own_fold() -> None:
    all_objects = objects([20.0, 21.0, 22.0, 23.0, 24.0])  # true - measured: 0, 1, 2, 3, 4
    result = left_out_alignments(column([20.0] * 5), all_objects, mean_offset)
    assert [result[pair].offset_px for pair in range(5)] == pytest.approx(
        [3.0, 3.0, 5 / 3, 5 / 3, 1.5]
    )
    assert result[0] is result[1]
    assert result[4].source == "[0 1 2 3]"


@settings(deadline=None, max_examples=40)
@given(
    st.lists(st.tuples(st.floats(5.0, 60.0), st.floats(-0.4, 0.4)), min_size=1, max_size=12),
    st.randoms(),
)
def test_order_is_irrelevant_and_truth_has_no_error(
    rows: list[tuple[float, float]], random: object
) -> None:
    true_px, error_px = np.array(rows).T
    order = np.arange(len(rows))
    random.shuffle(order)  # type: ignore[attr-defined]
    measured = column((true_px + error_px).tolist())
    shuffled = MatcherColumn(measured.disparity_px[order], measured.sigma_px[order])
    assert figures(measured, true_px) == figures(shuffled, true_px[order])
    perfect = figures(column(true_px.tolist()), true_px)
    assert (
        perfect["p95_relative_error_pct"] == perfect["bias_pct"] == perfect["failures_pct"] == 0.0
    )
    assert perfect["within_1_sigma"] == perfect["coverage"] == 1.0


def test_the_real_pairs(shared_data: Path) -> None:
    """The patch matcher and the dense median on the labelled cars, uncorrected and
    cross-validated."""
    measured = measure_pairs(read_pairs(shared_data / "kitti2015"), ("patch", "sgbm"))
    all_objects = measured.objects
    raw = matcher_figures(measured.columns, all_objects)
    assert [row["n"] for row in raw.values()] == [36, 36]
    assert raw["patch"]["coverage"] >= 0.9, raw["patch"]
    assert raw["sgbm"]["coverage"] >= 0.97, raw["sgbm"]
    for row in raw.values():  # KITTI's disparities are a third to half a pixel too small
        assert 0.25 < row["median_abs_error_px"] < 0.65, row
        assert 1.5 < row["bias_pct"] < 4.5, row
    assert raw["patch"]["median_relative_error_pct"] < raw["sgbm"]["median_relative_error_pct"]
    for name, measured_column in measured.columns.items():
        corrected_column = corrected(
            measured_column,
            all_objects,
            left_out_alignments(measured_column, all_objects, fit_reference),
        )
        row = matcher_figures({name: corrected_column}, all_objects)[name]
        assert 0.7 < row["median_relative_error_pct"] < 1.8, row
        assert 3.0 < row["p95_relative_error_pct"] < 7.0, row
        assert abs(row["bias_pct"]) < 1.0, row
        assert row["failures_pct"] < 7.0, row
        assert 0.55 < row["within_1_sigma"] < 0.85, row
