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
from track_range.foundation.schemas.validation import Integer, Number, validated
from track_range.stereo.geometry.camera import PinholeCamera
from track_range.stereo.geometry.rig import RigError, inverse_motion, rigid_motion
from track_range.stereo.geometry.rig_checks import NamedCamera, RigCalibration
from track_range.stereo.lenses.lens import KANNALA_BRANDT, PINHOLE
from track_range.stereo.rig_formats.rig_format import format_by_pattern
from track_range.stereo.rig_formats.values.containers import plain_values
from track_range.stereo.rig_formats.values.lens_models import stated_lens

_ZED_TITLE = "ZED's SN*.conf"
_OAK_TITLE = "DepthAI's (OAK) calibration"
_REALSENSE_TITLE = "RealSense's calibration"
_ZED_SIZES = {  # (width, height) of the images of one side by the name of the mode
    "2K": (2208, 1242), "FHD": (1920, 1080), "FHD1200": (1920, 1200), "HD": (1280, 720), "SVGA": (960, 600),
    "VGA": (672, 376), "HD1080": (1920, 1080), "HD1200": (1920, 1200), "HD720": (1280, 720), "4K": (3840, 2160),
    "QHDPLUS": (3200, 1800),
}  # fmt: skip
_ZED_SECTION = re.compile(r"^[^\S\n]*\[LEFT_CAM_(\w+)\]", re.MULTILINE | re.IGNORECASE)
_OAK_SOCKETS = (1, 2)  # usual ones of the left and the right camera
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
    stated = [name.removeprefix("LEFT_CAM_") for name in values if name.startswith("LEFT_CAM_")]
    if not stated:
        raise RigError(
            f"{path}: expected sections such as LEFT_CAM_HD and RIGHT_CAM_HD, found none; download "
            "the file again from calib.stereolabs.com."
        )
    known = [mode for mode in stated if mode in _ZED_SIZES and f"RIGHT_CAM_{mode}" in values]
    modes = known or stated[:1]
    modes.sort(key=lambda mode: mode != "HD")  # the usual one first
    sizes = ", ".join("{}x{}".format(*_ZED_SIZES.get(mode, (0, 0))) for mode in modes)
    note = (
        f"{path}: {_ZED_TITLE}: lengths in millimetres; sections for images of {sizes} px. The "
        "images are taken to be unrectified, as recorded; each image of a pair has one of these "
        "sizes."
    )
    first, *others = [replace(_zed_mode(values, mode, path), notes=(note,)) for mode in modes]
    return replace(first, others=tuple(others))


def _zed_mode(values: Mapping[str, Mapping[str, float]], mode: str, path: Path) -> RigCalibration:
    left, right = (_zed_camera(values, side, mode, path) for side in ("LEFT", "RIGHT"))
    common = values.get("STEREO", {})
    if "baseline" not in common:
        cameras = (NamedCamera("left", left), NamedCamera("right", right))
        return RigCalibration(left, None, None, cameras=cameras)
    ending = f"_{mode.lower()}"
    of_mode = {
        name.removesuffix(ending): value for name, value in common.items() if name.endswith(ending)
    }
    stereo = defaultdict(float, common) | of_mode  # values of the resolution before those of all
    convergence = stereo["cv"] or stereo["ry"] or stereo["convergence"]
    rotation = cv2.Rodrigues(np.array([stereo["rx"], convergence, stereo["rz"]]))[0]
    position_mm = np.array([stereo[name] for name in ("baseline", "ty", "tz")])
    motion = rigid_motion(rotation, -position_mm * math.copysign(0.001, stereo["baseline"]) + 0.0)
    return RigCalibration(left, right, motion, metres_per_unit=0.001)


