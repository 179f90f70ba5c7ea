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

import math
import re
from collections import defaultdict
from collections.abc import Mapping
from dataclasses import replace
from pathlib import Path
from typing import Any

import cv2
import numpy as np
from pydantic import BaseModel, Field

from track_range.foundation.arrays import FloatArray
from track_range.foundation.files.input_files import quoted
from track_range.foundation.files.structured_text import parse_json
from track_range.foundation.validation import Integer, Number, validated
from track_range.stereo.geometry.camera import PinholeCamera
from track_range.stereo.geometry.lenses import KANNALA_BRANDT, PINHOLE
from track_range.stereo.geometry.rig import RigError, inverse_motion, rigid_motion
from track_range.stereo.geometry.rig_checks import RigCalibration
from track_range.stereo.rig_formats.rig_format import format_by_pattern
from track_range.stereo.rig_formats.values.containers import plain_values

_ZED_TITLE, _OAK_TITLE, _REALSENSE_TITLE = (
    "ZED's SN*.conf",
    "DepthAI's (OAK) calibration",
    "RealSense's calibration",
)
_ZED_SIZES = {  # (width, height) of the images of one side by the name of the mode
    "2K": (2208, 1242), "FHD": (1920, 1080), "FHD1200": (1920, 1200), "HD": (1280, 720), "SVGA": (960, 600),
    "VGA": (672, 376), "HD1080": (1920, 1080), "HD1200": (1920, 1200), "HD720": (1280, 720), "4K": (3840, 2160),
    "QHDPLUS": (3200, 1800),
}  # fmt: skip
_ZED_SECTION = re.compile(r"^[^\S\n]*\[LEFT_CAM_(\w+)\]", re.MULTILINE | re.IGNORECASE)
# depthai-core, LengthUnit: m, cm, mm, in, ft
_OAK_UNITS_M = {0: 1.0, 1: 0.01, 2: 0.001, 3: 0.0254, 4: 0.3048}
# relative difference of the baselines by calibration and by specification that is noted
_SPEC_DIFFERENCE = 0.05


def _read_zed(text: str, path: Path) -> RigCalibration:
    """The cameras of the first resolution, with the cameras of other resolutions as `others`."""
    values = {
        name.upper(): {
            key.lower(): value for key, value in section.items() if isinstance(value, float)
        }
        for name, section in plain_values(text, path, _ZED_TITLE).items()
        if isinstance(section, dict)
    }
    modes = [name.removeprefix("LEFT_CAM_") for name in values if name.startswith("LEFT_CAM_")]
    modes = [
        mode for mode in modes if mode in _ZED_SIZES and f"RIGHT_CAM_{mode}" in values
    ] or modes[:1]
    if not modes:
        raise RigError(
            f"{path}: expected sections such as LEFT_CAM_HD and RIGHT_CAM_HD, found none; download the file again from "
            "calib.stereolabs.com."
        )
    modes.sort(key=lambda mode: mode != "HD")  # the usual one first
    sizes = ", ".join("{}x{}".format(*_ZED_SIZES.get(mode, (0, 0))) for mode in modes)
    note = (
        f"{path}: {_ZED_TITLE}: lengths in millimetres; sections for images of {sizes} px. The images are taken to be "
        "unrectified, as recorded; each image of a pair has one of these sizes."
    )
    first, *others = [replace(_zed_mode(values, mode, path), notes=(note,)) for mode in modes]
    return replace(first, others=tuple(others))


def _zed_mode(values: Mapping[str, Mapping[str, float]], mode: str, path: Path) -> RigCalibration:
    cameras = []
    for side in ("LEFT", "RIGHT"):
        section = {**values.get(f"{side}_DISTO", {}), **values.get(f"{side}_CAM_{mode}", {})}
        missing = [name for name in ("fx", "fy", "cx", "cy") if name not in section]
        if missing:
            raise RigError(
                f"{path}: expected numbers {', '.join(missing)} in the section {side}_CAM_{mode}, found none; download "
                "the file again from calib.stereolabs.com."
            )
        coefficients = [
            section.get(name, 0.0) for name in ("k1", "k2", "p1", "p2", "k3", "k4", "k5", "k6")
        ]
        distortion = tuple(coefficients if any(coefficients[5:]) else coefficients[:5])
        focal = (section["fx"], section["fy"], section["cx"], section["cy"])
        cameras.append(PinholeCamera(*focal, *_ZED_SIZES.get(mode, (0, 0)), distortion))
    common = values.get("STEREO", {})
    stereo = defaultdict(float, common) | {  # values of the resolution before those of all
        name.removesuffix(f"_{mode.lower()}"): value
        for name, value in common.items()
        if name.endswith(f"_{mode.lower()}")
    }
    convergence = stereo["cv"] or stereo["ry"] or stereo["convergence"]
    rotation = cv2.Rodrigues(np.array([stereo["rx"], convergence, stereo["rz"]]))[0]
    position_mm = np.array([stereo[name] for name in ("baseline", "ty", "tz")])
    motion = rigid_motion(rotation, -position_mm * math.copysign(0.001, stereo["baseline"]) + 0.0)
    return RigCalibration(cameras[0], cameras[1], motion, metres_per_unit=0.001)


