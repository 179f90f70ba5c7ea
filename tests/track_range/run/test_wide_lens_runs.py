"""Runs on videos of wide lenses: distances, boxes and overlay in the recorded images, and invalid
options."""

from __future__ import annotations

import csv
import json

import numpy as np
import pytest

from track_range.recording.sources.open_video import open_video
from track_range.results.formats.csv_file import read_tracks_csv
from track_range.simulation.drive import write_drive
from track_range.stereo.geometry.camera import PinholeCamera
from track_range.stereo.geometry.rectification import Undistorter
from track_range.stereo.geometry.rig import StereoRig
from track_range.stereo.rig_formats.rig_yaml import save_camera

LENS = PinholeCamera(260.0, 260.0, 319.5, 159.5, 640, 320, (0.01, 0.0, 0.0, 0.0), "kannala-brandt")


@pytest.fixture(scope="module")
def wide_drive(tmp_path_factory):
    return write_drive(
        tmp_path_factory.mktemp("wide"), seed=5, seconds=1.0, rig=StereoRig.rectified(LENS, 0.54)
    )


def recorded_boxes(folder):
    with (folder / "recorded_boxes.csv").open(newline="") as file:
        return list(csv.DictReader(file))


def size_px(video):
    reader = open_video(video)
    return reader.width_px, reader.height_px


@pytest.mark.slow
def test_stereo_run(cli, wide_drive, tmp_path):
    options = (
        "--detections",
        wide_drive.detections,
        "--truth",
        wide_drive.table,
        "--align",
        "off",
        "--no-sgbm",
    )
    outputs = ("--write", "csv,recorded", "--overlay-recorded", "--out", tmp_path)
    status, printed, errors = cli("--stereo", wide_drive.left, wide_drive.right, *options, *outputs)
    assert status == 0, errors
    assert "The lens sees 1" in printed
    assert size_px(tmp_path / "overlay.mp4") == (640, 320)
    stereo = json.loads((tmp_path / "summary.json").read_text())["methods"]["stereo"]
    assert stereo["n"] > 20
    assert stereo["median_relative_error_pct"] < 2.5
    columns = read_tracks_csv(tmp_path / "tracks.csv")
    rows = recorded_boxes(tmp_path)
    assert len(rows) == len(columns["frame"])
    boxes = np.stack([columns[f"{name}_px"] for name in ("x1", "y1", "x2", "y2")], axis=1)
    recorded = np.array(
        [[float(row[f"{name}_px"]) for name in ("x1", "y1", "x2", "y2")] for row in rows]
    )
    points_m = [[row[name] for name in ("x_m", "y_m", "z_m")] for row in rows if row["z_m"]]
    assert np.allclose(
        np.array(points_m, float)[:, 2],
        columns["fused_m"][[bool(row["z_m"]) for row in rows]],
        atol=0.01,
    )
    assert np.allclose(recorded, Undistorter(LENS).recorded_boxes(boxes), atol=0.02)
    assert not np.allclose(recorded, boxes, atol=5)


@pytest.mark.slow
def test_one_camera_with_a_field_of_view(cli, wide_drive, tmp_path):
    save_camera(LENS, tmp_path / "camera.yaml")
    options = (
        "--rig",
        tmp_path / "camera.yaml",
        "--fov-deg",
        80,
        "--detections",
        wide_drive.detections,
    )
    status, printed, errors = cli("--mono", wide_drive.left, *options, "--out", tmp_path / "run")
    assert status == 0, errors
    assert "80 x" in printed
    camera = Undistorter(LENS, fov_deg=80).camera
    assert size_px(tmp_path / "run" / "overlay.mp4") == (camera.width_px, camera.height_px)