def _zed_camera(
    values: Mapping[str, Mapping[str, float]], side: str, mode: str, path: Path
) -> PinholeCamera:
    section = {**values.get(f"{side}_DISTO", {}), **values.get(f"{side}_CAM_{mode}", {})}
    missing = [name for name in ("fx", "fy", "cx", "cy") if name not in section]
    if missing:
        raise RigError(
            f"{path}: expected numbers {', '.join(missing)} in the section {side}_CAM_{mode}, "
            "found none; download the file again from calib.stereolabs.com."
        )
    names = ("k1", "k2", "p1", "p2", "k3", "k4", "k5", "k6")
    coefficients = [section.get(name, 0.0) for name in names]
    distortion = tuple(coefficients if any(coefficients[5:]) else coefficients[:5])
    focal = (section["fx"], section["fy"], section["cx"], section["cy"])
    return PinholeCamera(*focal, *_ZED_SIZES.get(mode, (0, 0)), distortion)


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
    cameras = _oak_cameras(file, path)
    sockets = _oak_sockets(file, cameras)
    if sockets is None:
        if len(cameras) == 1:
            ((socket, camera),) = cameras.items()
            note = f"{path}: {_OAK_TITLE} of one camera, socket {socket}."
            return RigCalibration(camera.camera(), None, None, notes=(note,))
        left, right = _OAK_SOCKETS
        raise RigError(
            f"{path}: expected calibrated cameras in the sockets {left} and {right}, found "
            f"calibrations of the sockets {', '.join(map(str, cameras)) or 'none'}; give the "
            "calibration of a camera with a stereo pair."
        )
    left, right = sockets
    motion, baseline = _oak_motion(cameras, left, right, path)
    known = tuple(
        NamedCamera(
            f"CAM_{chr(ord('A') + socket)}", camera, _route(cameras, left, socket, "translation")
        )
        for socket, one in cameras.items()
        for camera in filter(None, (one.camera(), _cropped(one.camera())))
    )
    note = (
        f"{path}: {_OAK_TITLE} of {quoted(file.productName or 'a device')}: sockets {left} (left) "
        f"and {right} (right), lengths in centimetres; the baseline is {baseline}."
    )
    rig = RigCalibration(
        cameras[left].camera(), cameras[right].camera(), motion, notes=(note,), metres_per_unit=0.01
    )
    rig = replace(rig, cameras=known)
    return _with_cropped(rig, path)


def _oak_cameras(file: _OakFile, path: Path) -> dict[int, _OakCamera]:
    """The calibrated cameras by socket."""
    cameras = {}
    for socket, camera in file.cameraData:
        matrix = camera.get("intrinsicMatrix") if isinstance(camera, dict) else None
        # other sockets are empty, or not calibrated
        if isinstance(matrix, list) and len(matrix) == 3:
            name = f"{path}: cameraData {socket}"
            cameras[socket] = validated(_OakCamera, camera, name, RigError)
    return cameras


def _oak_sockets(file: _OakFile, cameras: Mapping[int, _OakCamera]) -> tuple[int, int] | None:
    """The sockets of the left and the right camera, as stated, else the usual ones; None if they
    have no cameras.
    """
    stated = file.stereoRectificationData
    for pair in ((stated.leftCameraSocket, stated.rightCameraSocket), _OAK_SOCKETS):
        if set(pair) <= cameras.keys():
            return pair
    return None


def _oak_motion(
    cameras: Mapping[int, _OakCamera], left: int, right: int, path: Path
) -> tuple[FloatArray, str]:
    """(4, 4) transform from the left camera to the right one, and its baseline with the source, for
    messages.
    """
    motion = _route(cameras, left, right, "translation")
    specified = _route(cameras, left, right, "specTranslation")
    if motion is None or specified is None:
        raise RigError(
            f"{path}: expected extrinsics from the socket {left} to {right}, found none; calibrate "
            "the device."
        )
    length_m = float(np.linalg.norm(motion[:3, 3]))
    specified_m = float(np.linalg.norm(specified[:3, 3]))
    if not length_m:
        return specified, f"{specified_m:.4f} m from its specified translation"
    baseline = f"{length_m:.4f} m from its calibrated translation"
    if specified_m and abs(length_m / specified_m - 1) > _SPEC_DIFFERENCE:
        baseline += f" ({specified_m:.4g} m in its specification)"
    return motion, baseline


