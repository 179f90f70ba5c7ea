"""Kalibr's camchain.yaml: one block per camera, each with the transform from the previous camera.

    cam0: {camera_model: pinhole, intrinsics: [fu, fv, pu, pv], distortion_model: radtan,
           distortion_coeffs: [k1, k2, r1, r2], resolution: [width, height]}
    cam1: {..., T_cn_cnm1: 4 x 4, transforms points from cam0's frame to cam1's, metres}

The pairs of camera_model and distortion_model are those that the lenses in `LENSES` declare; the
intrinsics of a wide lens stand before fu. Kalibr's radtan coefficients are OpenCV's first four.

Files for other programs, such as OpenVINS's, begin with OpenCV's `%YAML:1.0` and have T_cam_imu
(camera from IMU) or its inverse T_imu_cam instead of T_cn_cnm1. (github.com/ethz-asl/kalibr, wiki:
Supported models, YAML formats.)
"""

import re
from collections.abc import Mapping
from typing import Any

import numpy as np
from pydantic import BaseModel

from track_range.foundation.arrays import FloatArray
from track_range.foundation.files.input_files import alternatives, quoted
from track_range.foundation.files.structured_text import parse_yaml
from track_range.foundation.schemas.validation import Number, validated
from track_range.stereo.geometry.camera import PinholeCamera
from track_range.stereo.geometry.rig import RigError, inverse_motion
from track_range.stereo.geometry.rig_checks import ImageSide, RigCalibration
from track_range.stereo.lenses.lens import KalibrModel
from track_range.stereo.lenses.registry import LENSES
from track_range.stereo.rig_formats.rig_format import format_by_pattern
from track_range.stereo.rig_formats.values.containers import yaml_of_opencv

# blocks at the top level, not blocks of scripts
_CAMERA = re.compile(r"^cam\d+\s*:(?!\s*\n\s+K\s*:)", re.MULTILINE)
_HINT = "give Kalibr's camchain.yaml unchanged"

_Row = tuple[Number, Number, Number, Number]
_Transform = tuple[_Row, _Row, _Row, _Row]


class _CameraBlock(BaseModel):
    """Block of one camera; other keys are ignored."""

    camera_model: Any = None
    distortion_model: Any = None
    intrinsics: list[Number]
    resolution: tuple[ImageSide, ImageSide]
    distortion_coeffs: list[Number] = []
    T_cn_cnm1: _Transform | None = None
    T_cam_imu: _Transform | None = None
    T_imu_cam: _Transform | None = None

    @property
    def camera_from_imu(self) -> FloatArray | None:
        """(4, 4) transform from the IMU's frame to the camera's; None = not in the file."""
        if self.T_cam_imu is not None:
            return np.array(self.T_cam_imu)
        return None if self.T_imu_cam is None else inverse_motion(np.array(self.T_imu_cam))


def _models() -> dict[tuple[str, str], tuple[KalibrModel, str]]:
    """The models by camera_model and distortion_model, and the names of their lenses."""
    models: dict[tuple[str, str], tuple[KalibrModel, str]] = {}
    for name, lens in LENSES.usable.items():
        for model in lens.kalibr:
            _, known = models.setdefault(model.names, (model, name))
            if known != name:  # registered at run time; those of other packages are left out
                raise RigError(
                    f"expected one lens for Kalibr's {' with '.join(model.names)}, found {known} "
                    f"and {name}; omit one of them."
                )
    return models


def _known_models() -> str:
    """The models, for messages: "pinhole with radtan or none, or ds with none"."""
    distortions: dict[str, list[str]] = {}
    for camera, distortion in _models():
        distortions.setdefault(camera, []).append(distortion)
    *first, last = (f"{camera} with {alternatives(d)}" for camera, d in distortions.items())
    return ", ".join([*first, f"or {last}"])


