"""ROS: camera_info of one camera per YAML document, two files or documents for a pair.

    camera_calibration  image_width image_height camera_matrix distortion_model distortion_coefficients
                        rectification_matrix projection_matrix             matrices as {rows, cols, data}
    topic echo          width height distortion_model D K R P (d k r p)    lists; `---` after each message

The right camera of a pair is the one with the smaller P[0, 3] = -f B. The images of camera_info come from the driver
(image_raw), and D, K and R rectify them; P describes the rectified images (image_rect). Both have the same size.
(http://docs.ros.org/en/api/sensor_msgs/html/msg/CameraInfo.html, http://wiki.ros.org/camera_calibration_parsers.)
"""

import re
from pathlib import Path
from typing import Annotated, NamedTuple

import numpy as np
from pydantic import BaseModel, BeforeValidator, Field

from track_range.foundation.files.input_files import read_text
from track_range.foundation.files.structured_text import parse_yaml
from track_range.foundation.schemas.validation import Integer, Number, validated
from track_range.stereo.geometry.rig import RigError
from track_range.stereo.geometry.rig_checks import ImageSide, RigCalibration
from track_range.stereo.rig_formats.camera_info import CameraInfo, camera_of, is_undistorted, rig_of
from track_range.stereo.rig_formats.rig_format import RigFormat
from track_range.stereo.rig_formats.values.partners import files_of, other_sides, partner_of

_TITLE = "ROS's camera_info"
_EXPECTED = "a camera_info of ROS"
# Keys at the start of a line, one of which every camera_info has.
_RECOGNISED = re.compile(r"^(?:(?:camera|projection)_matrix|[kKpP])[ \t]*:", re.MULTILINE)
# scripts have none
_HAS_SIZE = re.compile(r"^(?:image_)?width[ \t]*:|^projection_matrix|^[pP][ \t]*:", re.MULTILINE)
# a message as JSON has all of these keys
_JSON_KEYS = ('"distortion_model"', '"K"', '"D"', '"R"', '"P"')
_OST = re.compile(r"^# oST|^\[image\]\s*$", re.MULTILINE)  # camera_calibration's text file
_OST_NAMES = {
    "width": "image_width", "height": "image_height", "camera matrix": "camera_matrix",
    "distortion": "distortion_coefficients", "rectification": "rectification_matrix", "projection": "projection_matrix",
}  # fmt: skip
_OST_VALUE = re.compile(
    rf"^[ \t]*({'|'.join(_OST_NAMES)})[ \t]*\n((?:[-+\d.eE \t]*\n)*)", re.MULTILINE
)
_OST_NUMBER = re.compile(r"[-+]?\d+(?:\.\d*)?(?:[eE][-+]?\d{1,3})?")
_SEPARATOR = re.compile(r"^---[^\n]*$", re.MULTILINE)  # line between two YAML documents
_SUFFIXES = (".yaml", ".yml", ".json")


def _data_of(value: object) -> object:
    """The numbers of {rows, cols, data}; other values as they are."""
    return value["data"] if isinstance(value, dict) and "data" in value else value


_Value = Annotated[Number, Field(ge=-1e7, le=1e7)]
_Row = BeforeValidator(_data_of)
_Matrix33 = Annotated[list[_Value], Field(min_length=9, max_length=9), _Row]
_Matrix34 = Annotated[list[_Value], Field(min_length=12, max_length=12), _Row]
_Coefficients = Annotated[list[_Value], Field(max_length=14), _Row]
"""Numbers row by row; no plausible number has a magnitude above 1e7; OpenCV has at most 14
distortion coefficients."""


class _Region(BaseModel):
    """Region of interest; zeros = the entire image."""

    x_offset: Integer = 0
    y_offset: Integer = 0
    width: Integer = 0
    height: Integer = 0


class _CameraFile(BaseModel):
    """Keys of both layouts under the names of `camera_calibration`; other keys are ignored."""

    image_width: ImageSide
    image_height: ImageSide
    distortion_model: str = ""
    camera_matrix: _Matrix33 | None = None
    distortion_coefficients: _Coefficients | None = None
    rectification_matrix: _Matrix33 | None = None
    projection_matrix: _Matrix34 | None = None
    roi: _Region = _Region()


