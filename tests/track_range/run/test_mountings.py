"""Runs on cameras that do not look along the drive, without a word about their mounting."""

import csv
import json

import cv2
import numpy as np
import pytest

from tests.stereo.streets import CAMERA, HEIGHT_M, street
from tests.support.recordings.recording_files import write_video
from track_range.stereo.geometry.mounting import Mounting

SPEED_MPS = 6.0


def run(cli, tmp_path, mounting, n):
    """Notes and poses of a run on a street, with a known height."""
    grey = [street(mounting, 0.1 * SPEED_MPS * k) for k in range(n)]
    images = [cv2.cvtColor(image, cv2.COLOR_GRAY2BGR) for image in grey]
    (tmp_path / "boxes.txt").write_text("")
    options = ("--focal-px", CAMERA.fx_px, "--camera-height-m", HEIGHT_M, "--out", tmp_path / "out")
    video = write_video(tmp_path / "street.mp4", [images])
    status, _, errors = cli("--mono", video, "--detections", tmp_path / "boxes.txt", *options)
    assert status == 0, errors
    notes = json.loads((tmp_path / "out/summary.json").read_text())["notes"]
    with (tmp_path / "out/poses.csv").open() as file:
        rows = list(csv.DictReader(file))
    return notes, np.array([[float(row["x_m"]), float(row["y_m"])] for row in rows])


@pytest.mark.slow
def test_a_camera_that_looks_aside_is_named_once_and_its_path_is_that_of_the_vehicle(cli, tmp_path):
    """4.9 s at 6 m/s; the car drives to the left of the camera's axis."""
    notes, path_m = run(cli, tmp_path, Mounting(yaw_deg=-58.0, pitch_deg=5.0), 50)
    (shown,) = (note for note in notes if "to the right of the direction of travel" in note)
    assert "looks 58 ± 2 degrees" in shown or "looks 57 ± 2 degrees" in shown
    assert sum("does not look along the drive" in note for note in notes) == 1
    way_m = path_m[-1] - path_m[0]
    assert np.degrees(np.arctan2(way_m[1], way_m[0])) == pytest.approx(58.0, abs=4.0)
    assert np.linalg.norm(way_m) == pytest.approx(0.1 * SPEED_MPS * (len(path_m) - 1), rel=0.05)


@pytest.mark.slow
def test_a_camera_ahead_is_not_named(cli, tmp_path):
    notes, _ = run(cli, tmp_path, Mounting(pitch_deg=5.0), 50)
    assert not any("direction of travel" in note for note in notes)