def _read(text: str, source: object) -> RigCalibration:
    """The first two cameras of a chain, the left camera first."""
    content = parse_yaml(yaml_of_opencv(text), source, RigError, "Kalibr's camchain.yaml")
    if not isinstance(content, dict) or not isinstance(content.get("cam0"), dict):
        raise RigError(f"{source}: expected a block cam0, found none; {_HINT}.")
    notes = (
        [f"{source}: using cam0 and cam1 of {len(content)} cameras."] if "cam2" in content else []
    )
    return calibration_of_blocks(content, source, notes)


def calibration_of_blocks(
    content: Mapping[str, Any], source: object, notes: list[str]
) -> RigCalibration:
    """The camera of the block "cam0", and of "cam1" if there is one; the left camera first."""
    first, first_block = _camera(content["cam0"], f"{source}: cam0")
    if not isinstance(content.get("cam1"), dict):
        return RigCalibration(first, None, None, notes=tuple(notes))
    second, second_block = _camera(content["cam1"], f"{source}: cam1")
    second_from_first = _second_from_first(first_block, second_block)
    if second_from_first is None or not np.allclose(second_from_first[3], [0.0, 0.0, 0.0, 1.0]):
        raise RigError(
            f"{source}: cam1: expected 'T_cn_cnm1' with 0, 0, 0, 1 in the last row, found no such "
            f"matrix; {_HINT}."
        )
    if second_from_first[0, 3] > abs(second_from_first[1, 3]):
        notes.append(f"{source}: cam1 is to the left of cam0, so cam1 is used as the left camera.")
        return RigCalibration(second, first, inverse_motion(second_from_first), notes=tuple(notes))
    return RigCalibration(first, second, second_from_first, notes=tuple(notes))


def _second_from_first(first: _CameraBlock, second: _CameraBlock) -> FloatArray | None:
    """(4, 4) transform from the first camera's frame to the second's, if needed by way of the IMU;
    None = unknown.
    """
    if second.T_cn_cnm1 is not None:
        return np.array(second.T_cn_cnm1)
    if first.camera_from_imu is None or second.camera_from_imu is None:
        return None
    return np.asarray(second.camera_from_imu @ inverse_motion(first.camera_from_imu))


def _camera(content: object, name: str) -> tuple[PinholeCamera, _CameraBlock]:
    block = validated(_CameraBlock, content, name, RigError)
    distortion = block.distortion_model or "none"
    names = (str(block.camera_model), str(distortion))
    if names not in (models := _models()):
        raise RigError(
            f"{name}: expected the camera_model and distortion_model {_known_models()}, found "
            f"{quoted(block.camera_model)} with {quoted(distortion)}; calibrate with "
            "one of these."
        )
    model, lens = models[names]
    if len(block.intrinsics) != model.n_intrinsics + 4:
        raise RigError(
            f"{name}: expected {model.n_intrinsics + 4} intrinsics of {model.camera}, found "
            f"{len(block.intrinsics)}; {_HINT}."
        )
    of_lens = block.intrinsics[: model.n_intrinsics]
    matrix = block.intrinsics[model.n_intrinsics :]
    if not min(matrix[:2]) > 0:
        raise RigError(
            f"{name}: expected positive focal lengths in intrinsics, found "
            f"{quoted(matrix[:2])}; {_HINT}."
        )
    coefficients = block.distortion_coeffs
    n_coefficients = model.n_distortion
    if n_coefficients is None:
        n_coefficients = len(LENSES.named(lens).coefficients) - model.n_intrinsics
    if model.distortion == "none":
        coefficients = [0.0] * n_coefficients
    elif len(coefficients) != n_coefficients:
        raise RigError(
            f"{name}: expected {n_coefficients} numbers in 'distortion_coeffs', found "
            f"{len(coefficients)}; {_HINT}."
        )
    fu, fv, pu, pv = matrix
    return PinholeCamera(fu, fv, pu, pv, *block.resolution, (*of_lens, *coefficients), lens), block


KALIBR = format_by_pattern(
    "kalibr",
    "Kalibr's camchain.yaml",
    _CAMERA,
    _read,
    "a block cam1",
    priority=-10,  # other files have cameras of such names
)
