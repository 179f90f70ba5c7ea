"""Kalibr's camchain.yaml: one block per camera, each with the transform from the previous camera.

    cam0: {camera_model: pinhole, intrinsics: [fu, fv, pu, pv], distortion_model: radtan,
           distortion_coeffs: [k1, k2, r1, r2], resolution: [width, height]}
    cam1: {..., T_cn_cnm1: 4 x 4, transforms points from cam0's frame to cam1's, metres}

Kalibr's radtan coefficients are OpenCV's first four. (github.com/ethz-asl/kalibr, wiki: YAML formats.)
"""

from __future__ import annotations

import re
from typing import Any

import numpy as np
from pydantic import BaseModel

from track_range.foundation.arrays import FloatArray
from track_range.foundation.files.input_files import quoted
from track_range.foundation.files.structured_text import parse_yaml
from track_range.foundation.validation import Number, PositiveNumber, validated
from track_range.stereo.geometry.camera import PinholeCamera
from track_range.stereo.geometry.rig import RigError
from track_range.stereo.geometry.rig_checks import Calibration, ImageSide
from track_range.stereo.rig_formats.rig_format import RigFormat

_CAMERA = re.compile(r"^cam\d+\s*:", re.MULTILINE)
_HINT = "give Kalibr's camchain.yaml unchanged"

_Row = tuple[Number, Number, Number, Number]


class _CameraBlock(BaseModel):
    """Block of one camera; other keys are ignored."""

    camera_model: Any = None
    distortion_model: Any = None
    intrinsics: tuple[PositiveNumber, PositiveNumber, Number, Number]
    resolution: tuple[ImageSide, ImageSide]
    distortion_coeffs: _Row = (0.0, 0.0, 0.0, 0.0)
    T_cn_cnm1: tuple[_Row, _Row, _Row, _Row] | None = None


def _has_cameras(text: str) -> bool:
    """Whether a file has blocks cam0, cam1, ... at its top level."""
    return _CAMERA.search(text) is not None


def _read(text: str, source: object) -> Calibration:
    """The first two cameras of a chain, the left one first.

    Raises:
        RigError: the file is not YAML, a value is missing or wrong, or a camera model is not supported.
    """
    content = parse_yaml(text, source, RigError, "Kalibr's camchain.yaml")
    if not isinstance(content, dict) or not isinstance(content.get("cam0"), dict):
        raise RigError(f"{source}: expected a block cam0, found none; {_HINT}.")
    first, _ = _camera(content["cam0"], f"{source}: cam0")
    if not isinstance(content.get("cam1"), dict):
        return Calibration(first, None, None)
    notes = [f"{source}: using cam0 and cam1 of {len(content)} cameras."] if "cam2" in content else []
    second, second_from_first = _camera(content["cam1"], f"{source}: cam1")
    if second_from_first is None or not np.allclose(second_from_first[3], [0.0, 0.0, 0.0, 1.0]):
        raise RigError(
            f"{source}: cam1: expected 'T_cn_cnm1' with 0, 0, 0, 1 in the last row, found none or others; {_HINT}."
        )
    if second_from_first[0, 3] > abs(second_from_first[1, 3]):
        notes.append(f"{source}: cam1 is to the left of cam0, so cam1 is used as the left camera.")
        return Calibration(second, first, _inverse(second_from_first), notes=tuple(notes))
    return Calibration(first, second, second_from_first, notes=tuple(notes))


def _inverse(transform: FloatArray) -> FloatArray:
    """(4, 4) inverse of a rigid transform, which `rig_checks` verifies later."""
    inverse = np.eye(4)
    inverse[:3, :3] = transform[:3, :3].T
    inverse[:3, 3] = -transform[:3, :3].T @ transform[:3, 3]
    return inverse


def _camera(content: object, name: str) -> tuple[PinholeCamera, FloatArray | None]:
    """The camera of a block, and the (4, 4) transform from the previous camera's frame; None without one.

    Raises:
        RigError: a value is missing or wrong, or the camera model is not supported.
    """
    block = validated(_CameraBlock, content, name, RigError)
    if block.camera_model != "pinhole":
        raise RigError(
            f"{name}: expected the camera_model pinhole, found {quoted(block.camera_model)}; calibrate with "
            "pinhole-radtan."
        )
    if block.distortion_model not in ("radtan", "none", None):
        raise RigError(
            f"{name}: expected the distortion_model radtan or none, found {quoted(block.distortion_model)}; calibrate "
            "with pinhole-radtan, or undistort the videos first."
        )
    is_distorted = block.distortion_model == "radtan"
    if is_distorted and "distortion_coeffs" not in block.model_fields_set:
        raise RigError(f"{name}: expected the key 'distortion_coeffs', found none; {_HINT}.")
    camera = PinholeCamera(*block.intrinsics, *block.resolution, block.distortion_coeffs if is_distorted else ())
    return camera, None if block.T_cn_cnm1 is None else np.array(block.T_cn_cnm1)


KALIBR = RigFormat(
    name="kalibr",
    title="Kalibr's camchain.yaml",
    recognises=_has_cameras,
    read=lambda text, path, _is_grey: _read(text, path),
    missing=lambda _text, _path, _is_grey: "a block cam1",
)
