"""--truth with a CSV: that of the simulation, and valid and invalid files of users."""

from __future__ import annotations

import csv
import json
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from track_range.ranging.truth.truth import CSV_PROTOCOL, read_truth
from track_range.simulation.drive import Drive
from track_range.stereo.rig_formats.reading import load_rig

N_FRAMES = 12


@pytest.fixture
def against(cli: Any, small_drive: Drive, tmp_path: Path) -> Any:
    """`against(truth)`: run on the drive; status, summary (None if it failed), output, error."""

    def run(truth: Path) -> tuple[int, Any, str, str]:
        sides = (
            "--stereo",
            small_drive.left,
            small_drive.right,
            "--rig",
            small_drive.rig,
            "--detections",
            small_drive.detections,
        )
        quick = ("--no-sgbm", "--no-overlay", "--lanes", "off", "--align", "off", "--verbose")
        out = tmp_path / "out"
        status, printed, complaint = cli(*sides, *quick, "--truth", truth, "--out", out)
        summary = json.loads((out / "summary.json").read_text()) if status == 0 else None
        return status, summary, printed, complaint

    return run


def rewritten(drive: Drive, path: Path, change: Any) -> Path:
    """truth.csv with its rows (dicts) changed; rows for which `change` returns None are omitted."""
    with drive.table.open(newline="") as file:
        rows = [row for row in map(change, csv.DictReader(file)) if row is not None]
    with path.open("w", newline="") as file:
        writer = csv.DictWriter(file, rows[0])
        writer.writeheader()
        writer.writerows(rows)
    return path


def test_truth_csv_of_the_simulation_is_exact(against: Any, small_drive: Drive) -> None:
    status, summary, printed, complaint = against(small_drive.table)
    assert status == 0, complaint
    assert summary["truth"] == CSV_PROTOCOL
    assert summary["methods"]["stereo"]["median_relative_error_pct"] < 2.0
    assert summary["tracks"]["mota"] > 30
    closing = summary["closing"]
    assert closing["n"] > 10
    assert closing["median_error_mps"] < 2.0
    assert 0 <= closing["within_1_sigma"] <= closing["within_2_sigma"] <= 1
    assert "Error of the closing speed" in printed


def test_csv_and_kitti_truth_agree_on_cars(small_drive: Drive) -> None:
    """Boxes are the same; distances agree where a body fills its 3-D box: cars and trucks, not
    riders."""
    rig, _ = load_rig(small_drive.rig, size_px=(620, 188), is_grey=False)
    exact, kitti = (
        read_truth(path, rig.left, np.zeros(3)) for path in (small_drive.table, small_drive.truth)
    )
    by_key = {
        key: row
        for row, key in enumerate(zip(kitti.frame.tolist(), kitti.track_id.tolist(), strict=True))
    }
    row = np.array(
        [by_key[key] for key in zip(exact.frame.tolist(), exact.track_id.tolist(), strict=True)]
    )
    both = np.isfinite(exact.distance_m) & np.isfinite(kitti.distance_m[row])
    assert both.sum() > 30
    np.testing.assert_allclose(exact.xyxy_px, kitti.xyxy_px[row], atol=0.01)
    gap = kitti.distance_m[row][both] / exact.distance_m[both] - 1
    assert abs(np.median(gap)) < 0.01
    # the same boxes are scored, except at the border, where KITTI tolerates small excess
    assert np.mean(np.isfinite(exact.distance_m) == np.isfinite(kitti.distance_m[row])) > 0.95


@pytest.mark.slow
def test_csv_with_required_columns_only(against: Any, small_drive: Drive, tmp_path: Path) -> None:
    needed = ("class", "id", "frame", "distance_m", "x1", "y1", "x2", "y2")
    status, summary, printed, complaint = against(
        rewritten(
            small_drive, tmp_path / "lidar.csv", lambda row: {name: row[name] for name in needed}
        )
    )
    assert status == 0, complaint
    assert summary["methods"]["stereo"]["n"] > 10
    assert "closing" not in summary
    assert "closing speed" not in printed


@pytest.mark.slow
def test_truth_of_other_frames(against: Any, small_drive: Drive, tmp_path: Path) -> None:
    _, plain, _, _ = against(small_drive.table)
    more = tmp_path / "more.csv"
    rows = small_drive.table.read_text().splitlines()
    later = [f"{int(row.split(',', 1)[0]) + N_FRAMES},{row.split(',', 1)[1]}" for row in rows[1:]]
    more.write_text("\n".join([*rows, *later]) + "\n")
    _, longer, printed, _ = against(more)
    assert (longer["methods"], longer["tracks"]) == (plain["methods"], plain["tracks"])
    assert "--truth has boxes up to frame 23" in printed
    more.write_text("\n".join([rows[0], *later]) + "\n")
    status, _, printed, _ = against(more)
    assert status == 0
    last = 2 * N_FRAMES - 1
    assert f"--truth has boxes for frames {N_FRAMES} to {last}" in printed


@pytest.mark.slow
@pytest.mark.parametrize(
    ("column", "value", "message"),
    [
        (
            "distance_m",
            "-3",
            "distance_m",
        ),
        ("class", "ufo", "'ufo'"),
        ("x1", "nan", "line 2: "),
        ("id", "7", "line 3: "),
        ("distance_m", "", "distance_m"),
    ],
)
def test_invalid_truth(
    against: Any, small_drive: Drive, tmp_path: Path, column: str, value: str, message: str
) -> None:
    status, _, _, complaint = against(
        rewritten(small_drive, tmp_path / "bad.csv", lambda row: {**row, column: value})
    )
    assert status == 1
    assert "bad.csv" in complaint
    assert message in complaint
    assert complaint.count("\n") == 1


def test_truth_without_a_column_or_rows(against: Any, small_drive: Drive, tmp_path: Path) -> None:
    bad = rewritten(
        small_drive,
        tmp_path / "bad.csv",
        lambda row: {k: v for k, v in row.items() if k != "distance_m"},
    )
    for message in ("distance_m", "empty"):
        status, _, _, complaint = against(bad)
        assert (status, complaint.count("\n")) == (1, 1)
        assert message in complaint
        bad.write_text("")


def test_hardly_visible_objects_do_not_count(small_drive: Drive, tmp_path: Path) -> None:
    rig, _ = load_rig(small_drive.rig, size_px=(620, 188), is_grey=False)
    faint = rewritten(
        small_drive, tmp_path / "faint.csv", lambda row: row | {"visible_share": "0.19"}
    )
    half = rewritten(
        small_drive, tmp_path / "half.csv", lambda row: row | {"visible_share": "0.21"}
    )
    assert (read_truth(faint, rig.left, np.zeros(3)).class_id == -1).all()
    assert (read_truth(half, rig.left, np.zeros(3)).class_id >= 0).all()
