"""Runs on cameras that do not look along the drive, without a word about their mounting."""

import csv
import json

import cv2
import numpy as np
import pytest

from tests.stereo.streets import CAMERA, HEIGHT_M, street
from tests.support.recordings.recording_files import write_video
from track_range.calibration.drive.shown_mounting import direction_text
from track_range.stereo.geometry.mounting import Mounting

SPEED_MPS = 6.0


def run(cli, tmp_path, mounting, n, *given):
    """Summary and poses of a run on a street, with a known height and further options."""
    grey = [street(mounting, 0.1 * SPEED_MPS * k) for k in range(n)]
    images = [cv2.cvtColor(image, cv2.COLOR_GRAY2BGR) for image in grey]
    (tmp_path / "boxes.txt").write_text("")
    options = (
        "--focal-px",
        CAMERA.fx_px,
        "--camera-height-m",
        HEIGHT_M,
        "--out",
        tmp_path / "out",
        *given,
    )
    video = write_video(tmp_path / "street.mp4", [images])
    status, _, errors = cli("--mono", video, "--detections", tmp_path / "boxes.txt", *options)
    assert status == 0, errors
    summary = json.loads((tmp_path / "out/summary.json").read_text())
    with (tmp_path / "out/poses.csv").open() as file:
        rows = list(csv.DictReader(file))
    return summary, np.array([[float(row["x_m"]), float(row["y_m"])] for row in rows])


@pytest.mark.slow
def test_a_camera_that_looks_aside_is_named_once_and_its_path_is_that_of_the_vehicle(cli, tmp_path):
    """4.9 s at 6 m/s; the car drives to the left of the camera's axis."""
    summary, path_m = run(cli, tmp_path, Mounting(yaw_deg=-58.0, pitch_deg=5.0), 50)
    notes, mounting = summary["notes"], summary["mounting"]
    assert mounting["source"] == "images"
    assert mounting["yaw_deg"] == pytest.approx(-58.0, abs=2 * mounting["sigma_deg"])
    (shown,) = (note for note in notes if "to the right of the direction of travel" in note)
    assert "looks 58 ± 2 degrees" in shown or "looks 57 ± 2 degrees" in shown
    assert sum("does not look along the drive" in note for note in notes) == 1
    way_m = path_m[-1] - path_m[0]
    assert np.degrees(np.arctan2(way_m[1], way_m[0])) == pytest.approx(58.0, abs=4.0)
    assert np.linalg.norm(way_m) == pytest.approx(0.1 * SPEED_MPS * (len(path_m) - 1), rel=0.05)


@pytest.mark.slow
def test_a_camera_ahead_is_not_named(cli, tmp_path):
    summary, _ = run(cli, tmp_path, Mounting(pitch_deg=5.0), 50)
    assert not any("direction of travel" in note for note in summary["notes"])
    unknown = {"yaw_deg": 0.0, "pitch_deg": 0.0, "roll_deg": 0.0, "sigma_deg": None}
    assert summary["mounting"] == {**unknown, "source": "assumed"}


@pytest.mark.slow
@pytest.mark.parametrize(
    ("given", "stated"), [("yaw=58", "58 ± 2 degrees to the left"), ("yaw=0", "0 ± 2 degrees")]
)
def test_a_given_mounting_that_the_images_contradict_is_named_and_used(
    cli, tmp_path, given, stated
):
    summary, _ = run(cli, tmp_path, Mounting(yaw_deg=-58.0), 50, "--mount", given)
    (shown,) = (note for note in summary["notes"] if "motion of the images" in note)
    assert "to the right of the direction of travel" in shown
    assert "--mount yaw=-5" in shown
    assert f"Its mounting, which is used, states {stated}" in shown
    assert summary["mounting"]["yaw_deg"] == float(given.removeprefix("yaw="))
    assert summary["mounting"]["source"] == "given"
    assert not any("px too far" in note for note in summary["notes"])


@pytest.mark.slow
@pytest.mark.parametrize(("yaw_deg", "given"), [(-58.0, "yaw=-58"), (-179.0, "yaw=180")])
def test_a_given_mounting_that_the_images_confirm_has_no_note(cli, tmp_path, yaw_deg, given):
    summary, _ = run(cli, tmp_path, Mounting(yaw_deg=yaw_deg), 50, "--mount", given)
    assert not any("direction of travel" in note for note in summary["notes"])


@pytest.mark.slow
def test_a_wrong_sign_is_named_on_a_real_drive(cli, shared_data, tmp_path):
    folder = shared_data / "pandaset"
    (tmp_path / "boxes.txt").write_text("")
    files = ("--rig", folder / "calib/front_right.txt", "--detections", tmp_path / "boxes.txt")
    options = (*files, "--mount", "yaw=58", "--out", tmp_path / "out")
    status, _, errors = cli("--mono", folder / "front_right.mp4", *options)
    assert status == 0, errors
    notes = json.loads((tmp_path / "out/summary.json").read_text())["notes"]
    (shown,) = (note for note in notes if "motion of the images" in note)
    assert "57 ± 2 degrees to the right" in shown
    assert "58 ± 2 degrees to the left" in shown


@pytest.mark.parametrize(
    ("yaw_deg", "words"),
    [
        (-179.8, "to the rear (± 2 degrees)"),
        (179.8, "to the rear (± 2 degrees)"),
        (-150.0, "150 ± 2 degrees to the right of the direction of travel"),
        (58.0, "58 ± 2 degrees to the left of the direction of travel"),
    ],
)
def test_words_for_a_direction(yaw_deg, words):
    assert direction_text(Mounting(yaw_deg=yaw_deg)) == words
