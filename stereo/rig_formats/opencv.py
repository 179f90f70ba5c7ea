"""Files of OpenCV's calibration samples: matrices in FileStorage (YAML, XML or JSON).

    stereo_calib.cpp   intrinsics.yml  M1 D1 M2 D2     extrinsics.yml  R T (R1 R2 P1 P2 Q are not needed)
    calibration.cpp    camera_matrix distortion_coefficients image_width image_height        one camera

T has the unit of the chessboard's square size, so that size must have been given in metres. OpenCV's YAML tags are
not standard YAML, so the files are read with OpenCV, after a check of the text: OpenCV's parser overflows the stack on
deeply nested lists, and does not return from some base64 data.

A camera without distortion coefficients is refused: stereo_calib always writes them (zeros for undistorted images), and
distances would be wrong if a distorted camera were treated as an ideal one.
"""

from __future__ import annotations

import re
from collections.abc import Mapping
from pathlib import Path

import cv2
import numpy as np
import numpy.typing as npt

from track_range.foundation.arrays import FloatArray
from track_range.foundation.input_files import quoted, read_text
from track_range.foundation.structured_text import MAX_DEPTH
from track_range.stereo.geometry.camera import PinholeCamera
from track_range.stereo.geometry.rectification import distortion_coefficients, stereo_rectification
from track_range.stereo.geometry.rig import RigError, StereoRig
from track_range.stereo.geometry.rig_checks import MAX_SIDE_PX, Calibration, check_camera, check_rig
from track_range.stereo.rig_formats.rig_format import RigFormat, write_rig_text

_NONE: FloatArray = np.zeros(0)
"""The numbers of a missing key."""

_EXTRINSIC = ("R", "T")
"""Keys of the extrinsics."""

_SIBLING_SUFFIXES = (".yml", ".yaml", ".xml", ".json")
"""Suffixes of the file with the other half of a calibration."""

_BASE64 = re.compile(r"\$base64\$|!!binary|type_id\s*=\s*[\"']binary")
"""Marks of base64 data in JSON, YAML and XML."""

_NESTING = re.compile(r"(?P<start>[\[{]|<[A-Za-z_])|[]}]|</|/>")
"""Starts and ends of lists, keys with values, and XML's elements."""

_HYPHENS = re.compile(rf"(?:-[ ]+){{{MAX_DEPTH}}}")
"""Nested lists in one line of YAML."""

_KEYS = (
    *("M1", "D1", "M2", "D2", *_EXTRINSIC, "camera_matrix", "distortion_coefficients"),
    *("image_width", "image_height", "imageSize"),
)
"""Keys that are read."""

_MAX_LIST = 14
"""Largest number of values of a list; OpenCV has at most 14 distortion coefficients."""


def _is_file_storage(text: str) -> bool:
    """Whether a file is OpenCV's FileStorage, recognised by the tag of its matrices."""
    return "opencv-matrix" in text or "<opencv_storage>" in text


def _read(text: str, path: Path) -> Calibration:
    """The cameras of one file, or of intrinsics and extrinsics in one folder; `path` is one of the two.

    Raises:
        RigError: the file is damaged, or a matrix is missing.
    """
    values = dict(_matrices(text, path))
    sibling = _sibling(path, values)
    if sibling is not None:
        values = {**_matrices(read_text(sibling, RigError, "a calibration of OpenCV"), sibling), **values}
    if "camera_matrix" in values:
        values.setdefault("M1", values["camera_matrix"])
        values.setdefault("D1", values.get("distortion_coefficients", _NONE))
    if "M1" not in values:
        raise RigError(
            f"{path}: expected the matrix M1 in this file or in an intrinsics file in its folder, found none; give "
            "stereo_calib's intrinsics.yml."
        )
    left = _camera(values, "1", path)
    if "M2" not in values or not all(key in values for key in _EXTRINSIC):
        return Calibration(left, None, None)
    right_from_left = np.eye(4)
    right_from_left[:3, :3] = _shaped(values["R"], (3, 3), "R", path)
    right_from_left[:3, 3] = _shaped(values["T"], (3,), "T", path)
    baseline_m = float(np.linalg.norm(right_from_left[:3, 3]))
    note = f"{path}: the baseline is {baseline_m:.4g} m, assuming that the square size was given in metres."
    return Calibration(left, _camera(values, "2", path), right_from_left, notes=(note,))