@pytest.mark.slow
def test_several_views(cli, wide_drive, tmp_path):
    save_camera(LENS, tmp_path / "camera.yaml")
    options = (
        "--rig",
        tmp_path / "camera.yaml",
        "--fov-deg",
        60,
        "--detections",
        wide_drive.detections,
        "--no-overlay",
    )
    out = tmp_path / "out"
    status, printed, errors = cli(
        "--mono", wide_drive.left, *options, "--views=40,-40,0", "--write", "csv", "--out", out
    )
    assert status == 0, errors
    assert "views.csv" in printed
    assert "no lane lines" in printed
    with (out / "views.csv").open(newline="") as file:
        rows = list(csv.DictReader(file))
    assert {row["view_deg"] for row in rows} == {"-40", "0", "40"}
    assert [int(row["frame"]) for row in rows] == sorted(int(row["frame"]) for row in rows)
    n_single = sum(len(recorded_boxes(out / f"view{name}")) for name in ("-40", "+0", "+40"))
    assert len(rows) < n_single  # objects in two views have one row
    with wide_drive.table.open(newline="") as file:
        truth = [row for row in csv.DictReader(file) if float(row["visible_share"]) > 0.8]
    undistorter = Undistorter(LENS)
    edges = np.array([[float(row[name]) for name in ("x1", "y1", "x2", "y2")] for row in truth])
    recorded = undistorter.recorded_boxes(edges)
    n_matched, errors_of_views = 0, {"-40": [], "0": [], "40": []}
    for row in rows:
        box = np.array([float(row[f"{name}_px"]) for name in ("x1", "y1", "x2", "y2")])
        of_frame = [i for i, label in enumerate(truth) if label["frame"] == row["frame"]]
        distance_px = np.abs(recorded[of_frame] - box).max(axis=1)
        if row["z_m"] and distance_px.min() < 6:
            true_m = float(truth[of_frame[int(distance_px.argmin())]]["distance_m"])
            errors_of_views[row["view_deg"]].append(abs(float(row["z_m"]) / true_m - 1))
            n_matched += 1
    assert n_matched > 30
    assert all(np.median(errors) < 0.15 for errors in errors_of_views.values())


@pytest.mark.parametrize("views", ["0", "0,0", "left", "0,150", ""])
def test_wrong_views(cli, small_drive, tmp_path, views):
    status, _, errors = cli(
        "--mono", small_drive.left, f"--views={views}", "--focal-px", 300, "--out", tmp_path
    )
    assert status == 2
    assert "--views" in errors


@pytest.mark.slow
def test_impossible_direction_is_found_before_the_first_run(cli, wide_drive, tmp_path):
    save_camera(LENS, tmp_path / "camera.yaml")
    options = (
        "--rig",
        tmp_path / "camera.yaml",
        "--fov-deg",
        60,
        "--detections",
        wide_drive.detections,
        "--no-overlay",
    )
    out = tmp_path / "out"
    status, _, errors = cli("--mono", wide_drive.left, *options, "--views=0,115", "--out", out)
    assert (status, "--yaw-deg 115" in errors) == (1, True), errors
    assert not list(out.glob("view*"))
    status, _, errors = cli(
        "--mono",
        wide_drive.left,
        *options,
        "--views=0,40",
        "--table",
        tmp_path / "t.md",
        "--out",
        out,
    )
    assert (status, "--table" in errors) == (2, True), errors


def test_views_of_a_pair_are_refused(cli, small_drive, tmp_path):
    pair = ("--stereo", small_drive.left, small_drive.right)
    assert "--views" in cli(*pair, "--views=0,60", "--out", tmp_path)[2]
    assert "--yaw-deg" in cli(*pair, "--yaw-deg", 60, "--out", tmp_path)[2]


def test_field_of_view_needs_a_wide_lens(cli, small_drive, tmp_path):
    options = ("--rig", small_drive.rig, "--detections", small_drive.detections, "--out", tmp_path)
    status, _, errors = cli("--mono", small_drive.left, *options, "--fov-deg", 80)
    assert status == 1
    assert "--fov-deg" in errors
    assert "wide lens" in errors


def test_overlay_on_recorded_images_needs_a_wide_lens(cli, small_drive, tmp_path):
    options = ("--rig", small_drive.rig, "--detections", small_drive.detections, "--out", tmp_path)
    status, printed, _ = cli(
        "--mono", small_drive.left, *options, "--overlay-recorded", "--duration", 0.2
    )
    assert status == 0
    assert "no wide lens" in printed


@pytest.mark.parametrize("other", ["--no-overlay", "--anonymize", "--overlay-disparity"])
def test_options_that_contradict_the_overlay_on_recorded_images(cli, small_drive, tmp_path, other):
    status, _, errors = cli(
        "--stereo",
        small_drive.left,
        small_drive.right,
        "--overlay-recorded",
        other,
        "--out",
        tmp_path,
    )
    assert status == 2
    assert "--overlay-recorded" in errors
