import numpy as np
import pytest

from track_range.ranging.evaluation.box_filters import filtered
from track_range.ranging.evaluation.box_methods import MethodOptions, measured_by, method_names
from track_range.ranging.size_models.plain_curves import PLAIN_CURVES
from track_range.ranging.truth.errors import MethodColumn
from track_range.ranging.truth.frame_times import ASSUMED_STEP_S
from track_range.ranging.truth.labelled_boxes import box_set


@pytest.fixture(scope="module")
def many_drives(tmp_path_factory, row, drives):
    """Four drives of cars and people of one size per class, at 6 to 60 m."""
    rng = np.random.default_rng(0)
    made = {}
    for name in "abcd":
        made[name] = [
            row(frame, track, kind, rng.uniform(6, 60), x_m=x_m)
            for frame in range(40)
            for track, (kind, x_m) in enumerate((("Car", 0.0), ("Pedestrian", 4.0), ("Car", -4.0)))
        ]
    return box_set(*drives(tmp_path_factory.mktemp("many"), made))


def error_of(column, boxes, name):
    rows = boxes.class_name == name
    return np.nanmean(np.abs(column.distance_m / boxes.distance_m - 1)[rows])


def test_plain_curves_fit_cars_of_one_size(many_drives):
    """d = const / h: exact for the inverse and log-linear curves, approximate for polynomials of
    the fifth order."""
    result = measured_by(tuple(PLAIN_CURVES), many_drives, many_drives)
    assert list(result) == list(PLAIN_CURVES)
    for name in ("inverse-height", "log-linear"):
        assert error_of(result[name], many_drives, "person") < 0.01
    assert 0.005 < error_of(result["height-5"], many_drives, "person") < 0.2
    assert np.isnan(result["height-5"].sigma_m).all()


def test_plain_curves_have_no_distances_far_outside_of_the_fitted_ones(tmp_path, row, drives):
    far = [row(frame, 0, "Car", 40.0 + frame) for frame in range(40)]
    near = [row(frame, 0, "Car", 6.0 + frame / 8) for frame in range(40)]
    boxes = box_set(*drives(tmp_path, {"far": far, "near": near}))
    for column in measured_by(tuple(PLAIN_CURVES), boxes, boxes).values():
        known_m = column.distance_m[np.isfinite(column.distance_m)]
        assert ((known_m > 2.9) & (known_m < 160)).all()


def test_class_without_training_boxes_is_not_measured(tmp_path, row, drives):
    one = [row(frame, 0, "Car", 10.0 + frame) for frame in range(40)]
    other = [row(frame, 0, "Pedestrian", 10.0 + frame) for frame in range(40)]
    boxes = box_set(*drives(tmp_path, {"a": one, "b": other}))
    result = measured_by(("log-linear",), boxes, boxes)
    assert np.isnan(result["log-linear"].distance_m).all()


@pytest.mark.slow
def test_mono_ground_and_their_fusion(many_drives):
    result = measured_by(
        method_names()[-3:],
        many_drives,
        many_drives,
        MethodOptions(is_cross_validated=True, box_sigma_px=0.5, region="europe"),
    )
    assert list(result) == ["mono", "ground", "mono+ground"]
    for column in result.values():
        known = np.isfinite(column.distance_m)
        assert known.mean() > 0.9
        assert (column.sigma_m[known] > 0).all()
    assert error_of(result["mono"], many_drives, "person") < 0.02
    assert error_of(result["ground"], many_drives, "car") < 0.1
    packaged = measured_by(("mono",), many_drives, many_drives)["mono"]
    assert 0.001 < error_of(packaged, many_drives, "car") < 0.2
    known = measured_by(
        ("ground",), many_drives, many_drives, MethodOptions(box_sigma_px=0.5, camera_height_m=1.65)
    )["ground"]
    assert error_of(known, many_drives, "car") < 0.05


def approaching(tmp_path, row, drives, n=60, speed_mps=8.0):
    rows = [row(k, 1, "Car", 60.0 - speed_mps * ASSUMED_STEP_S * k) for k in range(n)]
    return box_set(*drives(tmp_path, {"a": rows, "b": rows[:3]}))


def test_paper_filter_by_hand(tmp_path, row, drives):
    """Q = R = P0 = 0.1: gains 2/3, then 5/8; with V unknown the filter lags behind an approaching
    car."""
    boxes = approaching(tmp_path, row, drives, n=3)
    z = np.array([10.0, 13.0, 9.0, 10.0, 13.0, 9.0])
    column, closing_mps = filtered(boxes, MethodColumn(z, 0 * z + 1), "paper")
    first, second, third = 10.0, 10.0 + 2 / 3 * 3.0, 12.0 + 5 / 8 * (9.0 - 12.0)
    # each drive has its own filter
    assert column.distance_m == pytest.approx([first, second, third] * 2)
    assert closing_mps[1] == pytest.approx(-2.0 / ASSUMED_STEP_S)
    assert filtered(boxes, MethodColumn(z, z), "none")[0].distance_m is z


def test_filters_bridge_gaps_and_restart(tmp_path, row, drives):
    boxes = box_set(*drives(tmp_path, {"a": [row(k, 1, "Car", 20.0) for k in (0, 1, 2, 20)]}))
    z = np.array([20.0, np.nan, 21.0, 30.0])
    paper = filtered(boxes, MethodColumn(z, z / 10), "paper")[0].distance_m
    third = 20.0 + (21.0 - 20.0) * 0.3 / 0.4  # P = 0.1 + 2 Q, R = 0.1
    assert paper == pytest.approx([20.0, 20.0, third, 30.0])


def test_default_filter_estimates_closing_speed(tmp_path, row, drives):
    boxes = approaching(tmp_path, row, drives)
    rng = np.random.default_rng(1)
    noisy = boxes.distance_m * (1 + rng.normal(0, 0.03, len(boxes)))
    column, closing_mps = filtered(boxes, MethodColumn(noisy, 0.05 * noisy), "default")
    late = slice(30, 60)
    smooth = np.abs(column.distance_m / boxes.distance_m - 1)[late].mean()
    assert 0.0 < smooth < 0.7 * np.abs(noisy / boxes.distance_m - 1)[late].mean()
    assert np.nanmedian(closing_mps[late]) == pytest.approx(8.0, abs=1.5)
    assert (column.sigma_m[late] > 0).all()
    untold, _ = filtered(boxes, MethodColumn(noisy, np.full(len(boxes), np.nan)), "default")
    assert np.isfinite(untold.distance_m).any()
    assert np.isnan(untold.sigma_m).all()
