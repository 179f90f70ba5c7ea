"""Tests of the benchmark of collision warnings on small inputs."""

import json
from dataclasses import asdict

import numpy as np
import pytest

from benchmarks.accuracy.warnings import warnings
from benchmarks.accuracy.warnings.box_errors import TrackErrors, simulated_errors
from benchmarks.accuracy.warnings.warning_drives import (
    SceneFigures,
    alarm_figures,
    closing_figures,
    drive_figures,
    reliability,
    scene_drives,
)
from benchmarks.accuracy.warnings.warnings import draw_curve, draw_reliability
from benchmarks.harness import StoredResults

NAN = float("nan")


def scene(alarms, *, n_contacts=0, hours=0.5):
    rows = np.array(alarms, np.float64).reshape(-1, 5)
    return SceneFigures(
        "following", 0, hours, rows, n_contacts, np.zeros((0, 5)), np.zeros((12, 3))
    )


def test_alarms_count_once_per_drive_and_threshold():
    scenes = [
        scene(
            [(0, 0, -1, 3.0, NAN), (0, 1, 4, 5.0, 2.5), (0, 1, 4, 9.0, -1.5), (1, 1, 7, 5.0, NAN)],
            n_contacts=2,
        ),
        scene([(0, 1, 2, 1.0, NAN)]),
    ]
    figures = alarm_figures(scenes)  # the last threshold, 1, is the default one
    assert figures["false_alarms"] == 2
    assert figures["false_alarms_per_hour"] == 2.0
    assert figures["median_lead_s"] == 1.25  # one contact with 2.5 s, one without an alarm
    assert figures["fraction_with_2_1_s"] == 0.5
    assert figures["by_scenario"]["following"]["contacts"] == 2
    # exact limits of Poisson for two events, 0.242 and 7.225, in one hour
    assert figures["false_alarms_per_hour_95"] == [0.24, 7.22]
    assert alarm_figures(scenes, 0)["false_alarms"] == 1


def test_scene_figures_are_the_same_from_json():
    original = scene([(0, 0, -1, 3.0, NAN)])
    values = json.loads(json.dumps(asdict(original), default=lambda array: array.tolist()))
    restored = SceneFigures.of_json(values)
    assert np.array_equal(restored.alarms, original.alarms, equal_nan=True)
    assert restored.closing.shape == (0, 5)


def test_reliability_separates_high_probabilities():
    figures = reliability(np.array([[1000, 20.0, 0], [10, 3.0, 0], [100, 60.0, 30]]))
    assert [row["n"] for row in figures["bins"]] == [1000, 100]  # 10 are too few
    assert figures["error_below_0.1"] == pytest.approx(0.02)
    assert figures["error_above_0.1"] == pytest.approx(0.3)


def test_closing_speeds_by_class_within_10_to_40_m():
    rows = np.array(
        [[2, 20.0, 0.5, 1.0, 1.5]] * 30
        + [[4, 20.0, -1.0, 0.5, 3.2]] * 20
        + [[2, 60.0, 9.0, 1.0, 1.5]] * 30
    )
    figures = closing_figures(rows)
    assert figures["car"] == {
        "n": 30,
        "median_abs_mps": 0.5,
        "bias_mps": 0.5,
        "within_1_sigma": 1.0,
    }
    assert figures["tall vehicles"]["median_abs_mps"] == 1.0


def square(case):
    return {"value": np.array([case**2])}


def test_stored_results_continue(tmp_path):
    path = tmp_path / "parts.jsonl"
    assert [row["value"] for row in StoredResults(path).mapped("a", square, [1, 2], 1)] == [
        [1],
        [4],
    ]
    path.write_text(path.read_text(encoding="utf-8") + '{"version": "interr', encoding="utf-8")
    calls = []
    results = StoredResults(path).mapped(
        "a", lambda case: calls.append(case) or square(case), [1, 2, 3], 1
    )
    assert [row["value"] for row in results] == [[1], [4], [9]]
    assert calls == [3]
    calls.clear()
    stored = StoredResults(path, version="another")
    list(stored.mapped("a", lambda case: calls.append(case) or square(case), [1], 1))
    assert calls == [1]


def curve_figures():
    point = {"false_alarms_per_hour": 2.0, "median_lead_s": 2.5, "fraction_with_2_1_s": 0.8}
    bins = [{"n": 50, "predicted": 0.2, "observed": 0.1}]
    return {
        name: {
            "points": [point, {**point, "false_alarms_per_hour": 0.0}],
            "default": point,
            "reliability": {"bins": bins},
        }
        for name in ("mono", "stereo", "fused")
    }


@pytest.mark.slow
def test_figures_of_the_curve(tmp_path):
    figures = curve_figures()
    draw_curve(figures, tmp_path / "curve.svg", lead_s=2.1)
    draw_reliability(figures, tmp_path / "reliability.svg")
    assert (tmp_path / "curve.svg").read_text(encoding="utf-8").count("false alarms per hour") >= 1


def test_track_errors_add_up():
    one = TrackErrors(seconds=36.0, n_tracks=3, false_tracks=[[1.5, 1.0, 0.2, 0.5, 0.3]])
    figures = (one + TrackErrors(seconds=36.0, n_tracks=1)).figures()
    assert figures["tracks per h"] == pytest.approx(200)
    assert figures["false tracks > 1 s per h, both"] == pytest.approx(50)


def test_tracks_of_a_short_drive():
    errors = simulated_errors("following", 1, seconds=1.5, n_errors=1)
    assert errors.seconds == 1.5
    assert errors.n_tracks > 0
    assert errors.n_rows > 5


@pytest.mark.slow
def test_stopped_vehicle_is_warned_of():
    figures = drive_figures(scene_drives("rear-stationary", 1, 1), methods="fused")
    assert figures.n_contacts == 1
    assert figures.closing.shape[1] == 5


@pytest.mark.slow
def test_hours_and_curve_of_few_drives(tmp_path, monkeypatch):
    for name, value in (
        ("HARMLESS_HOURS", ("following",)),
        ("BOX_COLLISIONS", ("rear-stationary",)),
        ("N_COLLISION_SEEDS", 1),
        ("THRESHOLDS", (0.5,)),
    ):
        monkeypatch.setattr(warnings, name, value)
    files = {name: tmp_path / name for name in ("parts.jsonl", "curve.svg")}
    few = "--only hours curve --hours 0.005 --errors 1 --first-seed 1"
    paths = ["--parts", files["parts.jsonl"], "--figure", files["curve.svg"]]
    figures = warnings.warnings(*few.split(), *map(str, paths))
    assert figures["hours"]["fused"]["hours"] > 0
    assert figures["curve"]["fused"]["default"]["contacts"] == 1
    assert all(path.stat().st_size > 0 for path in files.values())
