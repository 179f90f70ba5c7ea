"""Kalibr's camchain.yaml: one block per camera, each with the transform from the previous camera.

    cam0: {camera_model: pinhole, intrinsics: [fu, fv, pu, pv], distortion_model: radtan,
           distortion_coeffs: [k1, k2, r1, r2], resolution: [width, height]}
    cam1: {..., T_cn_cnm1: 4 x 4, transforms points from cam0's frame to cam1's, metres}

Kalibr's radtan coefficients are OpenCV's first four. (github.com/ethz-asl/kalibr, wiki: YAML formats.)
"""

from __future__ import annotations

import re
from collections.abc import Mapping
from typing import Any

import numpy as np
import yaml

from track_range.foundation.arrays import FloatArray
from track_range.stereo.geometry.camera import PinholeCamera
from track_range.stereo.geometry.rig import RigError
from track_range.stereo.geometry.rig_checks import Calibration
from track_range.stereo.rig_formats.rig_format import RigFormat

_CAMERA = re.compile(r"^cam\d+\s*:", re.MULTILINE)
_HINT = "give Kalibr's camchain.yaml unchanged"


def _has_cameras(text: str) -> bool:
    """Whether a file has blocks cam0, cam1, ... at its top level."""
    return _CAMERA.search(text) is not None


def _read(text: str, source: object) -> Calibration:
    """The first two cameras of a chain, the left one first.

    Raises:
        RigError: the file is not YAML, a value is missing or wrong, or a camera model is not supported.
    """
    try:
        content = yaml.safe_load(text)
    except yaml.YAMLError as error:
        raise RigError(f"{source}: expected YAML, found a syntax error; {_HINT}.") from error
    if not isinstance(content, dict) or not isinstance(content.get("cam0"), dict):
        raise RigError(f"{source}: expected a block cam0, found none; {_HINT}.")
    first = _camera(content["cam0"], f"{source}: cam0")
    second = content.get("cam1")
    if not isinstance(second, dict):
        return Calibration(first, None, None)
    notes = [f"{source}: using cam0 and cam1 of {len(content)} cameras."] if "cam2" in content else []
    second_from_first = _numbers(second, "T_cn_cnm1", (4, 4), f"{source}: cam1")
    if not np.allclose(second_from_first[3], [0.0, 0.0, 0.0, 1.0]):
        raise RigError(
            f"{source}: cam1: expected 0, 0, 0, 1 in the last row of 'T_cn_cnm1', found other numbers; {_HINT}."
        )
    second_camera = _camera(second, f"{source}: cam1")
    if second_from_first[0, 3] > abs(second_from_first[1, 3]):
        notes.append(f"{source}: cam1 is to the left of cam0, so cam1 is used as the left camera.")
        return Calibration(second_camera, first, _inverse(second_from_first), notes=tuple(notes))
    return Calibration(first, second_camera, second_from_first, notes=tuple(notes))


def _inverse(transform: FloatArray) -> FloatArray:
    """(4, 4) inverse of a rigid transform, which `rig_checks` verifies later."""
    inverse = np.eye(4)
    inverse[:3, :3] = transform[:3, :3].T
    inverse[:3, 3] = -transform[:3, :3].T @ transform[:3, 3]
    return inverse


def _camera(block: Mapping[str, Any], name: str) -> PinholeCamera:
    model, distortion_model = block.get("camera_model"), block.get("distortion_model", "none")
    if model != "pinhole":
        raise RigError(f"{name}: expected the camera model pinhole, found '{model}'; calibrate with pinhole-radtan.")
    if distortion_model not in ("radtan", "none", None):
        raise RigError(
            f"{name}: expected the distortion model radtan or none, found '{distortion_model}'; calibrate with "
            "pinhole-radtan, or undistort the videos first."
        )
    fx, fy, cx, cy = _numbers(block, "intrinsics", (4,), name).tolist()
    width, height = (round(side) for side in _numbers(block, "resolution", (2,), name).tolist())
    if min(width, height) < 1:
        raise RigError(f"{name}: expected a resolution [width, height] in pixels, found {width}x{height}; {_HINT}.")
    distortion = _numbers(block, "distortion_coeffs", (4,), name).tolist() if distortion_model == "radtan" else []
    return PinholeCamera(fx, fy, cx, cy, width, height, tuple(distortion))


def _numbers(block: Mapping[str, Any], key: str, shape: tuple[int, ...], name: str) -> FloatArray:
    if key not in block:
        raise RigError(f"{name}: expected the key '{key}', found none; {_HINT}.")
    try:
        values = np.array(block[key], np.float64)
    except (TypeError, ValueError) as error:
        raise RigError(f"{name}: expected numbers in '{key}', found {block[key]!r}; {_HINT}.") from error
    if values.shape != shape or not np.isfinite(values).all():
        expected = " x ".join(str(side) for side in shape)
        raise RigError(f"{name}: expected {expected} finite numbers in '{key}', found {block[key]!r}; {_HINT}.")
    return values


KALIBR = RigFormat(
    name="kalibr",
    title="Kalibr's camchain.yaml",
    recognises=_has_cameras,
    read=lambda text, path, _is_grey: _read(text, path),
    missing=lambda _text, _path, _is_grey: "a block cam1",
)