def _camera(values: Mapping[str, FloatArray], number: str, path: Path) -> PinholeCamera:
    matrix = _shaped(values[f"M{number}"], (3, 3), f"M{number}", path)
    if not np.array_equal(matrix[2], (0.0, 0.0, 1.0)):
        raise RigError(
            f"{path}: expected 0, 0, 1 in the last row of M{number}, found {quoted(matrix[2].tolist())}; give the "
            "camera matrix."
        )
    distortion = values.get(f"D{number}", _NONE).ravel()
    if not len(distortion):
        raise RigError(
            f"{path}: expected the distortion coefficients D{number} of the camera M{number}, found none; write zeros "
            "for undistorted images."
        )
    width, height = (round(side) for side in values.get("size", np.zeros(2)).tolist())
    fx, fy, cx, cy = (float(matrix[index]) for index in ((0, 0), (1, 1), (0, 2), (1, 2)))
    return PinholeCamera(fx, fy, cx, cy, width, height, tuple(distortion.tolist()))


def _shaped(values: FloatArray, shape: tuple[int, ...], name: str, path: Path) -> FloatArray:
    if values.size != np.prod(shape):
        raise RigError(f"{path}: expected {np.prod(shape)} numbers in {name}, found {values.size}; calibrate again.")
    return values.reshape(shape)


def _sibling(path: Path, values: Mapping[str, FloatArray]) -> Path | None:
    """The file in the folder of `path` with the other half of the calibration, if needed and present."""
    lacks_extrinsic = "M1" in values and not all(key in values for key in _EXTRINSIC)
    lacks_intrinsic = "M1" not in values and "R" in values
    if lacks_extrinsic:
        stem = path.stem.replace("intrinsic", "extrinsic") if "intrinsic" in path.stem else "extrinsics"
    elif lacks_intrinsic:
        stem = path.stem.replace("extrinsic", "intrinsic") if "extrinsic" in path.stem else "intrinsics"
    else:
        return None
    candidates = (path.with_name(stem + suffix) for suffix in (path.suffix, *_SIBLING_SUFFIXES))
    return next((candidate for candidate in candidates if candidate != path and candidate.is_file()), None)


def _matrices(text: str, path: Path) -> dict[str, FloatArray]:
    """Matrices and numbers by key, those of `_KEYS` that the file has, and "size" for the image size, if any.

    Raises:
        RigError: the text is damaged, or a value is not a matrix or number.
    """
    _check_text(text, path)
    try:
        storage = cv2.FileStorage(text, cv2.FILE_STORAGE_READ | cv2.FILE_STORAGE_MEMORY)
        root = storage.root()
        names = list(root.keys())  # an error if the root is not a mapping
        nodes = {key: _numbers(root.getNode(key)) for key in _KEYS if key in names}
    except (cv2.error, SystemError) as error:
        raise RigError(
            f"{path}: cannot be read with OpenCV, probably because the file is damaged; calibrate again."
        ) from error
    if duplicate := next((key for key in _KEYS if names.count(key) > 1), None):
        raise RigError(f"{path}: expected the key {duplicate} once, found it {names.count(duplicate)} times.")
    if unusable := [key for key, value in nodes.items() if value is None]:
        raise RigError(f"{path}: expected numbers in {unusable[0]}, found text or too many values; calibrate again.")
    numbers = {key: value for key, value in nodes.items() if value is not None}
    size_px = np.concatenate([numbers.get(key, _NONE).ravel() for key in ("image_width", "image_height")])
    size_px = size_px if size_px.size else numbers.get("imageSize", _NONE).ravel()
    if size_px.size and not (size_px.size == 2 and ((size_px >= 1) & (size_px <= MAX_SIDE_PX)).all()):
        raise RigError(
            f"{path}: expected an image_width and image_height of 1 to {MAX_SIDE_PX} px, found "
            f"{quoted(size_px.tolist())}; correct the file."
        )
    return numbers | ({"size": size_px} if size_px.size else {})


