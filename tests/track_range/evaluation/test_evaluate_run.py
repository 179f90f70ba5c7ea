"""Tests of `track-range evaluate run`: a finished run is evaluated again, without images."""

import json
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest

import track_range as tr
from tests.support.results.run_folder import N_FRAMES, write_run
from track_range.results.folder import read_run_folder

HEADER = "frame,id,class,x1,y1,x2,y2,distance_m\n"


@pytest.fixture
def run(tmp_path: Path) -> Path:
    """The folder of a run whose fused distance is 18.9 m."""
    return write_run(tmp_path / "run")


def labels(path: Path, distance_m: float) -> Path:
    rows = (f"{frame},1,car,280,140,360,220,{distance_m}\n" for frame in range(N_FRAMES))
    path.write_text(HEADER + "".join(rows))
    return path


def test_other_truth_than_that_of_the_run(
    run: Path, tmp_path: Path, cli: Callable[..., Any]
) -> None:
    other = labels(tmp_path / "radar.csv", 21.0)
    file = tmp_path / "figures.json"
    status, printed, errors = cli("evaluate", "run", run, "--truth", other, "--json", file)
    assert (status, errors) == (0, "")
    figures = json.loads(file.read_text())
    assert figures["methods"]["fused"]["median_relative_error_pct"] == pytest.approx(10.0)
    assert figures["methods"]["fused"]["n"] == N_FRAMES
    assert figures["tracks"]["mota"] == 100.0
    assert "25 px" in figures["tracks"]["rule"]
    assert "distance and closing speed in the rows of the CSV file" in printed
    assert read_run_folder(run).summary["truth"] != figures["truth"]  # nothing is stored


def test_stored_evaluation_takes_the_place_of_that_of_the_run(run: Path, tmp_path: Path) -> None:
    figures = tr.evaluate.run(run, labels(tmp_path / "radar.csv", 21.0), store=True)
    read = read_run_folder(run)
    for section in ("methods", "common", "tracks", "truth"):
        assert read.summary[section] == figures[section]
    assert read.rows["truth_m"].tolist() == [21.0] * N_FRAMES
    assert tr.evaluate.run(run)["methods"] == figures["methods"]  # now the truth of the run


def test_truth_of_the_run_by_default(run: Path) -> None:
    figures = tr.evaluate.run(run)
    assert figures["methods"]["fused"]["median_relative_error_pct"] == pytest.approx(5.0)
    assert figures["settings"] == {"truth": str(run / "truth.txt")}
    assert figures["tracks"]["rule"].startswith("KITTI")
    (run / "settings.yaml").write_text(
        (run / "settings.yaml").read_text().replace("truth:", "former:")
    )
    with pytest.raises(tr.errors.UsageError, match="truth"):
        tr.evaluate.run(run)


def test_no_run(tmp_path: Path, cli: Callable[..., Any]) -> None:
    status, _, errors = cli("evaluate", "run", tmp_path / "missing", "--truth", tmp_path / "a.csv")
    assert status == 1
    assert "missing" in errors


def log(path: Path, distance_m: float, header: str = "time_s,target,range_m") -> Path:
    rows = (f"{frame / 10},lead,{distance_m}\n" for frame in range(N_FRAMES))
    path.write_text(header + "\n" + "".join(rows))
    return path


def test_targets_without_boxes(run: Path, tmp_path: Path, cli: Callable[..., Any]) -> None:
    radar = log(tmp_path / "radar.csv", 18.0)
    file = tmp_path / "figures.json"
    status, printed, errors = cli(
        "evaluate", "run", run, "--truth", radar, "--truth-ahead-m", 0.9, "--json", file
    )
    assert (status, errors) == (0, "")
    figures = json.loads(file.read_text())
    assert figures["methods"]["fused"]["median_relative_error_pct"] == pytest.approx(0.0)
    assert figures["methods"]["fused"]["n"] == N_FRAMES
    assert figures["tracks"]["mota"] is None
    assert figures["targets"]["by_target"] == [
        {"target": "lead", "rows": N_FRAMES, "matched": N_FRAMES, "tracks": [1]}
    ]
    assert "no offset of its clock was found" in printed
    assert figures["settings"] == {"truth": str(radar), "truth_ahead_m": 0.9}


def test_targets_that_no_track_fits(run: Path, tmp_path: Path) -> None:
    figures = tr.evaluate.run(run, log(tmp_path / "radar.csv", 50.0), truth_offset_s=0.0)
    assert figures["methods"]["fused"]["n"] == 0
    assert "no track fits 1 of 1 targets: lead" in figures["notes"][-1]


def test_times_of_day_need_that_of_the_video(run: Path, tmp_path: Path) -> None:
    radar = log(tmp_path / "radar.csv", 18.0, "utc_s,target,range_m")
    with pytest.raises(tr.errors.LabelFileError, match="start-utc"):
        tr.evaluate.run(run, radar)


def test_cuboids_of_labels_that_have_them(
    run: Path, tmp_path: Path, cli: Callable[..., Any]
) -> None:
    """The cuboids of the rows are compared with the labels of the run, in KITTI's layout."""
    figures = tr.evaluate.run(run)
    read = read_run_folder(run)
    errors = figures["cuboids"]
    assert errors["counts"]["all"]["n"] == N_FRAMES
    assert "yaw_deg" in read.rows
    assert "cuboids" not in tr.evaluate.run(run, labels(tmp_path / "radar.csv", 21.0))
    assert "Nearest side, m" in cli("evaluate", "run", run)[1]
