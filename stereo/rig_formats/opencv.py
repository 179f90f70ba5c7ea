"""Files of OpenCV's calibration samples: matrices in FileStorage (YAML, XML or JSON).

    stereo_calib.cpp   intrinsics.yml  M1 D1 M2 D2     extrinsics.yml  R T (R1 R2 P1 P2 Q are not needed)
    calibration.cpp    camera_matrix distortion_coefficients image_width image_height        one camera

    cv::fisheye        K1 D1 K2 D2 R T, or one of the above with fisheye_model: 1, as calibration.cpp writes it

T has the unit of the chessboard's square size, so that size must have been given in metres. The files are read without
OpenCV: its parser overflows the stack on nested lists, writes outside its memory on damaged JSON, and does not return
from some base64 data. Only the keys needed are read; base64 data are refused.

A camera without distortion coefficients is refused: stereo_calib always writes them (zeros for undistorted images), and
distances would be wrong if a distorted camera were treated as an ideal one.
"""

from __future__ import annotations

import re
from collections.abc import Mapping
from pathlib import Path
from typing import Annotated, Any, Literal
from xml.etree import ElementTree

import cv2
import numpy as np
import numpy.typing as npt
from pydantic import BaseModel, Field, TypeAdapter, ValidationError

from track_range.foundation.arrays import FloatArray
from track_range.foundation.files.input_files import quoted, read_text, shortened
from track_range.foundation.files.structured_text import parse_json, parse_yaml
from track_range.foundation.validation import Integer, Number, validated
from track_range.stereo.geometry.camera import PinholeCamera
from track_range.stereo.geometry.lenses import KANNALA_BRANDT, PINHOLE
from track_range.stereo.geometry.rectification import distortion_coefficients, stereo_rectification
from track_range.stereo.geometry.rig import RigError, StereoRig
from track_range.stereo.geometry.rig_checks import MAX_SIDE_PX, RigCalibration, check_camera, check_rig
from track_range.stereo.rig_formats.rig_format import RigFormat, write_rig_text

_NONE: FloatArray = np.zeros(0)  # the numbers of a missing key
_EXPECTED = "a calibration of OpenCV"
_EXTRINSIC = ("R", "T")  # keys of the extrinsics
_FISHEYE_MATRICES = {"K1": "M1", "K2": "M2"}  # camera matrices in files of cv::fisheye, and of stereo_calib
_OF_PAIR = ("M2", "D2", *_EXTRINSIC)  # keys of two cameras; a file without all of them describes one camera
_SIBLING_SUFFIXES = (".yml", ".yaml", ".xml", ".json")  # suffixes of the file with the other half of a calibration
_YAML_HEAD = re.compile(r"\A\s*%YAML[^\n]*\n|!!opencv-[a-z-]+")  # what OpenCV's YAML has and YAML has not

_KEYS = (
    *("M1", "D1", "M2", "D2", *_EXTRINSIC, "camera_matrix", "distortion_coefficients"),
    *("image_width", "image_height", "imageSize"),
    *("fisheye_model", *_FISHEYE_MATRICES),
)

_MAX_SIDE = 14  # largest number of rows or columns; OpenCV has at most 14 distortion coefficients
_Side = Annotated[Integer, Field(ge=1, le=_MAX_SIDE)]


class _Matrix(BaseModel):
    """A matrix in FileStorage, row by row; dt is the type of the numbers: d and f are float64 and float32."""

    rows: _Side
    cols: _Side
    dt: Literal["d", "f", "i", "u", "w", "s", "c"]
    data: Annotated[list[Number], Field(max_length=_MAX_SIDE**2)]


_NUMBERS: TypeAdapter[list[float]] = TypeAdapter(Annotated[list[Number], Field(max_length=_MAX_SIDE)])


def _read(text: str, path: Path) -> RigCalibration:
    """The cameras of one file, or of intrinsics and extrinsics in one folder; `path` is one of the two."""
    values = _matrices(text, path)
    sibling = _sibling(path, values)
    if sibling is not None:
        values = {**_matrices(read_text(sibling, RigError, _EXPECTED), sibling), **values}
    if "camera_matrix" in values:
        values.setdefault("M1", values["camera_matrix"])
        values.setdefault("D1", values.get("distortion_coefficients", _NONE))
    if "M1" not in values:
        raise RigError(
            f"{path}: expected the matrix M1 in this file or in an intrinsics file in its folder, found none; give "
            "stereo_calib's intrinsics.yml."
        )
    fisheye_notes: tuple[str, ...] = ()
    if "fisheye_model" in values:
        is_fisheye = bool(values["fisheye_model"].any())
    elif is_fisheye := "K1" in values and values.get("D1", _NONE).size == 4:
        note = "read as OpenCV's fisheye model, since it has K1 and four coefficients; else add fisheye_model: 0."
        fisheye_notes = (f"{path}: {note}",)
    left = _camera(values, "1", path, is_fisheye=is_fisheye)
    missing = [key for key in _OF_PAIR if key not in values]
    if len(missing) == len(_OF_PAIR):
        return RigCalibration(left, None, None, notes=fisheye_notes)
    if missing:
        raise RigError(
            f"{path}: expected {', '.join(_OF_PAIR)} of two cameras in this file or in "
            f"intrinsics/extrinsics{path.suffix} in its folder, found no {', '.join(missing)}; give the complete "
            "calibration, or a file with M1 and D1 only for one camera."
        )
    right_from_left = np.eye(4)
    right_from_left[:3, :3] = _shaped(values["R"], (3, 3), "R", path)
    right_from_left[:3, 3] = _shaped(values["T"], (3,), "T", path)
    baseline_m = float(np.linalg.norm(right_from_left[:3, 3]))
    note = f"{path}: the baseline is {baseline_m:.4g} m, assuming that the square size was given in metres."
    right = _camera(values, "2", path, is_fisheye=is_fisheye)
    return RigCalibration(left, right, right_from_left, notes=(note, *fisheye_notes))


