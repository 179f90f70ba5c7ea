"""Tests of `track-range evaluate stereo`: exact pairs, a simulated drive, real pairs, and invalid
input."""

from __future__ import annotations

import csv
import json

import cv2
import numpy as np
import pytest

from tests.support.networks.depth_networks import DISPARITY_STEP, encoded, write_stereo
from tests.support.recordings.kitti_folder import (
    BASELINE_M,
    CALIBRATION,
    CARS,
    FOCAL_PX,
    write_pair,
    write_set,
)
from track_range.calibration.reference_pairs import read_drive
from track_range.stereo.alignment.file import save_alignment
from track_range.stereo.evaluation.dense_confidence import MEASURES
from track_range.stereo.evaluation.disparity_errors import BANDS_M
from track_range.stereo.geometry.alignment import Alignment

KEYS = {
    "coverage", "failures_pct", "n", "median_relative_error_pct", "mean_relative_error_pct", "p95_relative_error_pct",
    "bias_pct", "median_abs_error_px", "within_1_sigma", "within_2_sigma", "ms_per_frame", "bands",
}  # fmt: skip


def evaluate(cli, folder, tmp_path, *more):
    status, printed, errors = cli(
        "evaluate", "stereo", "--pairs", folder, "--json", tmp_path / "f.json", *more
    )
    assert status == 0, errors
    return json.loads((tmp_path / "f.json").read_text()), printed


@pytest.fixture(scope="module")
def four_frames(render_drive):
    """The folder of four small frames of a simulated drive."""
    return render_drive(seed=1, seconds=0.4).left.parent


def test_exact_pairs(cli, tmp_path):
    folder = write_set(tmp_path / "set")
    figures, printed = evaluate(cli, folder, tmp_path, "--matcher", "patch,sgbm,sgbm-hh")
    assert (figures["n_pairs"], figures["n_objects"], figures["align"]) == (2, 4, "off")
    assert list(figures["matchers"]) == list(figures["common"]) == ["patch", "sgbm", "sgbm-hh"]
    for row in figures["matchers"].values():
        assert set(row) >= KEYS
        assert (row["n"], row["n_measured"], row["coverage"], row["failures_pct"]) == (
            4,
            4,
            1.0,
            0.0,
        )
        assert row["p95_relative_error_pct"] < 1.0
        assert row["median_abs_error_px"] < 0.15
        assert (row["within_1_sigma"], row["within_2_sigma"]) == (
            1.0,
            1.0,
        )  # without alignment the uncertainty is 0.5 px
        assert row["ms_per_frame"] > 0
        assert [(band["from_m"], band["to_m"]) for band in row["bands"]] == list(BANDS_M)
        assert [band["n"] for band in row["bands"]] == [4, 0, 0]
        low, high = row["intervals"]["median_relative_error_pct"]
        assert low <= row["median_relative_error_pct"] <= high
    assert "4 objects in 2 pairs" in printed
    assert "95 %" in printed
    assert "all matchers" in printed


def test_risk_coverage(cli, tmp_path):
    folder = write_set(tmp_path / "set", ["000000_10"])
    chart = tmp_path / "risk.svg"
    figures, printed = evaluate(
        cli, folder, tmp_path, "--matcher", "patch,sgbm-hh", "--figure", chart
    )
    curves = figures["risk_coverage"]
    assert set(curves["patch"]) == {"sigma"}
    assert set(curves["sgbm-hh"]) == {"sigma", *MEASURES}
    assert figures["best_confidence"]["sgbm-hh"] in MEASURES
    for curve in curves["sgbm-hh"].values():
        assert (curve["area_failures_pct"], curve["curve"][-1]["answered_pct"]) == (0.0, 100)
    assert "most certain boxes" in printed
    assert "<svg" in chart.read_text()


def test_wrong_chart_name(cli, tmp_path):
    status, _, errors = cli(
        "evaluate", "stereo", "--pairs", write_set(tmp_path / "set"), "--figure", "risk.txt"
    )
    assert (status, "--figure" in errors) == (2, True)


def test_one_matcher_has_no_common_objects(cli, tmp_path):
    figures, printed = evaluate(cli, write_set(tmp_path / "set"), tmp_path, "--matcher", "patch")
    assert figures["common"] == {}
    assert "all matchers" not in printed


