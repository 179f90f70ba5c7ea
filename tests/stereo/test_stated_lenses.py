"""The lens model is the one that a file states, by any name of it; models without a lens are refused by
their names."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import pytest

from tests.support.error_messages import error_message
from track_range.stereo.geometry.camera import PinholeCamera
from track_range.stereo.geometry.rig import RigError
from track_range.stereo.lenses.registry import LENSES
from track_range.stereo.rig_formats.reading import load_camera
from track_range.stereo.rig_formats.values.lens_models import kalibr_names

SIZE = (1280, 720)
K = [[700.0, 0.0, 640.0], [0.0, 701.0, 360.0], [0.0, 0.0, 1.0]]
FOUR = [0.05, -0.02, 0.01, -0.004]
KEYS = (
    *("model", "camera_model", "distortion_model", "lens_model", "projection", "distortion_type"),
    *("camera_type", "lens", "lens_type", "type", "projection_type", "cam_model", "dist_model"),
)


def written(folder: Path, content: dict[str, Any]) -> Path:
    path = folder / "calib.json"
    path.write_text(json.dumps(content))
    return path


def stating(folder: Path, **statement: Any) -> Path:
    """A camera with four coefficients and a statement on its lens."""
    content = {"camera_matrix": K, "dist_coeffs": FOUR, "image_size": [1280, 720]}
    return written(folder, content | statement)


def camera(path: Path) -> PinholeCamera:
    return load_camera(path, size_px=SIZE)[0]


@pytest.mark.parametrize("key", KEYS)
@pytest.mark.parametrize(
    ("name", "lens"),
    [
        *((name, "kannala-brandt") for name in ("equidistant", "kb4", "OPENCV_FISHEYE", "equi")),
        *((name, "kannala-brandt") for name in ("kannala_brandt4", "Kannala Brandt", "fisheye")),
        *((name, "pinhole") for name in ("pinhole-radtan", "brown", "plumb_bob", "Brown Conrady")),
        *((name, "pinhole") for name in ("rational_polynomial", "radial-tangential", "opencv")),
    ],
)
def test_names_of_models(tmp_path: Path, key: str, name: str, lens: str) -> None:
    found = camera(stating(tmp_path, **{key: name}))
    assert (found.lens, list(found.distortion)) == (lens, FOUR)


@pytest.mark.parametrize(
    ("flag", "lens"),
    [
        ({"fisheye": True}, "kannala-brandt"),
        ({"fisheye": "yes"}, "kannala-brandt"),
        ({"is_fisheye": 1}, "kannala-brandt"),
        ({"fisheye_model": 1}, "kannala-brandt"),
        ({"fisheye": False}, "pinhole"),
        ({"camera": {"type": "pinhole"}, "distortion_model": "equidistant"}, "kannala-brandt"),
    ],
)
def test_flags(tmp_path: Path, flag: dict[str, Any], lens: str) -> None:
    assert camera(stating(tmp_path, **flag)).lens == lens


def test_block_with_the_name_of_a_model(tmp_path: Path) -> None:
    block = {"fisheye": {"K": K, "D": FOUR}, "width": 1280, "height": 720}
    assert camera(written(tmp_path, block)).lens == "kannala-brandt"


@pytest.mark.parametrize(
    ("statement", "words"),
    [
        ({"distortion_model": "fov"}, "field-of-view model 'fov' in distortion_model"),
        ({"camera_model": "eucm"}, "extended unified model 'eucm'"),
        ({"model": "EQUIRECTANGULAR"}, "panorama"),
        ({"distortion_type": "cubic"}, "'cubic' in distortion_type"),
        ({"projection": "equisolid_fisheye"}, "'equisolid_fisheye' in projection"),
        ({"fisheye": True, "distortion_model": "plumb_bob"}, "'fisheye' 'plumb_bob' correct"),
        ({"camera_model": "omni"}, "5 coefficients (xi k1 k2 p1 p2) dist_coeffs, found 4"),
    ],
)
def test_refused(tmp_path: Path, statement: dict[str, Any], words: str) -> None:
    message = error_message(RigError, load_camera, stating(tmp_path, **statement), size_px=SIZE)
    assert all(word in message for word in words.split()), message


def test_other_texts_state_no_model(tmp_path: Path) -> None:
    path = stating(tmp_path, camera_model="HERO7 Black", lens_model="Wide", type="calibration")
    assert camera(path).lens == "pinhole"


@pytest.mark.parametrize(
    ("profile", "lens"),
    [
        ({}, "kannala-brandt"),
        ({"distortion_model": None, "lens_model": "Wide"}, "kannala-brandt"),
        ({"distortion_model": "opencv_fisheye"}, "kannala-brandt"),
        ({"distortion_model": "opencv_standard"}, "pinhole"),
        ({"distortion_model": "poly5"}, "'poly5'"),
        ({"digital_lens": "gopro_superview"}, "'gopro_superview'"),
    ],
)
def test_gyroflow(tmp_path: Path, profile: dict[str, Any], lens: str) -> None:
    params = {"RMS_error": 0.4, "camera_matrix": K, "distortion_coeffs": FOUR}
    size = {"calib_dimension": {"w": 1280, "h": 720}, "orig_dimension": {"w": 3840, "h": 2160}}
    path = written(tmp_path, {**size, "fisheye_params": params, **profile})
    if lens.startswith("'"):
        assert lens in error_message(RigError, load_camera, path, size_px=SIZE)
    else:
        assert (camera(path).lens, camera(path).fx_px) == (lens, 700)


def test_four_coefficients_without_a_model(tmp_path: Path) -> None:
    """A wide image with four coefficients: a guess, which is a note whatever the matrix is called."""
    for key in ("K", "camera_matrix"):
        content = {key: K, "dist_coeffs": FOUR, "image_size": [1280, 720]}
        _, notes = load_camera(written(tmp_path, content), size_px=SIZE)
        assert any("fisheye_model" in note for note in notes)


def test_models_of_librealsense_in_python(tmp_path: Path) -> None:
    camera_values = {
        "width": 1280,
        "height": 720,
        "fx": 700.0,
        "fy": 701.0,
        "ppx": 640.0,
        "ppy": 360.0,
    }
    for name, lens in (("kannala_brandt4", "kannala-brandt"), ("brown_conrady", "pinhole")):
        content = camera_values | {"model": f"distortion.{name}", "coeffs": [*FOUR, 0.0]}
        assert camera(written(tmp_path, content)).lens == lens
    content = camera_values | {"model": "distortion.ftheta", "coeffs": [*FOUR, 0.0]}
    message = error_message(RigError, load_camera, written(tmp_path, content), size_px=SIZE)
    assert "f-theta" in message


def test_fisheye_by_the_names_of_coefficients_is_a_note(tmp_path: Path) -> None:
    names = {f"k{number}": value for number, value in enumerate(FOUR, 1)}
    content = {"camera_matrix": K, "image_size": [1280, 720], **names}
    found, notes = load_camera(written(tmp_path, content), size_px=SIZE)
    assert found.lens == "kannala-brandt"
    assert any("fisheye_model: 0" in note for note in notes)
    _, notes = load_camera(written(tmp_path, content | {"model": "fisheye"}), size_px=SIZE)
    assert notes == ()


def test_three_coefficients_are_a_question(tmp_path: Path) -> None:
    path = written(tmp_path, {"camera_matrix": K, "dist_coeffs": FOUR[:3]})
    message = error_message(RigError, load_camera, path, size_px=SIZE)
    assert "k1 k2 k3 or k1 k2 p1" in message


@pytest.mark.parametrize(
    ("content", "is_advised"),
    [
        ({}, True),
        ({"lens_distortion": {"a": [0.1, 0.2, 0.3]}}, False),
        ({"dist": [0.1, 0.2, 0.3, 0.4, 0.5, 0.6, 0.7]}, False),
    ],
)
def test_zeros_are_advised_only_without_a_distortion(
    tmp_path: Path, content: dict[str, Any], is_advised: bool
) -> None:
    path = written(tmp_path, {"camera_matrix": K, "width": 1280, "height": 720, **content})
    message = error_message(RigError, load_camera, path, size_px=SIZE)
    assert ("write zeros" in message) == is_advised
    assert all(key in message for key in content)


def test_every_lens_has_a_name() -> None:
    for lens in LENSES.usable.values():
        for model in lens.kalibr:
            assert kalibr_names(model.camera) is not None
            assert kalibr_names(model.distortion) is not None


@pytest.mark.parametrize("key", ["model", "lens_type", "distortion_model"])
def test_a_number_for_a_lens_model_is_refused(tmp_path: Path, key: str) -> None:
    path = written(tmp_path, {"K": K, "width": 1280, "height": 720, "D": [*FOUR, 0.0], key: 5})
    with pytest.raises(RigError, match=f"'5' in {key}; write the name of one"):
        load_camera(path, size_px=SIZE)
