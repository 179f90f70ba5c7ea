"""Tests of `track-range align`: a simulated drive, its labels, tables, KITTI's data, and invalid
input."""

from __future__ import annotations

import json
import math
import shutil
from contextlib import closing
from dataclasses import replace

import cv2
import numpy as np
import pytest

from track_range.calibration.align import RigAlignment
from track_range.detection.formats.video_labels.kitti import read_kitti
from track_range.recording.recording import open_recording
from track_range.stereo.alignment.file import load_alignment
from track_range.stereo.alignment.pair_finding import PairFinding
from track_range.stereo.geometry.alignment import Alignment
from track_range.stereo.geometry.camera import PinholeCamera
from track_range.stereo.geometry.rig import StereoRig
from track_range.stereo.rig_formats.reading import load_rig
from track_range.stereo.rig_formats.rig_yaml import save_rig

SIZE_PX = (620, 188)


@pytest.fixture
def videos(drive_folder):
    return "--stereo", drive_folder / "left.mp4", drive_folder / "right.mp4"


def near_boxes(drive):
    """Frame, box, id and depth of the centre of the cars that are completely visible and nearer
    than 40 m."""
    labels = read_kitti(drive / "truth.txt")
    clear = (labels.kitti_type == "Car") & (labels.truncated == 0) & (labels.occluded == 0)
    clear &= labels.location_m[:, 2] < 40
    return (
        labels.frame[clear],
        labels.xyxy_px[clear],
        labels.track_id[clear],
        labels.location_m[clear, 2],
    )


def test_values_of_the_pair_are_doubted_by_errors_that_are_clear_and_matter():
    rig = StereoRig.rectified(PinholeCamera(720.0, 720.0, 600.0, 180.0, 1200, 360), 0.5)
    measured = Alignment(
        offset_px=0.05, offset_sigma_px=0.02, row_offset_px=2.0, roll_deg=0.01, focal_ratio=1.004
    )
    aligned = replace(RigAlignment.of(rig, measured, ()), view_sigma=np.array([0.02, 0.001, 0.003]))
    pitch, roll, ratio, offset = aligned.values
    # 2 px of 720; 0.06 px of rows do not matter; 1.3 sigma; 0.4 % at 30 m
    assert pitch.shown == pytest.approx(math.degrees(2 / 720))
    assert pitch.sigma == pytest.approx(math.degrees(0.02 / 720))
    assert [value.is_doubted for value in (pitch, roll, ratio, offset)] == [True, *3 * [False]]
    assert (ratio.given, ratio.shown, offset.sigma) == (1.0, 1.004, 0.02)
    assert len(replace(aligned, view_sigma=None).values) == 1
    assert aligned.figures["cameras"][0]["name"] == pitch.name


@pytest.mark.slow
def test_drive_without_error_is_not_corrected(videos, tmp_path, cli):
    out, figures = tmp_path / "align.yaml", tmp_path / "figures.json"
    status, printed, _ = cli("align", *videos, "--out", out, "--json", figures)
    assert status == 0
    assert str(out) in printed
    read = json.loads(figures.read_text())
    assert read["is_clear"] is False
    assert abs(read["measured"]["offset_px"]) < 2 * read["measured"]["offset_sigma_px"] < 0.2
    assert (read["alignment"]["offset_px"], read["alignment"]["bow_px"]) == (0.0, 0.0)
    assert load_alignment(out).residual_px == read["alignment"]["residual_px"]


@pytest.mark.slow
def test_two_drives_are_combined(drive_folder, tmp_path, cli):
    figures = tmp_path / "figures.json"
    options = (
        "--drive",
        drive_folder,
        "--drive",
        drive_folder,
        "--out",
        tmp_path / "align.yaml",
        "--json",
        figures,
    )
    status, printed, _ = cli("align", *options)
    assert status == 0
    # the names, since the file may be used for another drive
    assert f"{drive_folder.name}, {drive_folder.name}" in printed


def test_label_file_and_folder_agree(drive_folder, videos, tmp_path, cli):
    by_folder, by_file = tmp_path / "folder.yaml", tmp_path / "file.yaml"
    assert cli("align", "--reference", drive_folder, "--out", by_folder)[0] == 0
    assert (
        cli("align", "--reference", drive_folder / "truth.csv", *videos, "--out", by_file)[0] == 0
    )
    folder, file = load_alignment(by_folder), load_alignment(by_file)
    assert abs(folder.offset_px) < 0.1
    # they differ in the range of distances
    assert file.offset_px == pytest.approx(folder.offset_px, abs=0.1)