def test_leave_two_out_removes_a_common_offset(cli, tmp_path):
    folder = write_set(tmp_path / "set", [f"{n:06d}_10" for n in range(6)], offset_px=1)
    raw, _ = evaluate(cli, folder, tmp_path, "--matcher", "patch")
    assert raw["matchers"]["patch"]["bias_pct"] == pytest.approx(
        100 * (1 / 20 + 1 / 30) / 2, abs=0.4
    )
    corrected, printed = evaluate(
        cli, folder, tmp_path, "--matcher", "patch", "--align", "leave-two-out"
    )
    assert abs(corrected["matchers"]["patch"]["bias_pct"]) < 0.3
    assert corrected["alignment"]["patch"]["mean_offset_px"] == pytest.approx(1.0, abs=0.1)
    assert "leave-two-out" in printed


def test_alignment_file_is_applied(cli, tmp_path):
    folder = write_set(tmp_path / "set", offset_px=1)
    save_alignment(Alignment(offset_px=1.0, residual_px=0.2), tmp_path / "align.yaml")
    figures, _ = evaluate(
        cli, folder, tmp_path, "--matcher", "patch", "--align", tmp_path / "align.yaml"
    )
    assert abs(figures["matchers"]["patch"]["bias_pct"]) < 0.3
    assert figures["alignment"]["offset_px"] == 1.0


def test_simulated_drive(four_frames, cli, tmp_path):
    figures, printed = evaluate(cli, four_frames, tmp_path, "--matcher", "patch")
    row = figures["matchers"]["patch"]
    assert figures["n_pairs"] == 4
    assert row["n"] == figures["n_objects"] >= 12
    assert 0.5 < row["coverage"] <= 1.0
    assert 0.05 < row["median_relative_error_pct"] < 3.0
    assert "bootstrap" in printed


def test_objects_of_a_drive(four_frames):
    pairs = list(read_drive(four_frames))
    with (four_frames / "truth.csv").open(newline="") as file:
        visible = [row for row in csv.DictReader(file) if float(row["visible_share"]) >= 0.5]
    assert 0 < sum(len(pair.true_px) for pair in pairs) <= len(visible)
    for number, pair in enumerate(pairs):
        assert pair.name == f"{number:06d}"
        rows = {int(row["id"]): row for row in visible if row["frame"] == str(number)}
        distance_m = pair.rig.distance_m(pair.true_px)
        assert ((distance_m >= 5) & (distance_m <= 100)).all()
        for track_id, box, object_m in zip(
            pair.track_id.tolist(), pair.xyxy_px.tolist(), distance_m.tolist(), strict=True
        ):
            assert box == [float(rows[track_id][edge]) for edge in ("x1", "y1", "x2", "y2")]
            assert object_m == pytest.approx(float(rows[track_id]["distance_m"]))
        assert pair.class_names == tuple(
            rows[track_id]["class"] for track_id in pair.track_id.tolist()
        )


def test_drive_with_kitti_labels_only(four_frames, tmp_path):
    for file in four_frames.iterdir():
        if file.name != "truth.csv":
            (tmp_path / file.name).symlink_to(file)
    exact, boxed = (
        {
            (pair.name, number): distance_m
            for pair in read_drive(folder)
            for number, distance_m in zip(
                pair.track_id.tolist(), pair.rig.distance_m(pair.true_px).tolist(), strict=True
            )
        }
        for folder in (four_frames, tmp_path)
    )
    ratio = np.array([boxed[key] / exact[key] for key in exact.keys() & boxed.keys()])
    assert len(ratio) > 10
    assert np.median(ratio) == pytest.approx(1.0, abs=0.01)
    assert np.abs(ratio - 1).max() > 1e-5  # a body does not fill its 3-D box