_NAMES = {  # those of `camera_calibration` for the keys of messages in ROS 1 and ROS 2
    "width": "image_width",
    "height": "image_height",
    **dict.fromkeys(("D", "d"), "distortion_coefficients"),
    **dict.fromkeys(("K", "k"), "camera_matrix"),
    **dict.fromkeys(("R", "r"), "rectification_matrix"),
    **dict.fromkeys(("P", "p"), "projection_matrix"),
}


class _Camera(NamedTuple):
    info: CameraInfo
    path: Path
    # whether K and D describe raw images; False = the file only has P, of rectified images
    is_raw: bool

    @property
    def is_rectified(self) -> bool:
        return not self.is_raw or is_undistorted(self.info)


def _is_camera_info(text: str) -> bool:
    is_json = text.lstrip().startswith("{")
    if is_json and all(key in text or key.lower() in text for key in _JSON_KEYS):
        return True
    if _OST.search(text):
        return True
    return _RECOGNISED.search(text) is not None and _HAS_SIZE.search(text) is not None


def _ost_documents(text: str) -> list[dict[str, object]]:
    """The keys and numbers of each camera of an ost.txt, under its name in brackets; [image]
    applies to all.
    """
    parts = [
        "image",
        *re.split(r"^[ \t]*\[(.*)\][ \t]*$", text.replace("\r", "") + "\n", flags=re.MULTILINE),
    ]
    common: dict[str, object] = {}
    documents: list[dict[str, object]] = []
    for name, body in zip(parts[::2], parts[1::2], strict=True):
        if name != "image":
            documents.append({})
        for key, words in _OST_VALUE.findall(body):
            numbers = [float(word) for word in words.split()[:20] if _OST_NUMBER.fullmatch(word)]
            is_size = key in ("width", "height")
            target = common if is_size or not documents else documents[-1]
            target[_OST_NAMES[key]] = numbers[0] if is_size and numbers else numbers
    return [common | document for document in documents] or [common]


def _read(text: str, path: Path, _is_grey: bool) -> RigCalibration:
    cameras = _cameras(text, path)
    if len(cameras) == 2:
        return _pair(cameras[0], cameras[1], path)
    info, path, _ = cameras[0]
    only = camera_of(info, path, is_rectified=cameras[0].is_rectified)
    note = f"{path}: {_TITLE} of one camera; {_assumption(is_rectified=cameras[0].is_rectified)}."
    return RigCalibration(only, None, None, notes=(note,))


def _read_pair(text: str, path: Path, is_grey: bool) -> RigCalibration:
    """See `_read`; for a file with one camera, the other camera is read from the other side's file,
    if it exists.
    """
    cameras = _cameras(text, path)
    if len(cameras) == 1 and (partner := partner_of(path)) is not None:
        cameras += _cameras(read_text(partner, RigError, _EXPECTED), partner)
    return _pair(cameras[0], cameras[1], path) if len(cameras) == 2 else _read(text, path, is_grey)


def read_folder(folder: Path) -> RigCalibration | None:
    """The two cameras of the camera_info in a folder; None if there are not two; RigError if a file
    cannot be read.
    """
    paths = [path for path in files_of(folder) if path.suffix in _SUFFIXES]
    texts = {path: read_text(path, RigError, _EXPECTED) for path in paths}
    cameras = [
        camera
        for path, text in texts.items()
        if _is_camera_info(text)
        for camera in _cameras(text, path)
    ]
    return _pair(cameras[0], cameras[1], folder) if len(cameras) == 2 else None


def _cameras(text: str, path: Path) -> list[_Camera]:
    """The different cameras of a file, in its order; repeated messages count once."""
    cameras: dict[tuple[object, ...], _Camera] = {}
    start = 0
    if _OST.search(text):
        return _checked([_camera(document, path) for document in _ost_documents(text)[:3]], path)
    for end in [*(match.start() for match in _SEPARATOR.finditer(text)), len(text)]:
        lines_before = "\n" * text.count("\n", 0, start)  # so that errors have the line of the file
        content = parse_yaml(
            lines_before + _SEPARATOR.sub("", text[start:end]), path, RigError, _EXPECTED
        )
        start = end
        if content is not None:
            camera = _camera(content, path)
            k, r, p = (
                tuple(part.ravel().tolist())
                for part in (camera.info.k, camera.info.r, camera.info.p)
            )
            cameras.setdefault((camera.info.size_px, k, r, p), camera)
    return _checked(list(cameras.values()), path)