@pytest.mark.slow
def test_table_of_disparities_with_an_offset(drive_folder, videos, tmp_path, cli):
    rig, _ = load_rig(drive_folder / "rig.yaml", size_px=SIZE_PX)
    frame, box, number, depth_m = near_boxes(drive_folder)
    front_px = rig.left.fx_px * rig.baseline_m / (depth_m - 2.0)
    assert len(frame) > 10
    rows = [[*row] for row in np.column_stack([frame, box, front_px + 2.0, number]).tolist()]
    table = tmp_path / "known.CSV"
    table.write_text(
        "frame,x1,y1,x2,y2,disparity_px,id\n" + "\n".join(",".join(map(str, row)) for row in rows)
    )
    out = tmp_path / "align.yaml"
    status, _, errors = cli("align", "--reference", table, *videos, "--out", out)
    assert status == 0, errors
    offset_px = load_alignment(out).offset_px
    table.write_text(
        "frame,x1,y1,x2,y2,distance_m,id\n"
        + "\n".join(
            ",".join(map(str, [*row[:5], rig.left.fx_px * rig.baseline_m / row[5], row[6]]))
            for row in rows
        )
    )
    assert cli("align", "--reference", table, *videos, "--out", out)[0] == 0
    assert load_alignment(out).offset_px == pytest.approx(offset_px, abs=0.05)
    assert 1.0 < offset_px < 3.0


@pytest.mark.parametrize(
    ("text", "word"),
    [
        ("1,2,3\n", "header"),
        ("frame,x1,y1,x2,y2\n0,1,2,3,4\n", "header"),
        ("frame,x1,y1,x2,y2,distance_m,disparity_px\n0,1,2,3,4,5,6\n", "header"),
        ("frame,x1,y1,x2,y2,distance_m\n0,1,2,3,4,far\n", "line 2"),
        ("frame,x1,y1,x2,y2,distance_m\n0,1,2,3,4,nan\n", "line 2"),
        ("frame,x1,y1,x2,y2,distance_m\n0,1,2,3,4,-5\n", "distance_m"),
        ("frame,x1,y1,x2,y2,disparity_px\n0,1,2,3,4,1e-320\n", "disparity_px"),
        ("frame,x1,y1,x2,y2,distance_m\n1e300,1,2,3,4,5\n", "frame"),
        ("frame,x1,y1,x2,y2,distance_m,id\n0,1,2,3,4,5,1e300\n", "id"),
        ("frame,x1,y1,x2,y2,distance_m\n0.5,1,2,3,4,5\n", "frame"),
        ("frame,x1,y1,x2,y2,distance_m\n900,1,2,3,4,5\n", "frame"),
        ("frame,x1,y1,x2,y2,distance_m\n0,100,20,160,60,9\n", "at least 5"),
        ("frame,x1,y1,x2,y2,distance_m\n0,1,2\n", "line 2"),
    ],
)
def test_invalid_tables(videos, tmp_path, cli, text, word):
    table = tmp_path / "known.csv"
    table.write_text(text)
    status, _, errors = cli(
        "align", "--reference", table, *videos, "--out", tmp_path / "align.yaml"
    )
    assert status == 1
    assert word in errors
    assert not (tmp_path / "align.yaml").exists()


def test_table_is_not_text(videos, tmp_path, cli):
    table = tmp_path / "known.csv"
    table.write_bytes(b"\xff\xfe\x00")
    status, _, errors = cli(
        "align", "--reference", table, *videos, "--out", tmp_path / "align.yaml"
    )
    assert (status, "known.csv" in errors, "CSV" in errors) == (1, True, True)


@pytest.mark.parametrize(
    ("options", "status", "word"),
    [
        ((), 2, "--drive"),
        (("--reference", "{drive}", "--drive", "{drive}"), 2, "--reference"),
        (("--reference", "{drive}/truth.txt"), 2, "--stereo"),
        (
            ("--reference", "{drive}", "--stereo", "{drive}/left.mp4", "{drive}/right.mp4"),
            2,
            "--stereo",
        ),
        (("--reference", "{drive}/none.csv"), 1, "none.csv: no such file"),
        (("--drive", "{drive}/none"), 1, "left.mp4: no such file"),
        (("--stereo", "{drive}/right.mp4", "{drive}/left.mp4"), 1, "swapped"),
    ],
)
def test_wrong_usage(drive_folder, tmp_path, cli, options, status, word):
    arguments = [option.format(drive=drive_folder) for option in options]
    actual, _, errors = cli("align", *arguments, "--out", tmp_path / "align.yaml")
    assert actual == status, errors
    assert word in errors


