"""Cameras with poses in the frame of a body: EuRoC's and Kimera's sensor files, and the settings of
VINS.

    T_BS, body_T_cam0        x_body = T x_camera;  right_from_left = T1^-1 T0
    EuRoC   mav0/cam0/sensor.yaml and mav0/cam1/sensor.yaml, Kimera LeftCameraParams.yaml and RightCameraParams.yaml
    VINS    settings with cam0_calib, cam1_calib, the files of camodocal: PINHOLE, MEI (unified), KANNALA_BRANDT

The cameras are read as blocks of Kalibr. (projects.asl.ethz.ch, kmavvisualinertialdatasets;
VINS-Fusion, config/.)
"""

import contextlib
import re
from functools import partial
from pathlib import Path
from typing import Any

from track_range.foundation.files.input_files import quoted, read_text
from track_range.foundation.files.structured_text import parse_yaml
from track_range.stereo.geometry.rig import RigError
from track_range.stereo.geometry.rig_checks import RigCalibration
from track_range.stereo.rig_formats.kalibr import calibration_of_blocks
from track_range.stereo.rig_formats.rig_format import format_by_pattern
from track_range.stereo.rig_formats.values.containers import yaml_of_opencv
from track_range.stereo.rig_formats.values.partners import files_of, is_second, partner_of

_EUROC_TITLE, _VINS_TITLE = "EuRoC's sensor.yaml", "VINS's settings and camera files"
# of camodocal: Kalibr's names, groups of the intrinsics and coefficients with their keys
_MODELS = {
    "PINHOLE": ("pinhole", "radtan", ("fx", "fy", "cx", "cy"), ("k1", "k2", "p1", "p2")),
    "MEI": ("omni", "radtan", ("xi", "gamma1", "gamma2", "u0", "v0"), ("k1", "k2", "p1", "p2")),
    "KANNALA_BRANDT": (
        "pinhole",
        "equidistant",
        ("mu", "mv", "u0", "v0"),
        ("k2", "k3", "k4", "k5"),
    ),
}
_MAX_NAME = 200  # characters of the name of a file


def _content(path: Path, text: str | None = None) -> dict[str, Any]:
    text = read_text(path, RigError, "the calibration of a camera") if text is None else text
    content = parse_yaml(yaml_of_opencv(text), path, RigError, "the calibration of a camera")
    if not isinstance(content, dict):
        raise RigError(
            f"{path}: expected the calibration of a camera, found {quoted(content)}; give the "
            "complete file."
        )
    return content


def _read_euroc(text: str, path: Path, *, is_pair: bool) -> RigCalibration:
    """The camera of a sensor file; if `is_pair`, with the other camera, whose file or folder is
    beside this file.
    """
    partner = partner_of(path) if is_pair else None
    own = _euroc_block(_content(path, text))
    if partner is None:
        return calibration_of_blocks(
            {"cam0": own}, path, [f"{path}: {_EUROC_TITLE} of one camera."]
        )
    other = _euroc_block(_content(partner))
    first, second = (other, own) if is_second(path) else (own, other)
    note = f"{path}: {_EUROC_TITLE}, with {partner.parent.name}/{partner.name}; lengths in metres."
    return calibration_of_blocks({"cam0": first, "cam1": second}, path, [note])


def _euroc_block(content: dict[str, Any]) -> dict[str, Any]:
    distortion = content.get("distortion_model")
    coefficients = content.get("distortion_coefficients", [])
    if isinstance(coefficients, list) and coefficients[4:] == [0]:  # k3 = 0
        coefficients = coefficients[:4]
    return {
        **content,
        "distortion_model": "radtan" if distortion == "radial-tangential" else distortion,
        "distortion_coeffs": coefficients,
        "T_imu_cam": _rows(content.get("T_BS")),
    }


def _rows(value: Any) -> Any:
    """The rows of a 4 x 4 matrix in {rows, cols, data}; other values as they are."""
    data = value.get("data") if isinstance(value, dict) else None
    if not isinstance(data, list) or len(data) != 16:
        return value
    return [data[i : i + 4] for i in range(0, 16, 4)]