@pytest.mark.parametrize(
    ("damage", "word"),
    [
        (lambda folder: (folder / "calib.txt").unlink(), "calib.txt"),
        (lambda folder: (folder / "image_3").rename(folder / "right"), "image_3"),
        (lambda folder: (folder / "obj_map/000001_10.png").unlink(), "obj_map/000001_10.png"),
        (
            lambda folder: [part.rename(folder.parent / part.name) for part in folder.iterdir()],
            "KITTI 2015",
        ),
        (lambda folder: (folder / "calib.txt").write_text("P2: 1 2 3\n"), "12 numbers"),
    ],
)
def test_invalid_set(cli, tmp_path, damage, word):
    folder = write_set(tmp_path / "set")
    damage(folder)
    status, _, errors = cli("evaluate", "stereo", "--pairs", folder, "--matcher", "patch")
    assert (status, word in errors) == (1, True), errors


def test_no_object_to_measure(cli, tmp_path):
    folder = write_set(tmp_path / "set")
    for name in ("000000_10", "000001_10"):
        write_pair(folder, name, cars=())
    status, _, errors = cli("evaluate", "stereo", "--pairs", folder, "--matcher", "patch")
    assert (status, "objects" in errors) == (1, True)


@pytest.mark.parametrize(
    ("options", "word"),
    [
        (("--matcher", "patch,sgmb"), "sgmb"),
        (("--matcher", ""), "--matcher"),
        (("--matcher", "patch,patch"), "duplicates"),
        (("--align", "leave-two-out"), "at least 4 pairs"),
    ],
)
def test_wrong_usage(cli, tmp_path, options, word):
    status, _, errors = cli("evaluate", "stereo", "--pairs", write_set(tmp_path / "set"), *options)
    assert (status, word in errors) == (2, True), errors


@pytest.mark.slow
def test_invalid_drives(four_frames, cli, tmp_path):
    status, _, errors = cli(
        "evaluate", "stereo", "--pairs", four_frames, "--align", "leave-two-out"
    )
    assert (status, "single pairs" in errors) == (2, True)
    for missing, word in (("right.mp4", "no such file"), ("truth", "truth.csv")):
        folder = tmp_path / missing
        folder.mkdir()
        for file in four_frames.iterdir():
            if missing not in (file.name, file.stem):
                (folder / file.name).symlink_to(file)
        status, _, errors = cli("evaluate", "stereo", "--pairs", folder, "--matcher", "patch")
        assert (status, word in errors) == (1, True), errors
    (tmp_path / "right.mp4/right.mp4").symlink_to(four_frames / "right.mp4")
    (tmp_path / "right.mp4/rig.yaml").unlink()
    status, _, errors = cli(
        "evaluate", "stereo", "--pairs", tmp_path / "right.mp4", "--matcher", "patch"
    )
    assert (status, "--rig" in errors) == (1, True)
    rig = four_frames / "rig.yaml"
    figures, _ = evaluate(cli, tmp_path / "right.mp4", tmp_path, "--matcher", "patch", "--rig", rig)
    assert figures["n_pairs"] == 4


def test_real_pairs(shared_data, cli, tmp_path):
    figures, _ = evaluate(
        cli,
        shared_data / "kitti2015",
        tmp_path,
        "--matcher",
        "patch,sgbm-centre",
        "--align",
        "leave-two-out",
    )
    patch, centre = figures["matchers"]["patch"], figures["matchers"]["sgbm-centre"]
    assert (figures["n_pairs"], patch["n"], centre["n"]) == (16, 36, 36)
    assert [band["n"] for band in patch["bands"]] == [10, 10, 15]
    assert 0.7 < patch["median_relative_error_pct"] < 1.8
    assert patch["failures_pct"] < centre["failures_pct"]
    # no disparity at the centre of many cars: windows and gaps
    assert 0.7 < np.mean(centre["coverage"]) < 1.0


def seen_by_networks(folder):
    """The set with left images that encode the disparities for `write_stereo`."""
    for truth in sorted((folder / "disp_occ_0").glob("*.png")):
        disparity_px = cv2.imread(str(truth), cv2.IMREAD_UNCHANGED) / 256
        cv2.imwrite(str(folder / "image_2" / truth.name), encoded(disparity_px, DISPARITY_STEP))
    return folder


