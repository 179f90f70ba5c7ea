"""Kalibr's camchain.yaml: one block per camera, each with the motion from the one before.

    cam0: {camera_model: pinhole, intrinsics: [fu, fv, pu, pv], distortion_model: radtan,
           distortion_coeffs: [k1, k2, r1, r2], resolution: [width, height]}
    cam1: {..., T_cn_cnm1: 4 x 4, takes points of cam0's frame into cam1's, metres}

Kalibr's radtan terms are OpenCV's first four. (github.com/ethz-asl/kalibr, wiki: YAML formats.)
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


def _has_cameras(text: str) -> bool:
    """Whether a file has blocks cam0, cam1, ... at its top level."""
    return _CAMERA.search(text) is not None


def _read(text: str, source: object) -> Calibration:
    """The first two cameras of a chain, the one that stands left first.

    Raises:
        RigError: not readable as YAML, a value is missing or wrong, or a camera model that is not ours.
    """
    try:
        content = yaml.safe_load(text)
    except yaml.YAMLError as error:
        raise RigError(
            f"{source}: it is not readable as YAML; give Kalibr's camchain.yaml as it was written."
        ) from error
    if not isinstance(content, dict) or not isinstance(content.get("cam0"), dict):
        raise RigError(f"{source}: it has no block cam0; give Kalibr's whole camchain.yaml.")
    first = _camera(content["cam0"], f"{source}: cam0")
    second = content.get("cam1")
    if not isinstance(second, dict):
        return Calibration(first, None, None)
    notes = [f"{source}: cam0 and cam1 used, of {len(content)} cameras."] if "cam2" in content else []
    second_from_first = _numbers(second, "T_cn_cnm1", (4, 4), f"{source}: cam1")
    if not np.allclose(second_from_first[3], [0.0, 0.0, 0.0, 1.0]):
        raise RigError(
            f"{source}: cam1: the last row of 'T_cn_cnm1' must be 0, 0, 0, 1; give camchain.yaml as written."
        )
    other = _camera(second, f"{source}: cam1")
    if second_from_first[0, 3] > abs(second_from_first[1, 3]):
        notes.append(f"{source}: cam1 stands left of cam0, so cam1 is taken as the left camera.")
        return Calibration(other, first, _inverse(second_from_first), notes=tuple(notes))
    return Calibration(first, other, second_from_first, notes=tuple(notes))


def _inverse(motion: FloatArray) -> FloatArray:
    """(4, 4) of a rigid motion; whether it is one is for `rig_checks` to say."""
    back = np.eye(4)
    back[:3, :3] = motion[:3, :3].T
    back[:3, 3] = -motion[:3, :3].T @ motion[:3, 3]
    return back


def _camera(block: Mapping[str, Any], name: str) -> PinholeCamera:
    model, lens_model = block.get("camera_model"), block.get("distortion_model", "none")
    if model != "pinhole":
        raise RigError(
            f"{name}: the camera model is '{model}', only pinhole can be used; calibrate with pinhole-radtan."
        )
    if lens_model not in ("radtan", "none", None):
        raise RigError(
            f"{name}: the distortion model is '{lens_model}', only radtan can be used (or none); "
            "calibrate with pinhole-radtan, or undistort the videos first."
        )
    fx, fy, cx, cy = _numbers(block, "intrinsics", (4,), name).tolist()
    width, height = (round(side) for side in _numbers(block, "resolution", (2,), name).tolist())
    if min(width, height) < 1:
        raise RigError(f"{name}: the resolution is {width}x{height}; give it as [width, height] in pixels.")
    lens = _numbers(block, "distortion_coeffs", (4,), name).tolist() if lens_model == "radtan" else []
    return PinholeCamera(fx, fy, cx, cy, width, height, tuple(lens))


def _numbers(block: Mapping[str, Any], key: str, shape: tuple[int, ...], name: str) -> FloatArray:
    if key not in block:
        raise RigError(f"{name}: the key '{key}' is missing; give Kalibr's camchain.yaml as it was written.")
    try:
        values = np.array(block[key], np.float64)
    except (TypeError, ValueError) as error:
        raise RigError(f"{name}: '{key}' is not made of numbers; give Kalibr's camchain.yaml as written.") from error
    if values.shape != shape or not np.isfinite(values).all():
        wanted = " x ".join(str(side) for side in shape)
        raise RigError(f"{name}: '{key}' must be {wanted} finite numbers; give Kalibr's camchain.yaml as written.")
    return values


KALIBR = RigFormat(
    name="kalibr",
    title="Kalibr's camchain.yaml",
    recognises=_has_cameras,
    read=lambda text, path, _is_grey: _read(text, path),
    missing=lambda _text, _path, _is_grey: "it lacks cam1",
)
