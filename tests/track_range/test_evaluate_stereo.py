"""`evaluate stereo` through the command line: exact pairs that the test makes, a simulated drive, and what is wrong."""

from __future__ import annotations

import csv
import json

import numpy as np
import pytest

from tests.stereo.kitti_folder import write_pair, write_set
from track_range.calibration.drive_pairs import read_drive
from track_range.simulation.drive import write_drive
from track_range.simulation.render.renderer import kitti_like_rig
from track_range.stereo.alignment.file import save_alignment
from track_range.stereo.alignment.model import Alignment
from track_range.stereo.evaluation.disparity_errors import BANDS_M

KEYS = {
    "coverage", "failures_pct", "n", "median_relative_error_pct", "mean_relative_error_pct", "p95_relative_error_pct",
    "bias_pct", "median_abs_error_px", "within_1_sigma", "within_2_sigma", "ms_per_frame", "bands",
}  # fmt: skip


def evaluate(cli, folder, tmp_path, *more):
    status, printed, complaint = cli("evaluate", "stereo", "--pairs", folder, "--json", tmp_path / "f.json", *more)
    assert status == 0, complaint
    return json.loads((tmp_path / "f.json").read_text()), printed


@pytest.fixture(scope="module")
def drive(tmp_path_factory):
    """Four small frames of a simulated drive."""
    folder = tmp_path_factory.mktemp("drive")
    write_drive(folder, seed=1, seconds=0.4, rig=kitti_like_rig(width_px=620, height_px=188))
    return folder


def test_exact_pairs_are_measured_exactly(cli, tmp_path):
    folder = write_set(tmp_path / "set")
    found, printed = evaluate(cli, folder, tmp_path, "--matcher", "patch,sgbm,sgbm-hh")
    assert (found["n_pairs"], found["n_objects"], found["align"]) == (2, 4, "off")
    assert list(found["matchers"]) == list(found["common"]) == ["patch", "sgbm", "sgbm-hh"]
    for row in found["matchers"].values():
        assert set(row) >= KEYS
        assert (row["n"], row["n_measured"], row["coverage"], row["failures_pct"]) == (4, 4, 1.0, 0.0)
        assert row["p95_relative_error_pct"] < 1.0
        assert row["median_abs_error_px"] < 0.15
        assert (row["within_1_sigma"], row["within_2_sigma"]) == (1.0, 1.0)  # unaligned: half a pixel of doubt
        assert row["ms_per_frame"] > 0
        assert [(band["from_m"], band["to_m"]) for band in row["bands"]] == list(BANDS_M)
        assert [band["n"] for band in row["bands"]] == [4, 0, 0]
        low, high = row["intervals"]["median_relative_error_pct"]
        assert low <= row["median_relative_error_pct"] <= high
    assert "4 objects in 2 pairs, alignment off" in printed
    assert "95 % intervals" in printed
    assert "On the 4 objects that all matchers measured" in printed


def test_one_matcher_has_nobody_in_common(cli, tmp_path):
    found, printed = evaluate(cli, write_set(tmp_path / "set"), tmp_path, "--matcher", "patch")
    assert found["common"] == {}
    assert "all matchers" not in printed


def test_leaving_two_pairs_out_takes_a_common_error_away(cli, tmp_path):
    folder = write_set(tmp_path / "set", [f"{n:06d}_10" for n in range(6)], reads_low_px=1)
    raw, _ = evaluate(cli, folder, tmp_path, "--matcher", "patch")
    assert raw["matchers"]["patch"]["bias_pct"] == pytest.approx(100 * (1 / 20 + 1 / 30) / 2, abs=0.4)
    put_right, printed = evaluate(cli, folder, tmp_path, "--matcher", "patch", "--align", "leave-two-out")
    assert abs(put_right["matchers"]["patch"]["bias_pct"]) < 0.3
    assert put_right["alignment"]["patch"]["mean_offset_px"] == pytest.approx(1.0, abs=0.1)
    assert "alignment leave-two-out" in printed


def test_an_alignment_file_is_applied(cli, tmp_path):
    folder = write_set(tmp_path / "set", reads_low_px=1)
    save_alignment(Alignment(offset_px=1.0, residual_px=0.2), tmp_path / "align.yaml")
    found, _ = evaluate(cli, folder, tmp_path, "--matcher", "patch", "--align", tmp_path / "align.yaml")
    assert abs(found["matchers"]["patch"]["bias_pct"]) < 0.3
    assert found["alignment"]["offset_px"] == 1.0


def test_a_simulated_drive(drive, cli, tmp_path):
    found, printed = evaluate(cli, drive, tmp_path, "--matcher", "patch")
    row = found["matchers"]["patch"]
    assert found["n_pairs"] == 4
    assert row["n"] == found["n_objects"] >= 12
    assert 0.5 < row["coverage"] <= 1.0
    assert 0.05 < row["median_relative_error_pct"] < 3.0
    assert "bootstrap over pairs, or a drive's tracks" in printed


