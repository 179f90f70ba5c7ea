"""The focal length from a field of view on a box, a camera model, or the usual field of view."""

import math
from pathlib import Path

import cv2
import numpy as np
import pytest

import track_range as tr
from track_range.errors import ConfigError, RigError, UsageError
from track_range.recording.cameras.known_lenses import KNOWN_CAMERAS, GivenLens, LensField
from track_range.stereo.geometry.focal_curve import log_focal_grid
from track_range.stereo.geometry.focal_guess import default_guess, focal_of_field
from track_range.stereo.rig_formats.rig_yaml import save_camera

WIDE_PX, PORTRAIT_PX = (1920, 1080), (1080, 1920)


def focal_per_width(name: str) -> float:
    return next(camera.focal_per_width for camera in KNOWN_CAMERAS if camera.name == name)


@pytest.mark.parametrize("text", ["60h", "60 H", "60°h", "60.0deg h"])
def test_a_field_of_view_without_distortion(text):
    guess = LensField.of(text).guess(WIDE_PX)
    assert guess.focal_px == pytest.approx(960 / math.tan(math.radians(30)))
    assert guess.sigma == pytest.approx(0.08)
    assert "horizontal field of view of 60 degrees" in guess.source


def test_sides_of_one_lens_agree():
    """Fields across the diagonal, width and height of a pinhole give one focal length."""
    for side, length_px in (("d", math.hypot(*WIDE_PX)), ("h", 1920), ("v", 1080)):
        field_deg = 2 * math.degrees(math.atan(length_px / 2 / 1500.0))
        guess = LensField.of(f"{field_deg:.4f}{side}").guess(WIDE_PX)
        assert guess.focal_px == pytest.approx(1500.0, rel=1e-4)


# Fields of view that the makers publish, of cameras that users calibrated.
@pytest.mark.parametrize(
    ("name", "field"),
    [
        ("GoPro HERO4 wide", "118.2h"),
        ("GoPro HERO4 wide", "133.6d"),
        ("GoPro HERO10 Black wide", "118h"),
        ("GoPro HERO10 Black linear", "92h"),
        ("DJI Action 3", "155d"),
        ("Xiaomi Yi 4K", "155d"),
        ("Xiaomi Mijia 4K", "145d"),
        ("SJCAM SJ4000", "170d"),
        ("SJCAM SJ8 Pro", "170d"),
        ("AKASO EK7000 Pro 170", "170d"),
        ("AKASO V50 Pro wide", "170d"),
    ],
)
def test_calibrated_cameras_are_within_two_sigmas_of_their_boxes(name, field):
    guess = LensField.of(field).guess(WIDE_PX)
    deviation = math.log(focal_per_width(name) * 1920 / guess.focal_px)
    assert abs(deviation) < 2 * guess.sigma
    assert guess.sigma < 0.25


@pytest.mark.parametrize("text", ["140", "", "d", "5d", "250d", "140x", "1e2d", "-60h", "nan d"])
def test_what_is_no_field_of_view(text):
    with pytest.raises(UsageError, match=r"--lens-fov-deg.*140d diagonal"):
        LensField.of(text)


def test_a_model_and_a_field_of_view_are_two_guesses():
    model, field = GivenLens("gopro hero4 wide", "118h").guesses(PORTRAIT_PX)
    assert model.focal_px == pytest.approx(820.2)  # of the longer side
    assert "field of view" in field.source
    assert not GivenLens()


def test_the_usual_focal_length_is_that_of_the_diagonal():
    """A camera that was turned has the focal length that it had before."""
    landscape, portrait = default_guess(WIDE_PX), default_guess(PORTRAIT_PX)
    assert landscape == portrait
    assert landscape.focal_px == pytest.approx(focal_of_field(75.0, 1920))
    assert np.array_equal(log_focal_grid(WIDE_PX, 9), log_focal_grid(PORTRAIT_PX, 9))


@pytest.fixture
def images(tmp_path: Path) -> Path:
    folder = tmp_path / "images"
    folder.mkdir()
    for index in range(2):
        cv2.imwrite(str(folder / f"{index:06}.png"), np.zeros((72, 128, 3), np.uint8))
    return folder


def test_a_recording_has_the_focal_length_of_its_stated_lens(images):
    recording = tr.open_recording(images, lens_fov_deg="60h")
    assert recording.camera.fx_px == pytest.approx(64 / math.tan(math.radians(30)))
    assert recording.calibration.focal_sigma == pytest.approx(0.08)
    recording.close()
    recording = tr.open_recording(images, camera_model="comma EON")
    assert recording.camera.fx_px == pytest.approx(910 / 1164 * 128)
    recording.close()


def test_a_calibration_and_a_lens_contradict_each_other(images, tmp_path):
    rig = tmp_path / "rig.yaml"
    save_camera(tr.PinholeCamera.of_focal_length(100.0, (128, 72)), rig)
    with pytest.raises(RigError, match=r"lens_fov_deg.*rig.yaml"):
        tr.open_recording(images, rig=rig, lens_fov_deg="60h")


def test_a_given_focal_length_that_the_lens_excludes_is_noted(images):
    recording = tr.open_recording(images, focal_px=300.0, lens_fov_deg="60h")
    assert any("--focal-px: 300 px was given, but the lens" in note for note in recording.notes)
    recording.close()


def test_a_pipeline_starts_with_the_stated_lens(images):
    image = cv2.imread(str(images / "000000.png"))
    with tr.Pipeline.mono(detector=NoBoxes(), lanes="off", lens_fov_deg="60h") as pipeline:
        focal = pipeline.step(image, 0.0).focal
        assert focal is not None
        assert (focal.focal_px, focal.sigma) == pytest.approx((110.9, 0.08), rel=2e-2)
        assert "60 degrees" in focal.source
    with pytest.raises(ConfigError, match="lens_fov_deg='140'"):
        tr.Pipeline.mono(lens_fov_deg=140)


class NoBoxes:
    def detect(self, image):
        return tr.Detections.empty()
