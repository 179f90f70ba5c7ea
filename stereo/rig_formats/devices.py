"""Factory calibrations of stereo cameras: ZED's SN*.conf, DepthAI's (OAK) EEPROM, the output of rs-enumerate-devices.

    ZED        [LEFT_CAM_HD] fx fy cx cy k1 k2 p1 p2 k3, ...   one section per resolution
               [STEREO] Baseline TY TZ, millimetres; RX_HD CV_HD RZ_HD, a rotation vector
               x_right = R x_left - (Baseline, TY, TZ)
    DepthAI    cameraData: [socket, {intrinsicMatrix, distortionCoeff, width, height, extrinsics}]
               extrinsics: x_to = rotationMatrix x + translation, centimetres; toCameraSocket
    RealSense  Intrinsic of "Infrared 1" / 848x480 ...; Extrinsic from "Infrared 1" To "Infrared 2", metres

(stereolabs/zed-open-capture, examples/include/calibration.hpp; luxonis/depthai-core, CalibrationHandler;
IntelRealSense/librealsense, tools/enumerate-devices.)
"""

# ruff: noqa: N815 - names of values are keys of the file

from __future__ import annotations

import math
import re
from collections.abc import Mapping
from dataclasses import replace
from pathlib import Path
from typing import Any, NamedTuple

import cv2
import numpy as np
from pydantic import BaseModel, Field

from track_range.foundation.arrays import FloatArray
from track_range.foundation.files.input_files import quoted
from track_range.foundation.files.structured_text import parse_json
from track_range.foundation.validation import Integer, Number, validated
from track_range.stereo.geometry.camera import PinholeCamera
from track_range.stereo.geometry.lenses import KANNALA_BRANDT, PINHOLE
from track_range.stereo.geometry.rig import RigError, inverse_motion
from track_range.stereo.geometry.rig_checks import RigCalibration
from track_range.stereo.rig_formats.rig_format import RigFormat
from track_range.stereo.rig_formats.values.containers import plain_values

_ZED_TITLE, _OAK_TITLE, _REALSENSE_TITLE = "ZED's SN*.conf", "DepthAI's (OAK) calibration", "RealSense's calibration"
_ZED_SIZES = {  # (width, height) of the images of one side by the name of the mode
    "2K": (2208, 1242), "FHD": (1920, 1080), "FHD1200": (1920, 1200), "HD": (1280, 720), "SVGA": (960, 600),
    "VGA": (672, 376), "HD1080": (1920, 1080), "HD1200": (1920, 1200), "HD720": (1280, 720), "4K": (3840, 2160),
    "QHDPLUS": (3200, 1800),
}  # fmt: skip
_ZED_SECTION = re.compile(r"^\s*\[LEFT_CAM_(\w+)\]", re.MULTILINE | re.IGNORECASE)
_OAK_UNITS_CM = {0: 100.0, 1: 1.0, 2: 0.1, 3: 2.54, 4: 30.48}  # depthai-core, LengthUnit: m, cm, mm, in, ft
_SPEC_DIFFERENCE = 0.05  # relative difference of the baselines by calibration and by specification that is noted


def _read_zed(text: str, path: Path) -> RigCalibration:
    """The cameras of all resolutions, the first one with the others as `others`."""
    content = plain_values(text, path, _ZED_TITLE).items()
    values = {name.upper(): section for name, section in content if isinstance(section, dict)}
    stereo = {key.upper(): value for key, value in values.get("STEREO", {}).items()}
    modes = [name.removeprefix("LEFT_CAM_") for name in values if name.startswith("LEFT_CAM_")]
    modes = [mode for mode in modes if mode in _ZED_SIZES and f"RIGHT_CAM_{mode}" in values] or modes[:1]
    if not modes:
        raise RigError(
            f"{path}: expected sections such as LEFT_CAM_HD and RIGHT_CAM_HD, found none; download the file again from "
            "calib.stereolabs.com."
        )
    modes.sort(key=lambda mode: mode != "HD")  # the usual one first
    calibrations = [_zed_mode(values, stereo, mode, path) for mode in modes]
    sizes = ", ".join("{}x{}".format(*_ZED_SIZES.get(mode, (0, 0))) for mode in modes)
    note = f"{path}: {_ZED_TITLE}: lengths in millimetres; sections for images of {sizes} px."
    assumed = f"{note} The images are taken as recorded (unrectified), one image of a pair of this size."
    others = tuple(replace(other, notes=(assumed,)) for other in calibrations[1:])
    return replace(calibrations[0], others=others, notes=(assumed,))