def _checked(cameras: list[_Camera], path: Path) -> list[_Camera]:
    if not 1 <= len(cameras) <= 2:
        raise RigError(
            f"{path}: expected {_TITLE} of one or two cameras, found {len(cameras)}; give one file each."
        )
    return cameras


def _camera(content: object, path: Path) -> _Camera:
    if isinstance(content, dict):
        content = {_NAMES.get(str(key), key): value for key, value in content.items()}
    file = validated(_CameraFile, content, path, RigError)
    size_px, roi = (file.image_width, file.image_height), file.roi
    if (roi.width, roi.height) not in ((0, 0), size_px) or roi.x_offset or roi.y_offset:
        raise RigError(
            f"{path}: expected the calibration of whole images, found a region of interest of {roi.width}x{roi.height} "
            "px; give a rig.yaml of the cropped images."
        )
    k, r, p = (
        np.reshape(numbers or np.zeros(size), (3, -1))
        for numbers, size in (
            (file.camera_matrix, 9),
            (file.rectification_matrix, 9),
            (file.projection_matrix, 12),
        )
    )
    is_raw = k.any() or file.distortion_coefficients is not None
    k = k if is_raw else p[:, :3]
    p = p if p.any() else np.insert(k, 3, 0.0, axis=1)
    if min(k[0, 0], k[1, 1], p[0, 0], p[1, 1]) < 1:
        raise RigError(
            f"{path}: expected a calibrated camera, found focal lengths below 1 px; calibrate it."
        )
    if is_raw and file.distortion_coefficients is None:
        raise RigError(
            f"{path}: expected distortion coefficients, found none; write zeros for undistorted images."
        )
    distortion = tuple(file.distortion_coefficients or ())
    info = CameraInfo(size_px, file.distortion_model, distortion, k, r if r.any() else np.eye(3), p)
    return _Camera(info, path, bool(is_raw))


def _pair(first: _Camera, second: _Camera, source: Path) -> RigCalibration:
    """The rig of two cameras in any order: the right camera has the smaller P[0, 3] / P[0, 0],
    -B.
    """
    offset_m, other_offset_m = (
        float(camera.info.p[0, 3] / camera.info.p[0, 0]) for camera in (first, second)
    )
    left, right = (first, second) if offset_m >= other_offset_m else (second, first)
    if left.is_raw != right.is_raw:
        raise RigError(
            f"{source}: expected K and D of both cameras or of neither, found K and D of one; add or remove them."
        )
    is_rectified = left.is_rectified and right.is_rectified
    rig = rig_of(left.info, right.info, source, is_rectified=is_rectified)
    name = "the first document" if first.path == second.path else first.path.name
    note = (
        f"{source}: {_TITLE}; {name} is the {'left' if left is first else 'right'} camera by P[0, 3] = -f B; "
        f"{_assumption(is_rectified=is_rectified)}."
    )
    return RigCalibration(rig.left, rig.right, rig.right_from_left, notes=(note,))


def _assumption(*, is_rectified: bool) -> str:
    """The kind of images that the calibration is for, in words for notes."""
    if is_rectified:
        return "the images are taken as rectified"
    return "the images are taken as raw (image_raw); if they are rectified (image_rect), remove K and D from the YAML"


def _missing(_text: str, path: Path, _is_grey: bool) -> str:
    partner = next(other_sides(path.name), None)
    place = (
        f"in {partner} beside it"
        if partner
        else "in a second file beside it (left.yaml, right.yaml)"
    )
    return f"{_TITLE} of the other camera {place} or after a line --- in this file"


ROS = RigFormat(
    name="ros",
    title=_TITLE,
    recognises=_is_camera_info,
    read=_read,
    read_pair=_read_pair,
    missing=_missing,
    priority=-20,
)