def _read_vins(text: str, path: Path, *, is_pair: bool) -> RigCalibration:
    """The cameras of VINS's settings, or of one camera's file, as a pair if settings beside it name
    this file.
    """
    content = _content(path, text)
    settings = _settings_of(path) if is_pair and "model_type" in content else None
    if "model_type" in content and settings is None:
        note = f"{path}: {_VINS_TITLE}, one camera."
        return calibration_of_blocks({"cam0": _vins_block(content, path)}, path, [note])
    files: tuple[Path, ...] = ()
    if settings is not None:
        files = _files_of_pair(path, settings[1])
        path, content = settings
    blocks = {}
    for number in (0, 1) if "cam1_calib" in content else (0,):
        named = _camera_file(path, content, number)
        file = files[number] if files else named
        pose = {"T_imu_cam": _rows(content.get(f"body_T_cam{number}"))}
        blocks[f"cam{number}"] = _vins_block(_content(file), file) | pose
    note = f"{path}: {_VINS_TITLE}; lengths in metres."
    if content.get("estimate_extrinsic") in (1, 2):
        note = (
            f"{note[:-1]}; estimate_extrinsic is not 0, so body_T_cam may be only a rough initial "
            "guess."
        )
    return calibration_of_blocks(blocks, path, [note])


def _files_of_pair(path: Path, settings: dict[str, Any]) -> tuple[Path, ...]:
    """The files of both cameras beside settings that name files of another model; () = those of the
    settings.
    """
    partner = partner_of(path)
    if path.name in settings.values() or partner is None:
        return ()
    return (partner, path) if is_second(path) else (path, partner)


def _camera_file(path: Path, settings: dict[str, Any], number: int) -> Path:
    """The file of a camera that settings with this path name."""
    name = settings.get(f"cam{number}_calib")
    if not isinstance(name, str) or not 0 < len(name) < _MAX_NAME or not name.isprintable():
        raise RigError(
            f"{path}: expected the name of the camera's file in cam{number}_calib, found "
            f"{quoted(name)}; give the settings with the camera files beside them."
        )
    return path.parent / name


def _settings_of(path: Path) -> tuple[Path, dict[str, Any]] | None:
    """(path, content) of a pair's settings in a camera file's folder; None unless they name it or
    it has a partner.
    """
    for file in files_of(path.absolute().parent):
        with contextlib.suppress(RigError):  # of files of other kinds
            text = ""
            if file.suffix in (".yaml", ".yml"):
                text = read_text(file, RigError, "settings of VINS")
            if re.search(r"^cam1_calib\s*:", text, re.MULTILINE) and (
                path.name in text or partner_of(path)
            ):
                return path.with_name(file.name), _content(file, text)
    return None


def _vins_block(content: dict[str, Any], path: Path) -> dict[str, Any]:
    """A camera's file of camodocal as a block of Kalibr."""
    model = str(content.get("model_type")).upper()
    if model not in _MODELS:
        raise RigError(
            f"{path}: expected the model_type PINHOLE, MEI or KANNALA_BRANDT, found "
            f"{quoted(model)}; calibrate with one of these."
        )
    camera, distortion, intrinsics, coefficients = _MODELS[model]
    numbers: dict[str, Any] = {}
    for group in ("mirror_parameters", "distortion_parameters", "projection_parameters"):
        numbers |= content[group] if isinstance(content.get(group), dict) else {}
    missing = [key for key in (*intrinsics, *coefficients) if key not in numbers]
    if missing:
        raise RigError(
            f"{path}: expected {', '.join(missing)} of the model {model}, found none; give the "
            "complete file."
        )
    return {
        "camera_model": camera,
        "distortion_model": distortion,
        "intrinsics": [numbers[key] for key in intrinsics],
        "distortion_coeffs": [numbers[key] for key in coefficients],
        "resolution": [content.get("image_width"), content.get("image_height")],
    }


EUROC = format_by_pattern(
    "euroc",
    _EUROC_TITLE,
    re.compile(r"^T_BS\s*:", re.MULTILINE),
    partial(_read_euroc, is_pair=False),
    "the file of the other camera beside it, cam0/sensor.yaml and cam1/sensor.yaml, or "
    "LeftCameraParams.yaml and RightCameraParams.yaml",
    partial(_read_euroc, is_pair=True),
)
VINS = format_by_pattern(
    "vins",
    _VINS_TITLE,
    re.compile(r"^(?:model_type|cam0_calib|body_T_cam0)\s*:", re.MULTILINE),
    partial(_read_vins, is_pair=False),
    "settings of VINS with cam0_calib, cam1_calib and body_T_cam0, body_T_cam1",
    partial(_read_vins, is_pair=True),
)
