"""Recordings whose pixels are not square: what the file states, what is usual, and calibrations of
either size."""

import math
from fractions import Fraction
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import pytest

from tests.support.images.films import write_film
from tests.support.recordings.live_servers import Camera
from tests.track_range.recording.bag_writers import write_foxglove_video
from track_range.recording.cameras.camera_estimate import CameraEstimate, source_of_guess
from track_range.recording.recording import open_recording
from track_range.recording.telemetry.image_evidence import motion_of
from track_range.stereo.geometry.camera import PinholeCamera
from track_range.stereo.geometry.focal_guess import FocalGuess
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


ALMOST = Fraction(51, 50)  # pixels of 100x48 px images, of which 102x48 px would be square
TIMES_S = [0.0, 0.1, 0.2]


def images(width_px: int = 100) -> list[np.ndarray]:
    noise = np.random.default_rng(5).integers(60, 190, (48, width_px // 4, 3), np.uint8)
    return [np.repeat(noise, 4, axis=1)] * len(TIMES_S)


def a_file(folder: Path, aspect: Fraction) -> dict[str, Any]:
    return {"left": write_film(folder / "a.mp4", TIMES_S, images=images(), aspect=aspect)}


def a_pair(folder: Path, aspect: Fraction) -> dict[str, Any]:
    (path,) = a_file(folder, aspect).values()
    return {"left": path, "right": path}


def halves(folder: Path, aspect: Fraction) -> dict[str, Any]:
    path = write_film(folder / "both.mp4", TIMES_S, images=images(200), aspect=aspect)
    return {"left": path, "stereo_layout": "side-by-side"}


def segments(folder: Path, aspect: Fraction) -> dict[str, Any]:
    for name in ("20260101_120000.mp4", "20260101_120003.mp4"):
        write_film(folder / name, TIMES_S, images=images(), aspect=aspect)
    return {"left": folder}


def a_track(folder: Path, aspect: Fraction) -> dict[str, Any]:
    return {**a_file(folder, aspect), "track": 0}


def a_bag(folder: Path, aspect: Fraction) -> dict[str, Any]:
    stream = write_film(folder / "a.h264", TIMES_S, images=images(), aspect=aspect)
    return {"left": write_foxglove_video(folder / "a.mcap", stream)}


@pytest.mark.parametrize("recorded", [a_file, a_pair, halves, segments, a_track, a_bag])
@pytest.mark.parametrize("focal_px", [None, 150.0])
def test_almost_square_pixels_stay_as_they_are(tmp_path, recorded, focal_px):
    """A ray 1 m to the side at 10 m ends in the same direction, in pixels that are 2 % wider."""
    opened = []
    for aspect in (Fraction(1), ALMOST):
        folder = tmp_path / str(float(aspect))
        folder.mkdir()
        recording = open_recording(**recorded(folder, aspect), focal_px=focal_px)
        frame = next(recording.frames)
        assert recording.size_px == recording.videos[0].shown_size_px == (100, 48)
        assert frame.left.shape[:2] == (48, 100)
        assert frame.right is None or frame.right.shape[:2] == (48, 100)
        assert not any("resampled" in note for note in recording.notes)
        opened.append(recording)
        recording.close()
    square, almost = (recording.camera for recording in opened)
    assert almost.cx_px == square.cx_px == 49.5
    assert almost.fy_px / almost.fx_px == pytest.approx(1.02)
    if focal_px is not None:
        assert (square.fx_px, square.fy_px, almost.fy_px) == (150.0, 150.0, 150.0)
        u_px = [camera.project(np.array([[1.0, 0.0, 10.0]]))[0, 0] for camera in (square, almost)]
        assert u_px == pytest.approx([49.5 + 15.0, 49.5 + 15.0 / 1.02])


def test_an_estimated_focal_length_keeps_the_shape_of_the_pixels(tmp_path):
    recording = open_recording(**a_file(tmp_path, ALMOST))
    given = source_of_guess(FocalGuess(204.0, 0.001, "a test"), "given", (100, 48))
    calibration = recording.calibration.with_estimate(
        CameraEstimate(size_px=(100, 48), sources=(given,))
    )
    camera = calibration.camera
    assert camera.fy_px == pytest.approx(204.0, rel=0.002)
    assert camera == PinholeCamera(camera.fy_px / 1.02, camera.fy_px, 49.5, 23.5, 100, 48)
    recording.close()


@pytest.mark.parametrize("aspect", [Fraction(2), ALMOST])
def test_pixel_aspect_of_a_stream(aspect):
    camera = Camera(pixel_aspect=aspect)
    recording = open_recording(camera.url, focal_px=150.0)
    frame = next(recording.frames)
    recording.close()
    camera.close()
    assert recording.size_px == frame.left.shape[1::-1] == ((128, 48) if aspect == 2 else (64, 48))
    assert recording.camera.fy_px == 150.0


@pytest.mark.parametrize("aspect", [Fraction(2), ALMOST])
def test_motion_of_images_whose_pixels_are_not_square(tmp_path, aspect):
    """A turn of 0.02 rad in 0.1 s, in pixels that are twice as wide: half as many columns."""
    focal_px, width_px = 300.0, 320
    x_px = np.arange(400)
    scene = np.random.default_rng(3).integers(0, 255, (240, 400, 3), np.uint8)
    scene = cv2.GaussianBlur(scene, (0, 0), 3)
    step_px = 0.02 * focal_px / float(aspect)
    moved = [
        cv2.warpAffine(scene, np.array([[1.0, 0, -10 - number * step_px], [0, 1, 0]]), (320, 240))
        for number in range(8)
    ]
    assert x_px[-1] > width_px + 10 + 7 * step_px
    times_s = [number / 10 for number in range(8)]
    path = write_film(tmp_path / "turn.mp4", times_s, images=moved, aspect=aspect)
    recording = open_recording(path, focal_px=focal_px)
    recording.close()
    motion = motion_of(path, recording.camera, start_s=0.0)
    assert abs(float(np.median(motion.yaw_rad_s))) == pytest.approx(0.2, rel=0.05)