def _with_cropped(rig: RigCalibration, path: Path) -> RigCalibration:
    """The rig with the cameras of images in 16:9 as `others`: modes such as 720p of a sensor with
    800 rows leave out rows at the top and at the bottom.
    """
    left = _cropped(rig.left)
    right = None if rig.right is None else _cropped(rig.right)
    if left is None or right is None:
        return rig
    note = (
        f"{path}: images in 16:9 are taken to lack rows at the top and bottom, as in the sensor's "
        "modes."
    )
    cropped = replace(rig, left=left, right=right, notes=(*rig.notes, note))
    return replace(rig, others=(cropped,))


def _cropped(camera: PinholeCamera) -> PinholeCamera | None:
    """The camera of the middle rows in 16:9; None for a camera whose images have no more rows."""
    height_px = round(camera.width_px * 9 / 16)
    n_rows = (camera.height_px - height_px) / 2
    if n_rows <= 0 or not height_px:
        return None
    return replace(camera, cy_px=camera.cy_px - n_rows, height_px=height_px)


def _route(
    cameras: Mapping[int, _OakCamera], start: int, goal: int, translation: str
) -> FloatArray | None:
    """(4, 4) transform in metres from the camera in one socket to another, or via other sockets;
    None = unknown.
    """
    steps: dict[tuple[int, int], FloatArray] = {}
    for socket, camera in cameras.items():
        extrinsics = camera.extrinsics
        to = extrinsics.toCameraSocket
        if to in cameras and len(extrinsics.rotationMatrix) == 3:
            point = getattr(extrinsics, translation)
            metres = _OAK_UNITS_M.get(extrinsics.lengthUnit, 0.01)
            position_m = np.array([point.x, point.y, point.z]) * metres
            motion = rigid_motion(extrinsics.rotationMatrix, position_m)
            steps.setdefault((socket, to), motion)
            steps.setdefault((to, socket), inverse_motion(motion))
    routes = {start: np.eye(4)}
    while goal not in routes:
        further = {
            b: step @ routes[a] for (a, b), step in steps.items() if a in routes and b not in routes
        }
        if not further:
            return None
        routes |= further
    return routes[goal]


_RS_NUMBER = r"[-+]?\d+(?:\.\d+)?(?:[eE][-+]?\d+)?"
_RS_INTRINSIC = re.compile(
    r'Intrinsic of "(?P<stream>[^"\n]{1,100})"[^\n]{0,300}\n'
    r"(?P<body>(?:(?!\n\s*\n|Intrinsic of|Extrinsic from)[\s\S]){0,2000})"
)
_RS_EXTRINSIC = re.compile(
    r'Extrinsic from\s+"(?P<first>[^"\n]+)"\s+To\s+"(?P<second>[^"\n]+)"[\s:]*Rotation Matrix:'
    r"(?P<rotation>[-+\d.eE\s]{0,500})Translation Vector:(?P<translation>[-+\d.eE \t]{0,200})"
)
_RS_MODEL = re.compile(r"^[^\S\n]*(?:Distortion|Model)\s*:([^\n]+)", re.MULTILINE)
_RS_STREAMS = (("Infrared 1", "Infrared 2"), ("Infrared", "Infrared 2"), ("Fisheye 1", "Fisheye 2"))


_RsCameras = Mapping[tuple[int, int], PinholeCamera]  # of one stream, by size