def test_networks_beside_a_matcher(cli, tmp_path):
    folder = seen_by_networks(write_set(tmp_path / "set", [f"{n:06d}_10" for n in range(7)]))
    exact = write_stereo(tmp_path / "exact.onnx")
    short = write_stereo(tmp_path / "short.onnx", factor=1.1)
    models = ("--matcher", "sgbm", "--stereo-model", exact, "--stereo-model", short)
    figures, printed = evaluate(cli, folder, tmp_path, *models)
    rows = figures["matchers"]
    assert list(rows) == ["sgbm", "disparity-exact", "disparity-short"]
    assert rows["disparity-exact"]["median_relative_error_pct"] < 0.1
    assert rows["disparity-short"]["bias_pct"] == pytest.approx(100 / 1.1 - 100, abs=0.1)
    assert rows["disparity-short"]["ms_per_frame"] > 0
    compared = figures["comparison"]["median_relative_error_pct"]
    assert (compared["reference"], compared["n_blocks"]) == ("disparity-exact", 7)
    assert compared["methods"]["disparity-short"]["is_worse"] is True
    assert compared["n_measured"]["disparity-short"] == 14
    assert "worse than disparity-exact" in " ".join(printed.split())
    alone, _ = evaluate(cli, folder, tmp_path, "--matcher", "sgbm", "--stereo-model", exact)
    assert list(alone["matchers"]) == ["sgbm", "disparity"]


def test_file_that_is_no_stereo_network(cli, tmp_path):
    (tmp_path / "n.onnx").write_bytes(b"no network")
    status, _, errors = cli(
        *("evaluate", "stereo", "--pairs", write_set(tmp_path / "set")),
        *("--stereo-model", tmp_path / "n.onnx"),
    )
    assert (status, "n.onnx" in errors) == (1, True), errors


def test_single_pairs_in_folders_with_several_tables(cli, tmp_path):
    """Objects of one image are one block: identities that are seen once are no tracks."""
    made, folder = write_set(tmp_path / "set", ["000000", "000001", "000002"]), tmp_path / "pairs"
    for part, side in (("image_2", "left"), ("image_3", "right")):
        (folder / side).mkdir(parents=True)
        for image in (made / part).glob("*.png"):
            (folder / side / image.name).write_bytes(image.read_bytes())
    (folder / "calib.txt").write_text(CALIBRATION)
    header = "frame,id,class,x1,y1,x2,y2,distance_m\n"
    for file, car in (("truth.csv", CARS[0]), ("more.csv", CARS[1])):
        x1, y1, x2, y2, disparity_px = car
        distance_m = FOCAL_PX * BASELINE_M / disparity_px
        lines = [f"{n},{7 * n},car,{x1},{y1},{x2},{y2},{distance_m}\n" for n in range(3)]
        (folder / file).write_text(header + "".join(lines))
    figures, _ = evaluate(cli, folder, tmp_path, "--matcher", "patch")
    assert (figures["n_pairs"], figures["n_objects"]) == (3, 3)
    both = ("--truth", folder / "truth.csv", "--truth", folder / "more.csv")
    figures, _ = evaluate(cli, folder, tmp_path, "--matcher", "patch,sgbm", *both)
    assert figures["n_objects"] == 6
    assert figures["matchers"]["patch"]["median_abs_error_px"] < 0.15
    assert figures["comparison"]["failures_pct"]["n_blocks"] == 3
    for wrong, option in (
        ((made, *both), "--truth"),
        ((folder, "--align", "leave-two-out"), "4 p"),
    ):
        status, _, errors = cli("evaluate", "stereo", "--pairs", *wrong)
        assert (status, option in errors) == (2, True), errors


def test_pairs_of_kitti_360(shared_data, cli, tmp_path):
    """Their disparities are 0.4 px too small, which other pairs show."""
    folder = shared_data / "kitti360"
    both = ("--truth", folder / "detected.csv", "--truth", folder / "truth.csv")
    aligned, _ = evaluate(
        cli, folder, tmp_path, "--matcher", "patch", *both, "--align", "leave-two-out"
    )
    assert aligned["matchers"]["patch"]["median_relative_error_pct"] < 2
    figures, _ = evaluate(cli, folder, tmp_path, "--matcher", "patch,sgbm", *both)
    assert (figures["n_pairs"], figures["n_objects"]) == (7, 36)
    assert figures["comparison"]["median_relative_error_pct"]["n_blocks"] == 6
    assert figures["matchers"]["sgbm"]["median_relative_error_pct"] < 6