def _zed_mode(values: Mapping[str, Any], stereo: Mapping[str, Any], mode: str, path: Path) -> RigCalibration:
    def number(name: str) -> float:
        """A value of the resolution, else of all; 0 = none."""
        value = stereo.get(f"{name}_{mode}", stereo.get(name, 0.0))
        return float(value) if isinstance(value, float) else 0.0

    cameras = []
    for side in ("LEFT", "RIGHT"):
        section = {key.lower(): value for key, value in values.get(f"{side}_CAM_{mode}", {}).items()}
        common = {key.lower(): value for key, value in values.get(f"{side}_DISTO", {}).items()}
        section = common | section
        missing = [name for name in ("fx", "fy", "cx", "cy") if not isinstance(section.get(name), float)]
        if missing:
            raise RigError(
                f"{path}: expected numbers {', '.join(missing)} in the section {side}_CAM_{mode}, found none; download "
                "the file again from calib.stereolabs.com."
            )
        names = ("k1", "k2", "p1", "p2", "k3", "k4", "k5", "k6")
        coefficients = [value if isinstance(value := section.get(name, 0.0), float) else 0.0 for name in names]
        distortion = coefficients if any(coefficients[5:]) else coefficients[:5]
        focal = (section["fx"], section["fy"], section["cx"], section["cy"])
        cameras.append(PinholeCamera(*focal, *_ZED_SIZES.get(mode, (0, 0)), tuple(distortion)))
    motion = np.eye(4)
    motion[:3, :3] = cv2.Rodrigues(
        np.array([number("RX"), number("CV") or number("RY") or number("CONVERGENCE"), number("RZ")])
    )[0]
    baseline = number("BASELINE")
    motion[:3, 3] = np.array([-baseline, -number("TY"), -number("TZ")]) * math.copysign(0.001, baseline) + 0.0
    return RigCalibration(cameras[0], cameras[1], motion, metres_per_unit=0.001)


class _Point(BaseModel):
    x: Number = 0.0
    y: Number = 0.0
    z: Number = 0.0

    def array(self) -> FloatArray:
        return np.array([self.x, self.y, self.z])


_Row = tuple[Number, Number, Number]


class _Extrinsics(BaseModel):
    """x_to = rotationMatrix x + translation, centimetres; toCameraSocket -1 = none."""

    rotationMatrix: list[_Row] = []
    translation: _Point = _Point()
    specTranslation: _Point = _Point()
    toCameraSocket: Integer = -1
    lengthUnit: Integer = 1


class _OakCamera(BaseModel):
    """One camera; other keys are ignored."""

    cameraType: Integer = 0  # 1 = fisheye
    distortionCoeff: list[Number] = Field(default=[], max_length=14)
    extrinsics: _Extrinsics = _Extrinsics()
    intrinsicMatrix: tuple[_Row, _Row, _Row]
    width: Integer = Field(ge=0, le=32768)
    height: Integer = Field(ge=0, le=32768)

    def camera(self) -> PinholeCamera:
        is_fisheye = self.cameraType == 1
        distortion = self.distortionCoeff[:4] if is_fisheye else self.distortionCoeff
        lens = KANNALA_BRANDT if is_fisheye else PINHOLE
        return PinholeCamera.of_matrix(self.intrinsicMatrix, (self.width, self.height), distortion, lens)


class _OakPair(BaseModel):
    leftCameraSocket: Integer = -1
    rightCameraSocket: Integer = -1


class _OakFile(BaseModel):
    cameraData: list[tuple[Integer, Any]] = Field(max_length=16)
    productName: str = ""
    stereoRectificationData: _OakPair = _OakPair()


class _Path(NamedTuple):
    """Transforms from one socket to another, centimetres."""

    calibrated: FloatArray
    specified: FloatArray  # with the translation of the specification