class _Point(BaseModel):
    x: Number = 0.0
    y: Number = 0.0
    z: Number = 0.0


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
        return PinholeCamera.of_matrix(
            self.intrinsicMatrix, (self.width, self.height), distortion, lens
        )


class _OakPair(BaseModel):
    leftCameraSocket: Integer = -1
    rightCameraSocket: Integer = -1


class _OakFile(BaseModel):
    cameraData: list[tuple[Integer, Any]] = Field(max_length=16)
    productName: str = ""
    stereoRectificationData: _OakPair = _OakPair()


def _read_oak(text: str, path: Path) -> RigCalibration:
    """The left and the right camera of an EEPROM, by its sockets."""
    content = parse_json(text, path, RigError, _OAK_TITLE)
    if isinstance(content, dict) and isinstance(content.get("cameraData"), dict):
        content["cameraData"] = list(content["cameraData"].items())
    file = validated(_OakFile, content, path, RigError)
    cameras = {}
    for socket, camera in file.cameraData:
        matrix = camera.get("intrinsicMatrix") if isinstance(camera, dict) else None
        # other sockets are empty, or not calibrated
        if isinstance(matrix, list) and len(matrix) == 3:
            cameras[socket] = validated(
                _OakCamera, camera, f"{path}: cameraData {socket}", RigError
            )
    pair = file.stereoRectificationData
    left, right = pair.leftCameraSocket, pair.rightCameraSocket
    if not {left, right} <= cameras.keys():
        left, right = 1, 2
    if not {left, right} <= cameras.keys():
        sockets = ", ".join(map(str, cameras)) or "none"
        if len(cameras) == 1:
            note = f"{path}: {_OAK_TITLE} of one camera, socket {sockets}."
            return RigCalibration(next(iter(cameras.values())).camera(), None, None, notes=(note,))
        raise RigError(
            f"{path}: expected calibrated cameras in the sockets {left} and {right}, found calibrations of the sockets "
            f"{sockets}; give the calibration of a camera with a stereo pair."
        )
    motion = _route(cameras, left, right, "translation")
    specified = _route(cameras, left, right, "specTranslation")
    if motion is None or specified is None:
        raise RigError(
            f"{path}: expected extrinsics from the socket {left} to {right}, found none; calibrate the device."
        )
    length_m, specified_m = (
        float(np.linalg.norm(transform[:3, 3])) for transform in (motion, specified)
    )
    reason = "calibrated translation"
    if not length_m:
        motion, length_m, reason = specified, specified_m, "specified translation"
    elif specified_m and abs(length_m / specified_m - 1) > _SPEC_DIFFERENCE:
        reason += f" ({specified_m:.4g} m in its specification)"
    note = (
        f"{path}: {_OAK_TITLE} of {quoted(file.productName or 'a device')}: sockets {left} (left) and {right} (right), "
        f"lengths in centimetres; the baseline is {length_m:.4f} m from its {reason}."
    )
    rig = RigCalibration(
        cameras[left].camera(), cameras[right].camera(), motion, notes=(note,), metres_per_unit=0.01
    )
    # modes such as 720p of a sensor with 800 rows leave out rows at the top and at the bottom
    cropped = [_cropped(cameras[socket].camera()) for socket in (left, right)]
    if cropped[0] is None or cropped[1] is None:
        return rig
    crop_note = f"{path}: images in 16:9 are taken to lack rows at the top and bottom, as in the sensor's modes."
    return replace(
        rig, others=(replace(rig, left=cropped[0], right=cropped[1], notes=(note, crop_note)),)
    )


def _cropped(camera: PinholeCamera) -> PinholeCamera | None:
    """The camera of the middle rows in 16:9; None for a camera whose images have no more rows."""
    height_px = round(camera.width_px * 9 / 16)
    n_rows = (camera.height_px - height_px) / 2
    return (
        replace(camera, cy_px=camera.cy_px - n_rows, height_px=height_px)
        if n_rows > 0 and height_px
        else None
    )


def _route(
    cameras: Mapping[int, _OakCamera], start: int, goal: int, translation: str
) -> FloatArray | None:
    """(4, 4) transform in metres from the camera in one socket to another, or via other sockets;
    None = unknown.
    """
    steps: dict[tuple[int, int], FloatArray] = {}
    for socket, camera in cameras.items():
        extrinsics, to = camera.extrinsics, camera.extrinsics.toCameraSocket
        if to in cameras and len(extrinsics.rotationMatrix) == 3:
            point, metres = (
                getattr(extrinsics, translation),
                _OAK_UNITS_M.get(extrinsics.lengthUnit, 0.01),
            )
            motion = rigid_motion(
                extrinsics.rotationMatrix, np.array([point.x, point.y, point.z]) * metres
            )
            steps.setdefault((socket, to), motion)
            steps.setdefault((to, socket), inverse_motion(motion))
    routes = {start: np.eye(4)}
    while goal not in routes and (
        further := {
            b: step @ routes[a] for (a, b), step in steps.items() if a in routes and b not in routes
        }
    ):
        routes |= further
    return routes.get(goal)


