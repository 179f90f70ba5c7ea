"""Recordings whose pixels are not square: what the file states, what is usual, and calibrations of
either size."""

import math
from fractions import Fraction
from pathlib import Path

import cv2
import numpy as np
import pytest

from track_range.recording.recording import open_recording
from track_range.stereo.geometry.camera import PinholeCamera
from track_range.stereo.geometry.rig import StereoRig
from track_range.stereo.rig_formats.rig_yaml import save_camera, save_rig

SQUARE = PinholeCamera(150.0, 150.0, 63.5, 23.5, 128, 48)
STORED = PinholeCamera(75.0, 150.0, 31.5, 23.5, 64, 48)


@pytest.fixture
def video(tmp_path: Path, film) -> Path:
    return film(tmp_path / "1080n.mp4", [0.0, 0.1], aspect=Fraction(2))


def test_the_focal_length_is_that_of_square_pixels(video):
    recording = open_recording(video, focal_px=150.0)
    assert recording.camera == SQUARE
    assert next(recording.frames).left.shape == (48, 128, 3)
    assert any(
        "2 times as wide as high" in note and "128x48 px" in note for note in recording.notes
    )
    recording.close()
    recording = open_recording(video, video, focal_px=150.0)  # a pair without a calibration
    assert recording.camera == SQUARE
    frame = next(recording.frames)
    assert frame.left.shape == (48, 128, 3)
    assert frame.right is not None
    assert frame.right.shape == (48, 128)
    recording.close()


@pytest.mark.parametrize("calibrated", [STORED, SQUARE])
def test_calibrations_of_stored_and_of_square_pixels(video, tmp_path, calibrated):
    save_camera(calibrated, tmp_path / "camera.yaml")
    save_rig(StereoRig.rectified(calibrated, 0.5), tmp_path / "pair.yaml")
    for rig in (tmp_path / "camera.yaml", StereoRig.rectified(calibrated, 0.5)):
        recording = open_recording(video, rig=rig)
        assert recording.camera == SQUARE
        assert not any("doubt" in note for note in recording.notes)
        recording.close()
    recording = open_recording(
        video, video, rig=tmp_path / "pair.yaml", align="off", has_checks=False
    )
    assert recording.rig is not None
    assert (recording.rig.left, recording.rig.baseline_m) == (SQUARE, 0.5)
    recording.close()


def test_a_calibration_that_contradicts_the_pixel_aspect(video):
    camera = PinholeCamera(150.0, 150.0, 31.5, 23.5, 64, 48)
    recording = open_recording(video, rig=StereoRig.rectified(camera, 0.5))
    assert recording.camera == camera
    assert any("According to the video, they are 2 times" in note for note in recording.notes)
    recording.close()


def test_sizes_of_which_every_other_column_is_left_out(tmp_path):
    cv2.imwrite(str(tmp_path / "000000.png"), np.zeros((720, 640, 3), np.uint8))
    recording = open_recording(tmp_path, focal_px=900.0)
    assert (recording.camera.fx_px, recording.size_px) == (900.0, (1280, 720))
    recording.close()


@pytest.mark.parametrize(
    ("size_px", "sigma"),
    [((720, 480), 1 - math.sqrt(27 / 32)), ((960, 480), math.sqrt(3 / 2) - 1), ((640, 480), 0.0)],
)
def test_analogue_video_without_a_pixel_aspect(tmp_path, size_px, sigma):
    cv2.imwrite(str(tmp_path / "000000.png"), np.zeros((*size_px[::-1], 3), np.uint8))
    recording = open_recording(tmp_path, focal_px=900.0)
    assert recording.size_px == size_px
    assert any("-aspect 4:3" in note for note in recording.notes) == (sigma != 0)
    assert recording.calibration.focal_sigma == pytest.approx(sigma)
    recording.close()