def _read_realsense(text: str, path: Path) -> RigCalibration:
    """The two infrared cameras, for all resolutions of the output of rs-enumerate-devices -c."""
    cameras = _rs_cameras(text, path)
    motions = _rs_motions(text)
    known = tuple(
        NamedCamera(
            stream,
            camera,
            np.eye(4) if motions and stream == "Depth" else motions.get(("Depth", stream)),
        )
        for stream, of_size in cameras.items()
        for camera in of_size.values()
    )
    for first, second in _RS_STREAMS:
        lefts, rights = cameras.get(first, {}), cameras.get(second, {})
        sizes = [size for size in lefts if size in rights]
        if not sizes or (first, second) not in motions:
            continue
        listed = ", ".join(f"{width}x{height}" for width, height in sizes)
        note = (
            f'{path}: {_REALSENSE_TITLE}: "{first}" (left) and "{second}" (right), lengths in '
            f"metres, images of {listed} px."
        )
        motion = motions[first, second]
        rig, *others = [
            RigCalibration(lefts[size], rights[size], motion, notes=(note,)) for size in sizes
        ]
        return replace(rig, others=tuple(others), cameras=known)
    if known:
        return RigCalibration(known[0].camera, None, None, cameras=known)
    streams = quoted(", ".join(cameras) or "none")
    raise RigError(
        f'{path}: expected intrinsics of "Infrared 1" and "Infrared 2" and the extrinsic between '
        f"them, found only {streams}; write the file with rs-enumerate-devices -c > rig.txt."
    )


def _rs_cameras(text: str, path: Path) -> dict[str, _RsCameras]:
    """The cameras of each stream; of several with one size, the first."""
    cameras: dict[str, dict[tuple[int, int], PinholeCamera]] = {}
    for match in _RS_INTRINSIC.finditer(text):
        camera = _rs_camera(match["body"], path)
        if camera is not None:
            cameras.setdefault(match["stream"].strip(), {}).setdefault(camera.size_px, camera)
    return dict(cameras)


def _rs_motions(text: str) -> dict[tuple[str, str], FloatArray]:
    """(4, 4) transforms from one stream's camera to another's, and their inverses."""
    motions = {}
    for match in _RS_EXTRINSIC.finditer(text):
        rotation = _rs_numbers(match["rotation"])
        translation = _rs_numbers(match["translation"])
        if len(rotation) == 9 and len(translation) == 3:
            motion = rigid_motion(np.reshape(rotation, (3, 3)), translation)
            first, second = match["first"].strip(), match["second"].strip()
            motions[first, second] = motion
            motions.setdefault((second, first), inverse_motion(motion))
    return motions


def _rs_numbers(text: str) -> list[float]:
    return [float(number) for number in re.findall(_RS_NUMBER, text)]


def _rs_camera(body: str, path: Path) -> PinholeCamera | None:
    """The camera of the lines of one stream and size; None if a number is missing."""
    lines = re.findall(r"^[^\S\n]*(\w+)\s*:([^\n]*)", body.lower(), re.MULTILINE)
    # of several lines, the first
    values = {name: _rs_numbers(line) for name, line in reversed(lines)}
    names = ("fx", "fy", "ppx", "ppy", "width", "height")
    if not all(values.get(name) for name in names):
        return None
    fx, fy, ppx, ppy, width, height = (values[name][0] for name in names)
    coefficients = values.get("coeffs", [])
    model = _RS_MODEL.search(body)
    stated = None if model is None else stated_lens({"Distortion": model[1].strip()}, path)
    is_fisheye = stated is not None and stated[0] == KANNALA_BRANDT
    distortion = coefficients[: 4 if is_fisheye else 5]
    if not is_fisheye and not any(coefficients):
        distortion = []
    lens = KANNALA_BRANDT if is_fisheye and len(distortion) == 4 else PINHOLE
    size_px = round(min(width, 1e6)), round(min(height, 1e6))
    return PinholeCamera(fx, fy, ppx, ppy, *size_px, tuple(distortion), lens)


ZED = format_by_pattern(
    "zed", _ZED_TITLE, _ZED_SECTION, _read_zed, "a section STEREO with Baseline"
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
    'the extrinsic from "Infrared 1" to "Infrared 2" (rs-enumerate-devices -c > rig.txt)',
)