def _read_oak(text: str, path: Path) -> RigCalibration:
    """The left and the right camera of an EEPROM, by its sockets."""
    content = parse_json(text, path, RigError, _OAK_TITLE)
    if isinstance(content, dict) and isinstance(content.get("cameraData"), dict):
        content["cameraData"] = list(content["cameraData"].items())
    file = validated(_OakFile, content, path, RigError)
    cameras = {}
    for socket, camera in file.cameraData:
        matrix = camera.get("intrinsicMatrix") if isinstance(camera, dict) else None
        if isinstance(matrix, list) and len(matrix) == 3:  # other sockets are empty, or not calibrated
            cameras[socket] = validated(_OakCamera, camera, f"{path}: cameraData {socket}", RigError)
    pair = file.stereoRectificationData
    left, right = pair.leftCameraSocket, pair.rightCameraSocket
    if left not in cameras or right not in cameras:
        left, right = 1, 2
    if left not in cameras or right not in cameras:
        sockets = ", ".join(map(str, cameras)) or "none"
        if len(cameras) == 1:
            note = f"{path}: {_OAK_TITLE} of one camera, socket {sockets}."
            return RigCalibration(next(iter(cameras.values())).camera(), None, None, notes=(note,))
        raise RigError(
            f"{path}: expected calibrated cameras in the sockets {left} and {right}, found those of {sockets}"
            "; give the calibration of a camera with a stereo pair."
        )
    route = _route(cameras, left, right)
    if route is None:
        raise RigError(
            f"{path}: expected extrinsics from the socket {left} to {right}, found none; calibrate the device."
        )
    motion, kind, also = route.calibrated.copy(), "calibrated", ""
    lengths = [float(np.linalg.norm(transform[:3, 3])) * 0.01 for transform in route]
    if not lengths[0]:
        motion, kind = route.specified.copy(), "specified"
    elif lengths[1] and abs(lengths[0] / lengths[1] - 1) > _SPEC_DIFFERENCE:
        also = f" ({lengths[1]:.4g} m by its specification)"
    motion[:3, 3] *= 0.01
    device, length = quoted(file.productName or "a device"), float(np.linalg.norm(motion[:3, 3]))
    note = (
        f"{path}: {_OAK_TITLE} of {device}: sockets {left} (left) and {right} (right), lengths in centimetres; the "
        f"baseline is {length:.4f} m by its {kind} translation{also}."
    )
    rig = RigCalibration(cameras[left].camera(), cameras[right].camera(), motion, notes=(note,), metres_per_unit=0.01)
    # modes such as 720p of a sensor with 800 rows leave out rows at the top and at the bottom
    cropped = [_cropped(cameras[socket].camera()) for socket in (left, right)]
    if cropped[0] is None or cropped[1] is None:
        return rig
    crop_note = f"{path}: rows are left out at the top and the bottom of images in 16:9, as in the sensor's modes."
    return replace(rig, others=(replace(rig, left=cropped[0], right=cropped[1], notes=(note, crop_note)),))


def _cropped(camera: PinholeCamera) -> PinholeCamera | None:
    """The camera of the middle rows in 16:9; None for a camera whose images are not higher."""
    height_px = round(camera.width_px * 9 / 16)
    n_rows = (camera.height_px - height_px) / 2
    return replace(camera, cy_px=camera.cy_px - n_rows, height_px=height_px) if n_rows > 0 and height_px else None


def _route(cameras: Mapping[int, _OakCamera], start: int, goal: int) -> _Path | None:
    """The transforms from the camera in one socket to that in another, through others; None = no way."""
    steps: dict[int, list[tuple[int, _Path]]] = {socket: [] for socket in cameras}
    for socket, camera in cameras.items():
        to = camera.extrinsics.toCameraSocket
        if to not in cameras or len(camera.extrinsics.rotationMatrix) != 3:
            continue
        motions = []
        for translation in (camera.extrinsics.translation, camera.extrinsics.specTranslation):
            motion = np.eye(4)
            motion[:3, :3] = camera.extrinsics.rotationMatrix
            motion[:3, 3] = translation.array() * _OAK_UNITS_CM.get(camera.extrinsics.lengthUnit, 1.0)
            motions.append(motion)
        steps[socket].append((to, _Path(*motions)))
        steps[to].append((socket, _Path(*map(inverse_motion, motions))))
    routes = {start: _Path(np.eye(4), np.eye(4))}
    queue = [start]
    for socket in queue:
        for to, step in steps[socket]:
            if to not in routes:
                routes[to] = _Path(
                    step.calibrated @ routes[socket].calibrated, step.specified @ routes[socket].specified
                )
                queue.append(to)
    return routes.get(goal)


_RS_NUMBER = r"[-+]?\d+(?:\.\d+)?(?:[eE][-+]?\d+)?"
_RS_INTRINSIC = re.compile(
    r'Intrinsic of "(?P<stream>[^"\n]+)"[^\n]*\n(?P<body>(?:(?!\n\s*\n|Intrinsic of|Extrinsic from)[\s\S]){0,2000})'
)
_RS_EXTRINSIC = re.compile(
    r'Extrinsic from\s+"(?P<first>[^"\n]+)"\s+To\s+"(?P<second>[^"\n]+)"[\s:]*Rotation Matrix:'
    r"(?P<rotation>[-+\d.eE\s]{0,500})Translation Vector:(?P<translation>[-+\d.eE \t]{0,200})"
)
_RS_STREAMS = (("Infrared 1", "Infrared 2"), ("Infrared", "Infrared 2"), ("Fisheye 1", "Fisheye 2"))