def test_objects_of_a_drive_are_those_that_count(drive):
    pairs = list(read_drive(drive))
    with (drive / "truth.csv").open(newline="") as file:
        seen = [row for row in csv.DictReader(file) if float(row["visible_share"]) >= 0.5]
    assert 0 < sum(len(pair.true_px) for pair in pairs) <= len(seen)
    for number, pair in enumerate(pairs):
        assert pair.name == f"{number:06d}"
        mine = {int(row["id"]): row for row in seen if row["frame"] == str(number)}
        distance_m = pair.rig.distance_m(pair.true_px)
        assert ((distance_m >= 5) & (distance_m <= 100)).all()
        for track_id, box, far_m in zip(
            pair.track_id.tolist(), pair.xyxy_px.tolist(), distance_m.tolist(), strict=True
        ):
            assert box == [float(mine[track_id][edge]) for edge in ("x1", "y1", "x2", "y2")]
            assert far_m == pytest.approx(float(mine[track_id]["distance_m"]))


def test_a_drive_without_a_table_has_its_labels(drive, tmp_path):
    for file in drive.iterdir():
        if file.name != "truth.csv":
            (tmp_path / file.name).symlink_to(file)
    exact, boxed = (
        {
            (pair.name, number): far_m
            for pair in read_drive(folder)
            for number, far_m in zip(pair.track_id.tolist(), pair.rig.distance_m(pair.true_px).tolist(), strict=True)
        }
        for folder in (drive, tmp_path)
    )
    ratio = np.array([boxed[key] / exact[key] for key in exact.keys() & boxed.keys()])
    assert len(ratio) > 10
    assert np.median(ratio) == pytest.approx(1.0, abs=0.01)
    assert np.abs(ratio - 1).max() > 1e-5  # a body does not fill its 3-D box


@pytest.mark.parametrize(
    ("spoil", "said"),
    [
        (lambda folder: (folder / "calib.txt").unlink(), "no calib.txt in it"),
        (lambda folder: (folder / "image_3").rename(folder / "right"), "the folder image_3 is missing"),
        (lambda folder: (folder / "obj_map/000001_10.png").unlink(), "obj_map/000001_10.png: it is missing"),
        (lambda folder: [part.rename(folder.parent / part.name) for part in folder.iterdir()], "neither a set like"),
        (lambda folder: (folder / "calib.txt").write_text("P2: 1 2 3\n"), "12 numbers"),
    ],
)
def test_a_wrong_set_is_one_sentence(cli, tmp_path, spoil, said):
    folder = write_set(tmp_path / "set")
    spoil(folder)
    status, _, complaint = cli("evaluate", "stereo", "--pairs", folder, "--matcher", "patch")
    assert (status, said in complaint) == (1, True), complaint


def test_no_object_to_measure(cli, tmp_path):
    folder = write_set(tmp_path / "set")
    for name in ("000000_10", "000001_10"):
        write_pair(folder, name, cars=())
    status, _, complaint = cli("evaluate", "stereo", "--pairs", folder, "--matcher", "patch")
    assert (status, "no object in it of which enough is known" in complaint) == (1, True)


@pytest.mark.parametrize(
    ("options", "said"),
    [
        (("--matcher", "patch,sgmb"), "--matcher: 'sgmb' is no matcher; there are: patch, sgbm,"),
        (("--matcher", ""), "--matcher: "),
        (("--matcher", "patch,patch"), "--matcher: one is named twice"),
        (("--align", "leave-two-out"), "expected at least 4 pairs"),
    ],
)
def test_wrong_usage(cli, tmp_path, options, said):
    status, _, complaint = cli("evaluate", "stereo", "--pairs", write_set(tmp_path / "set"), *options)
    assert (status, said in complaint) == (2, True), complaint


def test_wrong_drives(drive, cli, tmp_path):
    status, _, complaint = cli("evaluate", "stereo", "--pairs", drive, "--align", "leave-two-out")
    assert (status, "is for sets of single pairs" in complaint) == (2, True)
    without = (("right.mp4", "there is no such file"), ("truth", "no truth.csv or truth.txt or label.txt in it"))
    for missing, said in without:
        folder = tmp_path / missing
        folder.mkdir()
        for file in drive.iterdir():
            if missing not in (file.name, file.stem):
                (folder / file.name).symlink_to(file)
        status, _, complaint = cli("evaluate", "stereo", "--pairs", folder, "--matcher", "patch")
        assert (status, said in complaint) == (1, True), complaint
    (tmp_path / "right.mp4/right.mp4").symlink_to(drive / "right.mp4")
    (tmp_path / "right.mp4/rig.yaml").unlink()
    status, _, complaint = cli("evaluate", "stereo", "--pairs", tmp_path / "right.mp4", "--matcher", "patch")
    assert (status, "no rig.yaml or calib.txt" in complaint) == (1, True)
    other = drive / "rig.yaml"
    found, _ = evaluate(cli, tmp_path / "right.mp4", tmp_path, "--matcher", "patch", "--rig", other)
    assert found["n_pairs"] == 4


def test_real_pairs(shared_data, cli, tmp_path):
    found, _ = evaluate(
        cli, shared_data / "kitti2015", tmp_path, "--matcher", "patch,sgbm-centre", "--align", "leave-two-out"
    )
    patch, centre = found["matchers"]["patch"], found["matchers"]["sgbm-centre"]
    assert (found["n_pairs"], patch["n"], centre["n"]) == (16, 36, 36)
    assert [band["n"] for band in patch["bands"]] == [10, 10, 15]
    assert 0.7 < patch["median_relative_error_pct"] < 1.8
    assert patch["failures_pct"] < centre["failures_pct"]
    assert 0.7 < np.mean(centre["coverage"]) < 1.0  # the middle pixel is often unknown, a window or a gap
