"""`track-range rig check`, and runs with a rig file with errors, on a rendered drive."""

from __future__ import annotations

import json
from pathlib import Path

import cv2
import numpy as np
import pytest
import typer

from track_range.cli.commands.align import check_app
from track_range.recording.recording import open_recording
from track_range.simulation.drive import write_drive
from track_range.simulation.settings import DriveOptions
from track_range.stereo.alignment.from_drive import DriveAlignment
from track_range.stereo.geometry.camera import PinholeCamera
from track_range.stereo.geometry.rig import StereoRig
from track_range.stereo.rig_formats.reading import load_rig
from track_range.stereo.rig_formats.rig_yaml import save_rig

SIZE_PX = (620, 188)


def save_rotated(drive, path, *, pitch_deg=0.0, yaw_deg=0.0, roll_deg=0.0):
    """Write the drive's rig file with a wrong angle of the right camera."""
    rig, _ = load_rig(drive / "rig.yaml", size_px=SIZE_PX)
    rotation = np.eye(4)
    rotation[:3, :3] = cv2.Rodrigues(np.radians([pitch_deg, yaw_deg, roll_deg]))[0]
    save_rig(StereoRig(rig.left, rig.right, rotation @ rig.right_from_left), path)
    return path


def test_a_drive_is_required(cli):
    status, _, errors = cli("rig", "check")
    assert (status, "--drive" in errors) == (2, True)


@pytest.mark.slow
def test_table_and_json_of_a_good_rig(drive_folder, tmp_path, cli):
    figures = tmp_path / "health.json"
    status, printed, _ = cli("rig", "check", "--drive", drive_folder, "--json", figures)
    assert status == 0
    assert "Expected distance error" in printed
    assert "baseline" in printed
    assert "pitch of the right camera" in printed
    read = json.loads(figures.read_text())
    for value in read["cameras"]:
        assert abs(value["shown"] - value["given"]) < 3 * value["sigma"]
        assert not value["is_doubted"]
    health = read["health"]
    assert health["state"] == "good"
    assert [row["distance_m"] for row in health["distances"]] == [10.0, 20.0, 30.0, 50.0]
    assert len(health["windows"]) == 1


@pytest.mark.slow
@pytest.mark.parametrize("angles", [{"yaw_deg": 0.4}, {"pitch_deg": 0.4}, {"roll_deg": 0.5}])
def test_runs_correct_a_wrong_rig_file(drive_folder, tmp_path, angles):
    """The frames of a run, rectified with the correction, have no error beyond the one that is
    added to disparities."""
    rig = save_rotated(drive_folder, tmp_path / "rig.yaml", **angles)
    recording = open_recording(drive_folder / "left.mp4", drive_folder / "right.mp4", rig=rig)
    alignment = recording.calibration.alignment
    assert alignment.health.state == "off"
    again = DriveAlignment(recording.rig)
    for frame in recording.frames:
        again.add(frame)
    recording.close()
    remaining = again.estimate()
    applied = alignment.applied.after_shift()
    assert abs(applied.offset_px) < 0.6  # larger ones shift the right image
    assert remaining.offset_px == pytest.approx(applied.offset_px, abs=0.1)
    assert remaining.row_offset_px == pytest.approx(0.0, abs=0.1)
    assert remaining.roll_deg == pytest.approx(0.0, abs=0.03)


@pytest.mark.real
@pytest.mark.parametrize("factor", [1.0, 1.5])
def test_the_speed_checks_the_baseline(shared_data, tmp_path, cli, factor):
    drive = shared_data / "kitti_stereo" / "0003"
    rig, _ = load_rig(drive / "calib.txt", size_px=(1242, 374))
    save_rig(StereoRig.rectified(rig.left, factor * rig.baseline_m), tmp_path / "rig.yaml")
    options = (
        "--rig",
        tmp_path / "rig.yaml",
        "--ego-speed",
        drive / "oxts",
        "--json",
        tmp_path / "rig.json",
    )
    status, printed, _ = cli(
        "rig", "check", "--stereo", drive / "left.mp4", drive / "right.mp4", *options
    )
    assert status == 0
    baseline = json.loads((tmp_path / "rig.json").read_text())["baseline"]
    assert baseline["baseline_check"]["sigma"] < 0.08
    assert ("scale_doubt" in baseline) == (factor != 1.0)
    text = (
        "The baseline agrees with the drive"
        if factor == 1.0
        else "Scale in doubt: the baseline is 1."
    )
    assert text in printed.replace("\n", " ")


def test_a_reference_has_no_speed(cli, drive_folder, tmp_path):
    options = ("--reference", drive_folder, "--out", tmp_path / "align.yaml", "--ego-speed", "50")
    status, _, errors = cli("align", *options)
    assert status == 2
    assert "--ego-speed" in errors


def test_one_recording_is_both_videos():
    app = typer.main.get_command(check_app)
    for given in (["--stereo", "a.mp4"], ["--stereo=a.mp4"], ["--stereo", "a.mp4", "a.mp4"]):
        context = app.make_context("check", [*given, "--stereo-layout", "top-bottom"])
        assert context.params["stereo"] == (Path("a.mp4"), Path("a.mp4"))
        assert context.params["stereo_layout"] == "top-bottom"
    assert app.make_context("check", ["--stereo", "a", "b"]).params["stereo"] == (
        Path("a"),
        Path("b"),
    )


@pytest.mark.slow
def test_one_recording_measures_as_two(tmp_path, cli):
    figures = {}
    for name, options in {"two": (), "one": ("--stereo-layout", "right-left")}.items():
        folder = tmp_path / name
        rig = StereoRig.rectified(PinholeCamera(400.0, 400.0, 309.5, 93.5, *SIZE_PX), 0.54)
        layout = options[1] if options else None
        drive = write_drive(
            folder, seconds=1.3, rig=rig, options=DriveOptions(lossless=True, stereo_layout=layout)
        )
        names = [drive.left] if options else [drive.left, drive.right]
        status, _, errors = cli(
            "rig", "check", "--stereo", *names, *options, "--json", folder / "check.json"
        )
        assert status == 0, errors
        figures[name] = json.loads((folder / "check.json").read_text())["measured"]
    for given in figures.values():
        given.pop("source")
    assert figures["one"] == figures["two"]
