import numpy as np
import pytest

from track_range.ranging.evaluation.box_evaluation import (
    closing_figures,
    figures,
    frame_rows,
    true_closing_mps,
)
from track_range.ranging.fitting.cross_validation import cross_validated, folds, within_drives
from track_range.ranging.truth.errors import MethodColumn
from track_range.ranging.truth.frame_times import ASSUMED_STEP_S
from track_range.ranging.truth.labelled_boxes import box_set


@pytest.fixture
def box_set_of(tmp_path, row, drives):
    def make(**sequences):
        return box_set(*drives(tmp_path, sequences))

    return make


def test_figures_by_hand(box_set_of, row):
    """Cars at 8, 25, 40 and 60 m with errors of -25, +10, -10 and 0 %; sigma is 10 % of the true
    distance."""
    true_m = np.array([8.0, 25.0, 40.0, 60.0])
    boxes = box_set_of(a=[row(k, 0, "Car", d, x_m=12.0 * (k == 3)) for k, d in enumerate(true_m)])
    car = figures(boxes, MethodColumn(np.array([6.0, 27.5, 36.0, 60.0]), 0.11 * true_m))["car"]
    assert (car["n"], car["n_tracks"], car["coverage"]) == (3, 1, 1.0)
    # over 10-100 m, without the first
    assert car["mean_relative_error_pct"] == pytest.approx(20 / 3, abs=1e-3)
    assert car["median_relative_error_pct"] == pytest.approx(10.0, abs=1e-3)
    assert car["bias_pct"] == pytest.approx(0.0, abs=1e-3)
    assert car["far_pct"] == pytest.approx(5.0, abs=1e-3)  # 40 and 60 m
    # the last has a lateral offset of 12 m
    assert car["rear_view_pct"] == pytest.approx(10.0, abs=1e-3)
    assert (car["within_1_sigma"], car["within_2_sigma"]) == (1.0, 1.0)
    bands = {(band["from_m"], band["to_m"]): band for band in car["bands"]}
    assert bands[5.0, 10.0]["mean_relative_error_pct"] == pytest.approx(25.0, abs=1e-3)
    assert [band["n"] for band in car["bands"]] == [1, 0, 1, 1, 1]


def test_figures_by_drive_show_errors_that_cancel(box_set_of, row):
    """Drives of 30 boxes at +5 and -8 % have no common bias; the worst has at least 30 boxes, so that
    one wrong box of a third is none."""
    drives = {
        name: [row(k, 0, "Car", 20.0) for k in range(n)] for name, n in (("a", 30), ("b", 30))
    }
    boxes = box_set_of(**drives, c=[row(0, 0, "Car", 20.0)])
    factor = np.choose(boxes.sequence, [1.05, 0.92, 1.4])
    column = MethodColumn(factor * boxes.distance_m, np.full(len(boxes), 1.2))
    car = figures(boxes, column)["car"]
    by_drive = car["by_drive"]
    assert list(by_drive) == ["a", "b", "c"]
    assert [scores["n"] for scores in by_drive.values()] == [30, 30, 1]
    assert [scores["n_tracks"] for scores in by_drive.values()] == [1, 1, 1]
    assert [scores["bias_pct"] for scores in by_drive.values()] == pytest.approx([5.0, -8.0, 40.0])
    assert [scores["within_1_sigma"] for scores in by_drive.values()] == [1.0, 0.0, 0.0]
    assert [scores["within_2_sigma"] for scores in by_drive.values()] == [1.0, 1.0, 0.0]
    assert car["worst_drive"] == "b"
    few = boxes.select(np.flatnonzero(boxes.frame < 20))
    few_column = MethodColumn(few.distance_m, np.ones(len(few)))
    assert figures(few, few_column)["car"]["worst_drive"] is None


def test_classes_in_order_and_unmeasured_boxes(box_set_of, row):
    boxes = box_set_of(
        a=[
            row(0, 0, "Cyclist", 20.0),
            row(0, 1, "Van", 30.0, x_m=4),
            row(0, 2, "Van", 40.0, x_m=-6),
        ]
    )
    by_class = figures(
        boxes,
        MethodColumn(
            np.where(boxes.distance_m > 35, np.nan, boxes.distance_m), np.full(len(boxes), np.nan)
        ),
    )
    assert list(by_class) == ["van", "bicycle"]
    assert (by_class["van"]["n"], by_class["van"]["coverage"]) == (1, 0.5)
    assert by_class["van"]["within_1_sigma"] is None
    assert by_class["bicycle"]["far_pct"] is None


def test_folds_never_fit_the_tested_sequence(box_set_of, row):
    boxes = box_set_of(
        **{f"s{k}": [row(f, 0, "Car", 10.0 + k) for f in range(k + 1)] for k in range(9)}
    )
    masks = list(folds(boxes))
    assert len(masks) == 7
    assert (np.sum(masks, axis=0) == 1).all()

    def fit(train):
        seen = set(train.sequence.tolist())

        def predict(test):
            assert not seen & set(test.sequence.tolist())
            return MethodColumn(np.full(len(test), float(len(seen))), test.distance_m)

        return predict

    column = cross_validated(boxes, boxes, fit)
    assert set(column.distance_m) == {7.0, 8.0}  # the folds have one or two sequences
    assert (column.sigma_m == boxes.distance_m).all()


def test_single_sequence_is_fitted_to_itself(box_set_of, row):
    boxes = box_set_of(a=[row(0, 0, "Car", 20.0)])
    column = cross_validated(
        boxes, boxes, lambda train: lambda test: MethodColumn(0 * test.distance_m + len(train), 0)
    )
    assert column.distance_m.tolist() == [1.0]


def test_within_drives_fits_each_drive_to_itself(box_set_of, row):
    boxes = box_set_of(a=[row(0, 0, "Car", 20.0)], b=[row(f, 0, "Car", 30.0) for f in range(3)])
    column = within_drives(
        boxes, boxes, lambda train: lambda test: MethodColumn(0 * test.distance_m + len(train), 0)
    )
    assert column.distance_m.tolist() == [1.0, 3.0, 3.0, 3.0]


def test_rows_by_frame(box_set_of, row):
    boxes = box_set_of(
        a=[row(1, 0, "Car", 20.0), row(0, 1, "Car", 30.0), row(1, 2, "Car", 40.0, x_m=5)],
        b=[row(0, 0, "Car", 9)],
    )
    assert [boxes.distance_m[rows].round(3).tolist() for rows in frame_rows(boxes)] == [
        [30.0],
        [20.0, 40.0],
        [9.0],
    ]


def test_closing_speed_is_a_central_difference(box_set_of, row):
    speed_mps = 8.0
    boxes = box_set_of(
        a=[row(k, 4, "Car", 60.0 - speed_mps * ASSUMED_STEP_S * k) for k in range(20)]
    )
    true_mps = true_closing_mps(boxes)
    assert np.isnan(true_mps[:5]).all()
    assert np.isnan(true_mps[-5:]).all()
    assert true_mps[5:-5] == pytest.approx(np.full(10, speed_mps), abs=1e-3)
    car = closing_figures(boxes, np.where(np.arange(20) == 9, 12.0, 8.5))["car"]
    assert car["closing_n"] == 10
    assert car["closing_median_error_mps"] == pytest.approx(0.5, abs=1e-3)
    # ninth to last
    assert car["closing_p95_error_mps"] == pytest.approx(0.5 + 0.55 * 3.5, abs=1e-2)
    assert closing_figures(boxes, np.full(20, np.nan))["car"]["closing_median_error_mps"] is None