@pytest.mark.slow
def test_missing_and_different_rigs(drive_folder, videos, tmp_path, cli):
    alone = tmp_path / "alone"
    alone.mkdir()
    for side in ("left", "right"):
        shutil.copy(drive_folder / f"{side}.mp4", alone)
    out = ("--out", tmp_path / "align.yaml")
    status, _, errors = cli("align", "--drive", alone, *out)
    assert (status, "--rig" in errors) == (1, True)
    assert cli("align", "--drive", alone, "--rig", drive_folder / "rig.yaml", *out)[0] == 0
    rig, _ = load_rig(drive_folder / "rig.yaml", size_px=SIZE_PX)
    save_rig(StereoRig.rectified(rig.left, 0.4), alone / "rig.yaml")
    status, _, errors = cli("align", "--drive", alone, "--drive", drive_folder, *out)
    assert (status, "different rigs" in errors) == (1, True)


@pytest.mark.slow
def test_too_short_drive_writes_nothing(render_drive, tmp_path, cli):
    short = render_drive(seed=1, seconds=0.4).left.parent
    status, _, errors = cli("align", "--drive", short, "--out", tmp_path / "align.yaml")
    assert status == 1
    assert "left.mp4" in errors
    assert "10 frames" in errors
    assert not (tmp_path / "align.yaml").exists()


@pytest.mark.slow
def test_large_offset_is_estimated_and_applied_by_a_run(drive_folder, tmp_path, cli):
    capture = cv2.VideoCapture(str(drive_folder / "right.mp4"))
    (tmp_path / "right").mkdir()
    for number in range(int(capture.get(cv2.CAP_PROP_FRAME_COUNT))):
        image = np.roll(capture.read()[1], 24, axis=1)  # disparities are 24 px too small
        cv2.imwrite(str(tmp_path / "right" / f"{number:06d}.png"), image)
    pair = drive_folder / "left.mp4", tmp_path / "right"
    status, printed, _ = cli("align", "--stereo", *pair, "--out", tmp_path / "align.yaml")
    assert status == 0
    assert "px too small, as with shifted images" in " ".join(printed.split())
    alignment = load_alignment(tmp_path / "align.yaml")
    assert alignment.offset_px == pytest.approx(24.0, abs=0.3)
    assert alignment.residual_px < 0.5
    with closing(open_recording(*pair, align=tmp_path / "align.yaml")) as recording:
        assert recording.finding == PairFinding("fits")
        assert recording.alignment.offset_px == pytest.approx(alignment.offset_px - 24.0)
    with closing(open_recording(*pair, align="off")) as recording:
        assert recording.rig is None
        assert "--align auto corrects this error" in recording.finding.sentence


def test_invalid_output_paths(drive_folder, videos, tmp_path, cli):
    (tmp_path / "file").write_text("")
    before = (drive_folder / "rig.yaml").read_text()
    for out, word in (
        (tmp_path / "file" / "align.yaml", "found a file"),
        (tmp_path, "folder"),
        (drive_folder / "rig.yaml", "rig.yaml"),
    ):
        status, _, errors = cli("align", *videos, "--out", out)
        assert (status, word in errors) == (1, True), errors
    assert (drive_folder / "rig.yaml").read_text() == before
    same = ("--out", tmp_path / "a.yaml", "--json", tmp_path / "a.yaml")
    assert "two outputs" in cli("align", *videos, *same)[2]


def test_alignment_of_kitti_drives_corrects_kitti_pairs(shared_data, tmp_path, cli):
    """The alignment from the images of two drives, applied to 16 pairs of other drives with the
    same cameras."""
    out, before, after = tmp_path / "align.yaml", tmp_path / "off.json", tmp_path / "on.json"
    drives = [shared_data / "kitti_stereo" / name for name in ("0003", "0005")]
    status, printed, _ = cli("align", "--drive", drives[0], "--drive", drives[1], "--out", out)
    assert status == 0
    assert "px" in printed
    assert 0.35 < load_alignment(out).offset_px < 0.55
    for align, figures in (("off", before), (out, after)):
        options = ("--matcher", "patch", "--align", align, "--json", figures)
        assert cli("evaluate", "stereo", "--pairs", shared_data / "kitti2015", *options)[0] == 0
    uncorrected, corrected = (
        json.loads(file.read_text())["matchers"]["patch"] for file in (before, after)
    )
    assert uncorrected["median_relative_error_pct"] > 2.0
    # The truth is a median over the inner half; the curved surface at its centre is 0.5 % nearer.
    assert 0.8 < corrected["median_relative_error_pct"] < 2.1
    assert abs(corrected["bias_pct"]) < 2.0


def test_kitti_pairs_as_reference(shared_data, tmp_path, cli):
    out = tmp_path / "align.yaml"
    status, printed, _ = cli("align", "--reference", shared_data / "kitti2015", "--out", out)
    assert status == 0
    assert "36 known distances" in printed
    alignment = load_alignment(out)
    assert 0.2 < alignment.offset_px < 0.6
    assert alignment.curvature_px == 0.0
    assert abs(alignment.row_offset_px) < 0.5
