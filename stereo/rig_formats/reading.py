"""Rig files: our own rig.yaml, KITTI's calib.txt, OpenCV's calibration samples' files, Kalibr's camchain -> cameras.

Ours, with the unit in every key (a mono file has `left` only; distortion is OpenCV's k1, k2, p1, p2, k3, ...):

    track_range_rig: 1
    left: {fx_px: 721.5, fy_px: 721.5, cx_px: 609.6, cy_px: 172.9, width_px: 1242, height_px: 375, distortion: []}
    right: {...}
    right_from_left: {rotation: [[1, 0, 0], [0, 1, 0], [0, 0, 1]], translation_m: [-0.54, 0, 0]}
"""

from __future__ import annotations

from pathlib import Path
from typing import Annotated, Literal

import numpy as np
import yaml
from pydantic import BaseModel, ConfigDict, Field, ValidationError

from track_range.foundation.arrays import FloatArray
from track_range.stereo.geometry.camera import PinholeCamera
from track_range.stereo.geometry.rig import RigError, StereoRig
from track_range.stereo.geometry.rig_checks import Calibration, check_camera, check_rig, fitted_to_size
from track_range.stereo.rig_formats.kalibr import looks_like_kalibr, parse_kalibr
from track_range.stereo.rig_formats.kitti import looks_like_kitti, missing_eye, parse_kitti
from track_range.stereo.rig_formats.opencv import looks_like_opencv, parse_opencv
from track_range.stereo.rig_formats.writing import VERSION, save_rig

__all__ = ["find_rig", "left_from_reference_m", "load_calibration", "load_camera", "load_rig", "save_rig"]


_MAX_BYTES = 1_000_000
"""No calibration is as large; a video given by mistake is, and is not read."""

_FORMATS = "our rig.yaml, KITTI's calib.txt, the files of OpenCV's stereo_calib or Kalibr's camchain.yaml"

_Finite = Annotated[float, Field(allow_inf_nan=False)]
_Positive = Annotated[float, Field(allow_inf_nan=False, gt=0)]
_Row = Annotated[list[_Finite], Field(min_length=3, max_length=3)]
_Strict = ConfigDict(extra="forbid", frozen=True)


class _CameraFile(BaseModel):
    model_config = _Strict
    fx_px: _Positive
    fy_px: _Positive
    cx_px: _Finite
    cy_px: _Finite
    width_px: Annotated[int, Field(gt=0)]
    height_px: Annotated[int, Field(gt=0)]
    distortion: list[_Finite] = []

    def camera(self) -> PinholeCamera:
        size = (self.width_px, self.height_px)
        return PinholeCamera(self.fx_px, self.fy_px, self.cx_px, self.cy_px, *size, tuple(self.distortion))


class _MotionFile(BaseModel):
    model_config = _Strict
    rotation: Annotated[list[_Row], Field(min_length=3, max_length=3)]
    translation_m: _Row

    def matrix(self) -> FloatArray:
        motion = np.eye(4)
        motion[:3, :3], motion[:3, 3] = self.rotation, self.translation_m
        return motion


class _RigFile(BaseModel):
    model_config = _Strict
    track_range_rig: Literal[1]
    left: _CameraFile
    right: _CameraFile | None = None
    right_from_left: _MotionFile | None = None


def load_rig(path: Path, *, size_px: tuple[int, int], is_grey: bool = False) -> tuple[StereoRig, tuple[str, ...]]:
    """The rig of a file, for images of `size_px` = (width, height), and notes to tell the user.

    Args:
        path: a file in any of the four formats.
        size_px: (width, height) of the images.
        is_grey: take the grey pair of a KITTI file that also has the colour one.

    Raises:
        RigError: the file cannot be read, is no rig, holds one camera only, is implausible or for other images.
    """
    text = _text_of(path)
    found = _parsed(text, path, is_grey=is_grey)
    if found.right is None or found.right_from_left is None:
        lack = missing_eye(text, is_grey=is_grey) if looks_like_kitti(text) else _missing_part(path, text)
        raise RigError(f"{path}: {lack}; give a file with both cameras, or run on one video with --mono.")
    check_rig(StereoRig(found.left, found.right, found.right_from_left), path)
    left, left_notes = fitted_to_size(found.left, size_px, f"{path} (left)")
    right, right_notes = fitted_to_size(found.right, size_px, f"{path} (right)")
    rig = StereoRig(left, right, found.right_from_left)
    check_rig(rig, path)
    return rig, (*found.notes, *left_notes, *right_notes)


def load_camera(
    path: Path, *, size_px: tuple[int, int] | None, is_grey: bool = False
) -> tuple[PinholeCamera, tuple[str, ...]]:
    """The only, or left, camera of a file, for images of `size_px` = (width, height), and notes to tell the user.

    `size_px` None = there are no images to fit it to; the camera's size may then be 0.

    Raises:
        RigError: the file cannot be read, is no calibration, is implausible or for other images.
    """
    found = _parsed(_text_of(path), path, is_grey=is_grey)
    check_camera(found.left, f"{path}: left")
    if size_px is None:
        return found.left, found.notes
    camera, notes = fitted_to_size(found.left, size_px, path)
    check_camera(camera, f"{path}: left")
    return camera, (*found.notes, *notes)