def _check_text(text: str, path: Path) -> None:
    """Check the depth of a text, and that it has no base64 data; strings in it are not distinguished.

    Raises:
        RigError: OpenCV's parser may not return from the text.
    """
    if _BASE64.search(text):
        raise RigError(f"{path}: expected matrices as numbers, found base64 data; write the file without it.")
    depth = 0
    for match in _NESTING.finditer(text):
        depth += 1 if match["start"] else -1
        if depth > MAX_DEPTH:
            break
    if depth > MAX_DEPTH or _HYPHENS.search(text):
        raise RigError(f"{path}: expected matrices, found more than {MAX_DEPTH} nested lists; calibrate again.")


def _numbers(node: cv2.FileNode) -> FloatArray | None:
    """The numbers of a node; None for text and other types."""
    if node.isInt() or node.isReal():
        return np.array([node.real()])
    if node.isMap():
        matrix = node.mat()
        return None if matrix is None else np.asarray(matrix, np.float64)
    if (
        node.isSeq()
        and node.size() <= _MAX_LIST
        and all(node.at(i).isInt() or node.at(i).isReal() for i in range(node.size()))
    ):
        return np.array([node.at(i).real() for i in range(node.size())])
    return None


def save_opencv(cameras: StereoRig | PinholeCamera, path: Path) -> None:
    """Write a rig as OpenCV's stereo_calib sample does, or one camera as calibration.cpp does; lengths in metres.

    Raises:
        RigError: the cameras are implausible or of different image sizes, or the file cannot be written.
    """
    if isinstance(cameras, StereoRig):
        check_rig(cameras, path)
        left, right = cameras.left, cameras.right
        if (left.width_px, left.height_px) != (right.width_px, right.height_px):
            raise RigError(
                f"{path}: expected cameras of equal image size for OpenCV's format, got "
                f"{left.width_px}x{left.height_px} and {right.width_px}x{right.height_px} px; write a rig.yaml."
            )
        matrices = _rig_matrices(cameras)
    else:
        check_camera(cameras, path)
        matrices = {"camera_matrix": cameras.matrix, "distortion_coefficients": _distortion_row(cameras)}
        left = cameras
    storage = cv2.FileStorage(path.suffix or ".yml", cv2.FILE_STORAGE_WRITE | cv2.FILE_STORAGE_MEMORY)
    storage.write("image_width", left.width_px)
    storage.write("image_height", left.height_px)
    for key, matrix in matrices.items():
        storage.write(key, np.asarray(matrix, np.float64))
    write_rig_text(path, storage.releaseAndGetString())


def _rig_matrices(rig: StereoRig) -> Mapping[str, npt.ArrayLike]:
    r, t = rig.right_from_left[:3, :3], rig.right_from_left[:3, 3:]
    d1, d2 = _distortion_row(rig.left), _distortion_row(rig.right)
    r1, r2, p1, p2, q = stereo_rectification(rig)
    return {
        "M1": rig.left.matrix, "D1": d1, "M2": rig.right.matrix, "D2": d2, "R": r, "T": t,
        "R1": r1, "R2": r2, "P1": p1, "P2": p2, "Q": q,
    }  # fmt: skip


def _distortion_row(camera: PinholeCamera) -> FloatArray:
    return distortion_coefficients(camera)[None]


OPENCV = RigFormat(
    name="opencv",
    title="the files of OpenCV's stereo_calib",
    recognises=_is_file_storage,
    read=lambda text, path, _is_grey: _read(text, path),
    missing=lambda _text, path, _is_grey: (
        f"M2, D2, R and T in this file or in intrinsics/extrinsics{path.suffix} in its folder"
    ),
    write=lambda cameras, path, _comments: save_opencv(cameras, path),
)