_RS_NUMBER = r"[-+]?\d+(?:\.\d+)?(?:[eE][-+]?\d+)?"
_RS_INTRINSIC = re.compile(
    r'Intrinsic of "(?P<stream>[^"\n]{1,100})"[^\n]{0,300}\n'
    r"(?P<body>(?:(?!\n\s*\n|Intrinsic of|Extrinsic from)[\s\S]){0,2000})"
)
_RS_EXTRINSIC = re.compile(
    r'Extrinsic from\s+"(?P<first>[^"\n]+)"\s+To\s+"(?P<second>[^"\n]+)"[\s:]*Rotation Matrix:'
    r"(?P<rotation>[-+\d.eE\s]{0,500})Translation Vector:(?P<translation>[-+\d.eE \t]{0,200})"
)
_RS_STREAMS = (("Infrared 1", "Infrared 2"), ("Infrared", "Infrared 2"), ("Fisheye 1", "Fisheye 2"))


def _read_realsense(text: str, path: Path) -> RigCalibration:
    """The two infrared cameras, for all resolutions of the output of rs-enumerate-devices -c."""
    intrinsics: dict[str, dict[tuple[int, int], PinholeCamera]] = defaultdict(dict)
    for match in _RS_INTRINSIC.finditer(text):
        if (camera := _rs_camera(match["body"])) is not None:
            intrinsics[match["stream"].strip()].setdefault(camera.size_px, camera)
    motions = {}
    for match in _RS_EXTRINSIC.finditer(text):
        rotation, translation = _rs_numbers(match["rotation"]), _rs_numbers(match["translation"])
        if len(rotation) == 9 and len(translation) == 3:
            motion = rigid_motion(np.reshape(rotation, (3, 3)), translation)
            streams = match["first"].strip(), match["second"].strip()
            motions[streams] = motion
            motions.setdefault(streams[::-1], inverse_motion(motion))
    for first, second in _RS_STREAMS:
        sizes = [size for size in intrinsics[first] if size in intrinsics[second]]
        if sizes and (first, second) in motions:
            note = (
                f'{path}: {_REALSENSE_TITLE}: "{first}" (left) and "{second}" (right), lengths in metres, images of '
                f"{', '.join(f'{width}x{height}' for width, height in sizes)} px."
            )
            pairs = ((intrinsics[first][size], intrinsics[second][size]) for size in sizes)
            rig, *others = [
                RigCalibration(*pair, motions[first, second], notes=(note,)) for pair in pairs
            ]
            return replace(rig, others=tuple(others))
    names = quoted(", ".join(stream for stream, cameras in intrinsics.items() if cameras) or "none")
    raise RigError(
        f'{path}: expected intrinsics of "Infrared 1" and "Infrared 2" and the extrinsic between them, found only '
        f"{names}; write the file with rs-enumerate-devices -c > rig.txt."
    )


def _rs_numbers(text: str) -> list[float]:
    return [float(number) for number in re.findall(_RS_NUMBER, text)]


def _rs_camera(body: str) -> PinholeCamera | None:
    """The camera of the lines of one stream and size; None if a number is missing."""
    lines = re.findall(r"^[^\S\n]*(\w+)\s*:([^\n]*)", body.lower(), re.MULTILINE)
    # of several lines, the first
    values = {name: _rs_numbers(line) for name, line in reversed(lines)}
    names = ("fx", "fy", "ppx", "ppy", "width", "height")
    if not all(values.get(name) for name in names):
        return None
    fx, fy, ppx, ppy, width, height = (values[name][0] for name in names)
    coefficients = values.get("coeffs", [])
    is_fisheye = "kannala" in body.lower() or "f-theta" in body.lower()
    distortion = coefficients[:4] if is_fisheye else coefficients[:5] if any(coefficients) else []
    lens = KANNALA_BRANDT if is_fisheye and len(distortion) == 4 else PINHOLE
    return PinholeCamera(
        fx, fy, ppx, ppy, round(min(width, 1e6)), round(min(height, 1e6)), tuple(distortion), lens
    )


ZED = format_by_pattern(
    "zed", _ZED_TITLE, _ZED_SECTION, _read_zed, "sections LEFT_CAM_HD and RIGHT_CAM_HD"
)
OAK = format_by_pattern(
    "oak",
    _OAK_TITLE,
    re.compile('"cameraData"'),
    _read_oak,
    "cameraData of the left and the right socket",
)
REALSENSE = format_by_pattern(
    "realsense",
    _REALSENSE_TITLE,
    re.compile('Intrinsic of "|Extrinsic from "'),
    _read_realsense,
    'the stream "Infrared 2"',
)