def _camera(values: Mapping[str, FloatArray], number: str, path: Path, *, is_fisheye: bool) -> PinholeCamera:
    matrix = _shaped(values[f"M{number}"], (3, 3), f"M{number}", path)
    if not np.array_equal(matrix[2], (0.0, 0.0, 1.0)):
        raise RigError(
            f"{path}: expected 0, 0, 1 in the last row of M{number}, found {quoted(matrix[2].tolist())}; give the "
            "camera matrix."
        )
    distortion = values.get(f"D{number}", _NONE)
    if not len(distortion):
        raise RigError(
            f"{path}: expected the distortion coefficients D{number} of the camera M{number}, found none; write zeros "
            "for undistorted images."
        )
    width_px, height_px = (round(side) for side in values.get("size", np.zeros(2)).tolist())
    lens = KANNALA_BRANDT if is_fisheye else PINHOLE
    return PinholeCamera.of_matrix(matrix, (width_px, height_px), distortion, lens)


def _shaped(values: FloatArray, shape: tuple[int, ...], name: str, path: Path) -> FloatArray:
    if values.size != np.prod(shape):
        raise RigError(f"{path}: expected {np.prod(shape)} numbers in {name}, found {values.size}; calibrate again.")
    return values.reshape(shape)


def _sibling(path: Path, values: Mapping[str, FloatArray]) -> Path | None:
    """The file in the folder of `path` with the other half of the calibration, if needed and present."""
    is_one_camera = "intrinsic" not in path.stem and not any(key in values for key in _OF_PAIR)
    own, other = ("intrinsic", "extrinsic") if "M1" in values else ("extrinsic", "intrinsic")
    if own == "intrinsic" and (is_one_camera or all(key in values for key in _EXTRINSIC)):
        return None
    if own == "extrinsic" and not any(key in values for key in _EXTRINSIC):
        return None
    stem = path.stem.replace(own, other) if own in path.stem else f"{other}s"
    candidates = (path.with_name(stem + suffix) for suffix in (path.suffix, *_SIBLING_SUFFIXES))
    return next((candidate for candidate in candidates if candidate != path and candidate.is_file()), None)


def _matrices(text: str, path: Path) -> dict[str, FloatArray]:
    """Numbers (N,) by key, those of `_KEYS` that the file has, and "size" for the image size, if any."""
    content = _content(text, path)
    numbers = {key: _numbers(content[key], key, path) for key in _KEYS if key in content}
    numbers |= {name: numbers[key] for key, name in _FISHEYE_MATRICES.items() if key in numbers and name not in numbers}
    size_px = np.concatenate([numbers.get(key, _NONE) for key in ("image_width", "image_height")])
    size_px = size_px if size_px.size else numbers.get("imageSize", _NONE)
    if size_px.size and not (size_px.size == 2 and ((size_px >= 1) & (size_px <= MAX_SIDE_PX)).all()):
        raise RigError(
            f"{path}: expected an image_width and image_height of 1 to {MAX_SIDE_PX} px, found "
            f"{quoted(size_px.tolist())}; correct the file."
        )
    return numbers | ({"size": size_px} if size_px.size else {})


def _content(text: str, path: Path) -> dict[str, Any]:
    """Values by key of a FileStorage in YAML, XML or JSON; numbers in XML are texts with spaces between them."""
    start = text.lstrip()[:1]
    if start == "<":
        return _xml_content(text, path)
    if start == "{":
        content = parse_json(text, path, RigError, _EXPECTED)
    else:
        content = parse_yaml(_YAML_HEAD.sub("", text), path, RigError, _EXPECTED)
    if not isinstance(content, dict):
        raise RigError(f"{path}: expected {_EXPECTED}, found {quoted(content)}; calibrate again.")
    return content


