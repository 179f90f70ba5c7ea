"""Curve files of all kinds: round trips and invalid content."""

import json

import numpy as np
import pytest

from track_range.ranging.size_models.cuboid_sizes import CuboidSizes
from track_range.ranging.size_models.curve import (
    CURVE_VERSION,
    CurveError,
    load_curves,
    save_curves,
)
from track_range.ranging.size_models.log_linear import SizeCurve, SizeCurves
from track_range.ranging.size_models.plain_curves import SAFE_CURVES, TableCurve, TableSizes
from track_range.ranging.size_models.size_model import SIZE_CLASSES, BoxExtents


def log_linear(**more):
    fields = {"intercept": 0.4, "per_log_height": -1.0, "per_log_width": 0.0, "per_bearing": 0.0}
    curve = SizeCurve(**{**fields, "sigma_relative": 0.1, "n": 9, "source": "made up", **more})
    return SizeCurves({"car": curve}, {"car": curve})


def table():
    distance_m = np.linspace(6, 80, 200)
    sizes = np.stack([1.7 / distance_m, 1.5 / distance_m], axis=1)
    fitted = SAFE_CURVES["height-3"](sizes, np.zeros(200), distance_m)
    return TableSizes(
        "height", {"car": TableCurve(table=fitted, sigma_relative=0.05, n=200, source="made up")}
    )


def test_round_trip_of_all_kinds(tmp_path):
    file = tmp_path / "c.json"
    save_curves(log_linear(), file)
    assert load_curves(file).whole == log_linear().whole
    save_curves(table(), file)
    again = load_curves(file)
    assert isinstance(again, TableSizes)
    np.testing.assert_allclose(
        again.curves["car"].table.log_distance, table().curves["car"].table.log_distance, atol=1e-5
    )
    packaged = load_curves()
    save_curves(packaged, file)
    assert load_curves(file).priors == packaged.priors
    assert load_curves(file).ground == packaged.ground


def test_packaged_file_excludes_the_test_drives():
    packaged = load_curves()
    assert isinstance(packaged, CuboidSizes)
    assert set(packaged.priors) == set(SIZE_CLASSES)
    for name in ("car", "van", "truck", "person", "bicycle"):
        assert "KITTI" in packaged.priors[name].source
        assert packaged.priors[name].n_tracks >= 3
        assert "0003" not in packaged.priors[name].source
        assert "0005" not in packaged.priors[name].source
    for name in ("bus", "motorcycle", "traffic light", "traffic sign"):
        assert "not fitted" in packaged.priors[name].source
        assert packaged.priors[name].log_sigma[0] >= 0.1


def changed(file, path, value):
    document = json.loads(file.read_text())
    inner = document
    for key in path[:-1]:
        inner = inner[key]
    inner[path[-1]] = value
    file.write_text(json.dumps(document))


@pytest.mark.parametrize(
    ("path", "value", "message"),
    [
        (["track_range_size_curves"], 1, f"version {CURVE_VERSION}"),
        (["kind"], "spline", "spline"),
        (["classes"], {"ufo": {}}, "ufo"),
        (["classes"], None, "classes"),
        (["classes", "car", "hwl_m"], [1.5, None, 4.0], "hwl_m"),
        (["classes", "car", "hwl_m"], [1.5, 1e300, 4.0], "50"),
        (["classes", "car"], None, "car"),
        (["classes", "car", "stands"], 7, "stands"),
        (["ground", "kerb_m"], [1e300, 1e300], "ground"),
        (["classes", "car", "turn_weights"], [1.0], "turn_weights"),
        (["classes", "car", "hwl_m"], [1.5, 1.6, -4.0], "hwl_m"),
        (["classes", "car", "correlation"], [0.99, 0.99, -0.99], "correlation"),
        (["classes", "car", "log_distance"], [float("inf"), 1.0], "finite"),
        (["ground", "camera_height_m"], -1.0, "ground"),
        (["ground", "rough_share"], 1.5, "rough_share"),
        (["classes", "car", "log_distance"], [3.0, 1e-300], "log_distance"),
        (["classes", "car", "hwl_m"], [1.5, 1e-300, 4.0], "hwl_m"),
        (["classes", "car", "scatter"], [True, 0.1], "scatter"),
        (["ground", "horizon_sigma"], 1e-300, "horizon_sigma"),
    ],
)
def test_invalid_priors(tmp_path, path, value, message):
    file = tmp_path / "c.json"
    save_curves(load_curves(), file)
    changed(file, path, value)
    with pytest.raises(CurveError, match=rf"c\.json: .*{message}"):
        load_curves(file)


@pytest.mark.parametrize(
    ("path", "value", "message"),
    [
        (["classes", "car", "log_distance"], [1.0, 2.0], "log_distance"),
        (["classes", "car", "sigma_relative"], 0.0, "sigma_relative"),
        (["classes"], {"ufo": {}}, "ufo"),
        (["measure"], "area", "area"),
        (["classes", "car", "sigma_relative"], 1e-300, "sigma_relative"),
        (["classes", "car", "n"], True, "'classes.car.n'"),
    ],
)
def test_invalid_tables(tmp_path, path, value, message):
    file = tmp_path / "c.json"
    save_curves(table(), file)
    changed(file, path, value)
    with pytest.raises(CurveError, match=rf"c\.json: .*{message}"):
        load_curves(file)


def test_other_invalid_files(tmp_path):
    file = tmp_path / "c.json"
    save_curves(log_linear(per_log_height=0.5), file)
    with pytest.raises(CurveError, match=r"c\.json: .*per_log_height"):
        load_curves(file)
    save_curves(log_linear(), file)
    changed(file, ["whole", "car", "per_bearing"], True)
    with pytest.raises(CurveError, match=r"c\.json: .*per_bearing"):
        load_curves(file)
    save_curves(log_linear(), file)
    changed(file, ["whole"], {"ufo": {}})
    with pytest.raises(CurveError, match=r"c\.json: .*ufo"):
        load_curves(file)
    file.write_text("[1, 2]")
    with pytest.raises(CurveError, match=r"c\.json: .*keys"):
        load_curves(file)
    with pytest.raises(CurveError, match=r"none\.json: no such file"):
        load_curves(tmp_path / "none.json")
    with pytest.raises(CurveError, match=r"c\.json: cannot be written"):
        save_curves(log_linear(), tmp_path / "none" / "c.json")


def test_table_measures_and_its_noise():

    one = np.ones(1)
    boxes = BoxExtents(
        wh_over_f=np.array([[1.7, 1.5]]) / 30,
        bearing=0 * one,
        bottom=0.05 * one,
        size_class=np.array([2]),
        uses_width=one > 0,
        uses_bottom=one > 0,
        edge_sigma=np.full((1, 2), 0.001),
        systematic_sigma=np.zeros((1, 2)),
    )
    result = table().measure(boxes)
    assert result.distance_m == pytest.approx([30.0], rel=0.1)
    assert result.sigma_m > result.sigma_systematic_m
    assert result.sigma_systematic_m == pytest.approx(0.05 * result.distance_m)