def load_calibration(
    path: Path, *, size_px: tuple[int, int] | None = None, is_grey: bool = False
) -> tuple[PinholeCamera | StereoRig, tuple[str, ...]]:
    """The camera of a file, or its rig if it holds one, and notes to tell the user; for no images in particular.

    Args:
        path: a file in any of the four formats.
        size_px: (width, height) of images to fit it to; None = the file's own, which may be 0 where it gives none.
        is_grey: take the grey pair of a KITTI file that also has the colour one.

    Raises:
        RigError: the file cannot be read, is no calibration, is implausible or for other images.
    """
    found = _parsed(_text_of(path), path, is_grey=is_grey)
    if found.right is None or found.right_from_left is None:
        return load_camera(path, size_px=size_px, is_grey=is_grey)
    if size_px is not None:
        return load_rig(path, size_px=size_px, is_grey=is_grey)
    rig = StereoRig(found.left, found.right, found.right_from_left)
    check_rig(rig, path)
    return rig, found.notes


def left_from_reference_m(path: Path, *, is_grey: bool) -> FloatArray:
    """(3,) shift that takes points of KITTI's reference camera (its labels' frame) into the left camera's frame.

    Zeros for the other formats. The label of an object is moved by it before it is compared with a distance of ours.

    Raises:
        RigError: the file cannot be read or is no calibration.
    """
    return np.array(_parsed(_text_of(path), path, is_grey=is_grey).left_from_reference_m)


def find_rig(left_video: Path) -> Path | None:
    """`rig.yaml`, else `calib.txt`, beside the left video; for a folder of images inside it, then beside it."""
    folders = (left_video, left_video.parent) if left_video.is_dir() else (left_video.parent,)
    candidates = (folder / name for folder in folders for name in ("rig.yaml", "calib.txt"))
    return next((candidate for candidate in candidates if candidate.is_file()), None)


def _text_of(path: Path) -> str:
    try:
        if path.stat().st_size > _MAX_BYTES:
            raise RigError(f"{path}: it is far too large for a rig; give {_FORMATS}.")
        return path.read_text(encoding="utf-8-sig")
    except FileNotFoundError as error:
        raise RigError(f"{path}: there is no such file; name the cameras' rig.yaml or calib.txt.") from error
    except OSError as error:
        raise RigError(f"{path}: cannot be read ({error.strerror}); give {_FORMATS}.") from error
    except UnicodeDecodeError as error:
        raise RigError(f"{path}: it is not text, so no rig; give {_FORMATS}.") from error


def _parsed(text: str, path: Path, *, is_grey: bool) -> Calibration:
    """What the file says, by the format that its content shows."""
    if looks_like_opencv(text):
        return parse_opencv(text, path)
    if looks_like_kalibr(text):
        return parse_kalibr(text, path)
    if looks_like_kitti(text):
        return parse_kitti(text, path, is_grey=is_grey)
    return _parse_ours(text, path)


def _parse_ours(text: str, path: Path) -> Calibration:
    try:
        content = yaml.safe_load(text)
    except yaml.YAMLError as error:
        raise RigError(f"{path}: it is not readable as YAML{_where(error)}; give {_FORMATS}.") from error
    if not isinstance(content, dict) or "track_range_rig" not in content:
        raise RigError(f"{path}: it is no rig (no key 'track_range_rig'); give {_FORMATS}.")
    version = content["track_range_rig"]
    if type(version) is not int or version != VERSION:
        raise RigError(f"{path}: it is a rig of version {version!r}, this program reads version {VERSION}.")
    try:
        rig = _RigFile.model_validate(content)
    except ValidationError as error:
        raise RigError(f"{path}: {_first_fault(error)}; correct it.") from error
    left = rig.left.camera()
    if rig.right is None or rig.right_from_left is None:
        return Calibration(left, None, None)
    return Calibration(left, rig.right.camera(), rig.right_from_left.matrix())


def _first_fault(error: ValidationError) -> str:
    """The first wrong key, what is wrong and what stands there."""
    fault = error.errors()[0]
    key = ".".join(str(part) for part in fault["loc"])
    if fault["type"] == "missing":
        return f"the key '{key}' is missing"
    if fault["type"] == "extra_forbidden":
        return f"the key '{key}' is unknown"
    return f"'{key}' is {fault['input']!r}: {fault['msg'][0].lower()}{fault['msg'][1:]}"


def _where(error: yaml.YAMLError) -> str:
    mark = getattr(error, "problem_mark", None)
    return "" if mark is None else f" (line {mark.line + 1})"


def _missing_part(path: Path, text: str) -> str:
    """What a file of one camera lacks, for the message that refuses it."""
    if looks_like_kalibr(text):
        return "it lacks cam1"
    if looks_like_opencv(text):
        return f"M2, D2, R and T are not all in it, nor in intrinsics/extrinsics{path.suffix} beside it"
    return "it lacks 'right' or 'right_from_left'"