def _xml_content(text: str, path: Path) -> dict[str, Any]:
    if "<!DOCTYPE" in text or "<!ENTITY" in text:
        raise RigError(f"{path}: expected {_EXPECTED}, found a document type; remove it.")
    try:
        root = ElementTree.fromstring(text)  # noqa: S314 - without entities, the size is limited by that of the file
    except (ElementTree.ParseError, ValueError, LookupError) as error:
        raise RigError(f"{path}: expected {_EXPECTED} in XML, found an error: {shortened(str(error))}.") from error
    names = [node.tag for node in root]
    if duplicate := next((key for key in _KEYS if names.count(key) > 1), None):
        raise RigError(f"{path}: expected the key {duplicate} once, found it {names.count(duplicate)} times.")

    def words(node: ElementTree.Element) -> str | list[str]:
        """The words of an element: a list for data and sizes."""
        words = (node.text or "").split()
        return words[0] if len(words) == 1 and node.tag != "data" else words

    nodes = (node for node in root if node.tag in _KEYS)
    return {node.tag: {part.tag: words(part) for part in node} if len(node) else words(node) for node in nodes}


def _numbers(value: object, key: str, path: Path) -> FloatArray:
    """(N,) numbers of a matrix, a list or a number; those of a matrix are rounded as OpenCV rounds them."""
    if isinstance(value, dict):
        matrix = validated(_Matrix, value, f"{path}: {key}", RigError)
        if len(matrix.data) != matrix.rows * matrix.cols:
            raise RigError(
                f"{path}: {key}: expected {matrix.rows} x {matrix.cols} numbers, found {len(matrix.data)}; calibrate "
                "again."
            )
        return np.array(matrix.data, np.float32 if matrix.dt == "f" else np.float64).astype(np.float64)
    try:
        return np.array(_NUMBERS.validate_python(value if isinstance(value, list) else [value]))
    except ValidationError as error:
        raise RigError(f"{path}: {key}: expected numbers, found {quoted(value)}; calibrate again.") from error


def save_opencv(cameras: StereoRig | PinholeCamera, path: Path) -> None:
    """Write a rig as OpenCV's stereo_calib sample does, or one camera as calibration.cpp does; lengths in metres.

    Raises RigError if the cameras are implausible or of different image sizes, or the file cannot be written.
    """
    left, right = (cameras.left, cameras.right) if isinstance(cameras, StereoRig) else (cameras, cameras)
    if left.lens != right.lens or left.lens not in (PINHOLE, KANNALA_BRANDT):
        raise RigError(
            f"{path}: expected the lens {PINHOLE} or {KANNALA_BRANDT} for OpenCV's format, the same of both "
            f"cameras, got {' and '.join(sorted({left.lens, right.lens}))}; write a rig.yaml."
        )
    matrices: dict[str, npt.ArrayLike]
    if isinstance(cameras, StereoRig):
        check_rig(cameras, path)
        if left.size_px != right.size_px:
            raise RigError(
                f"{path}: expected cameras of equal image size for OpenCV's format, got "
                f"{left.width_px}x{left.height_px} and {right.width_px}x{right.height_px} px; write a rig.yaml."
            )
        r1, r2, p1, p2, q = stereo_rectification(cameras)
        matrices = {
            "M1": left.matrix, "D1": _distortion_row(left), "M2": right.matrix, "D2": _distortion_row(right),
            "R": cameras.right_from_left[:3, :3], "T": cameras.right_from_left[:3, 3:],
            "R1": r1, "R2": r2, "P1": p1, "P2": p2, "Q": q,
        }  # fmt: skip
    else:
        check_camera(cameras, path)
        matrices = {"camera_matrix": cameras.matrix, "distortion_coefficients": _distortion_row(cameras)}
    storage = cv2.FileStorage(path.suffix or ".yml", cv2.FILE_STORAGE_WRITE | cv2.FILE_STORAGE_MEMORY)
    storage.write("image_width", left.width_px)
    storage.write("image_height", left.height_px)
    if left.is_wide:
        storage.write("fisheye_model", 1)
    for key, matrix in matrices.items():
        storage.write(key, np.asarray(matrix, np.float64))
    write_rig_text(path, storage.releaseAndGetString())


def _distortion_row(camera: PinholeCamera) -> FloatArray:
    return np.array(camera.distortion)[None] if camera.is_wide else distortion_coefficients(camera)[None]


OPENCV = RigFormat(
    name="opencv",
    title="the files of OpenCV's stereo_calib",
    recognises=lambda text: "opencv-matrix" in text or "<opencv_storage>" in text,  # the tags of matrices
    read=lambda text, path, _is_grey: _read(text, path),
    missing=lambda _text, path, _is_grey: (
        f"M2, D2, R and T in this file or in intrinsics/extrinsics{path.suffix} in its folder"
    ),
    write=lambda cameras, path, _comments: save_opencv(cameras, path),
)
