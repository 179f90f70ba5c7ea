"""Tests of the benchmark of one camera on any road."""

from __future__ import annotations

import numpy as np
import pytest

from benchmarks.accuracy.ranging.roads import draw, reliability, roads
from benchmarks.inputs.road_sets import road_set
from track_range.ranging.truth.errors import MethodColumn


def test_bins_of_a_true_sigma_have_errors_of_its_size():
    rng = np.random.default_rng(0)
    sigma = rng.uniform(0.02, 0.2, 8000)
    distance_m = 30 * np.exp(rng.normal(0, sigma))
    bins = reliability(MethodColumn(distance_m, sigma * distance_m), np.full(8000, 30.0))
    assert bins["sigma_pct"][0] == pytest.approx(3.2, abs=0.3)
    assert bins["error_pct"] == pytest.approx(bins["sigma_pct"], rel=0.15)


@pytest.mark.real
def test_boxes_of_nuscenes_have_the_distance_of_their_surface(shared_data):
    road = road_set("nuscenes", shared_data)
    assert set(road.boxes.class_name) <= {"person", "car", "truck", "bus", "bicycle", "motorcycle"}
    assert len(np.unique(road.object_id)) == 113
    assert (road.boxes.distance_m > 1).all()
    assert np.ptp(road.camera_height_m) == pytest.approx(0.08, abs=0.01)


@pytest.mark.real
def test_figures_and_picture_of_a_data_set(shared_data, tmp_path):
    arguments = [
        "--data",
        str(shared_data),
        *"--sets tusimple --known nothing region --detectors".split(),
    ]
    figures = roads(*arguments)
    by_known = figures["boxes"]["tusimple"]
    assert figures["runs"] == {}
    for known in ("nothing", "region"):
        row = by_known[known]["mono, car"]
        assert (row["n"], row["objects"], row["coverage"]) == (189, 189, 1.0)
        assert row["mean_pct"] < 12
        parts = [
            by_known[known][f"mono, car {band} m"]["n"] for band in ("5-20", "20-45", "45-100")
        ]
        assert sum(parts) == 189
    draw(figures["boxes"], tmp_path / "sigma.svg")
    assert (tmp_path / "sigma.svg").stat().st_size > 1000