def _read_realsense(text: str, path: Path) -> RigCalibration:
    """The two infrared cameras, for all resolutions of the output of rs-enumerate-devices -c."""
    intrinsics: dict[str, dict[tuple[int, int], PinholeCamera]] = {}
    for match in _RS_INTRINSIC.finditer(text):
        if (camera := _rs_camera(match["body"])) is not None:
            intrinsics.setdefault(match["stream"].strip(), {}).setdefault(camera.size_px, camera)
    motions = {}
    for match in _RS_EXTRINSIC.finditer(text):
        rotation, translation = (
            [float(number) for number in re.findall(_RS_NUMBER, match[group])] for group in ("rotation", "translation")
        )
        if len(rotation) == 9 and len(translation) == 3:
            motion = np.eye(4)
            motion[:3, :3], motion[:3, 3] = np.reshape(rotation, (3, 3)), translation
            motions[match["first"].strip(), match["second"].strip()] = motion
    for first, second in _RS_STREAMS:
        motion_or_none = motions.get((first, second))
        if motion_or_none is None and (second, first) in motions:
            motion_or_none = inverse_motion(motions[second, first])
        sizes = [size for size in intrinsics.get(first, {}) if size in intrinsics.get(second, {})]
        if motion_or_none is None or not sizes:
            continue
        note = (
            f'{path}: {_REALSENSE_TITLE}: "{first}" (left) and "{second}" (right), lengths in metres, images of '
            f"{', '.join(f'{width}x{height}' for width, height in sizes)} px."
        )
        rigs = [
            RigCalibration(intrinsics[first][size], intrinsics[second][size], motion_or_none, notes=(note,))
            for size in sizes
        ]
        return replace(rigs[0], others=tuple(rigs[1:]))
    raise RigError(
        f'{path}: expected intrinsics of "Infrared 1" and "Infrared 2" and the extrinsic between them, found those of '
        f"{quoted(', '.join(intrinsics) or 'none')}; write the file with rs-enumerate-devices -c > rig.txt."
    )


def _rs_camera(body: str) -> PinholeCamera | None:
    """The camera of the lines of one stream and size; None if it lacks a number."""
    values = {
        name: [float(number) for number in re.findall(_RS_NUMBER, match[1])]
        for name in ("Width", "Height", "PPX", "PPY", "Fx", "Fy", "Coeffs")
        if (match := re.search(rf"^\s*{name}\s*:([^\n]*)", body, re.MULTILINE | re.IGNORECASE))
    }
    if any(not values.get(name) for name in ("Width", "Height", "PPX", "PPY", "Fx", "Fy")):
        return None
    coefficients = values.get("Coeffs", [])
    is_fisheye = "kannala" in body.lower() or "f-theta" in body.lower()
    distortion = coefficients[:4] if is_fisheye else coefficients[:5] if any(coefficients) else []
    width, height, ppx, ppy, fx, fy = (values[name][0] for name in ("Width", "Height", "PPX", "PPY", "Fx", "Fy"))
    lens = KANNALA_BRANDT if is_fisheye and len(distortion) == 4 else PINHOLE
    return PinholeCamera(fx, fy, ppx, ppy, round(min(width, 1e6)), round(min(height, 1e6)), tuple(distortion), lens)


ZED = RigFormat(
    name="zed",
    title=_ZED_TITLE,
    recognises=lambda text: _ZED_SECTION.search(text) is not None,
    read=lambda text, path, _is_grey: _read_zed(text, path),
    missing=lambda _text, _path, _is_grey: "sections LEFT_CAM_HD and RIGHT_CAM_HD",
)
OAK = RigFormat(
    name="oak",
    title=_OAK_TITLE,
    recognises=lambda text: '"cameraData"' in text,
    read=lambda text, path, _is_grey: _read_oak(text, path),
    missing=lambda _text, _path, _is_grey: "cameraData of the left and the right socket",
)
REALSENSE = RigFormat(
    name="realsense",
    title=_REALSENSE_TITLE,
    recognises=lambda text: 'Intrinsic of "' in text or 'Extrinsic from "' in text,
    read=lambda text, path, _is_grey: _read_realsense(text, path),
    missing=lambda _text, _path, _is_grey: 'the stream "Infrared 2"',
)
