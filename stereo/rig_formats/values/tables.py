"""Calibrations whose values have no names, but places: values by name of COLMAP, DSO, RobotCar,
mrcal and basalt.
"""

import re
from collections.abc import Mapping, Sequence
from typing import Any

import cv2
import numpy as np
from scipy.spatial.transform import Rotation

from track_range.stereo.geometry.rig import rigid_motion

_NUMBER = r"[-+]?(?:\d++(?:\.\d*+)?+|\.\d++)(?:[eE][-+]?\d{1,3})?+"
_COLMAP_ROW = (
    r"^[ \t]*+(\d++)[ \t]++([A-Z][A-Z_]++)[ \t]++(\d++)[ \t]++(\d++)[ \t]++([-+\d.eE \t]++)$"
)
# of FoundationStereo
K_AND_BASELINE = re.compile(
    rf"\A\s*+(?:{_NUMBER}[ \t]++){{8}}{_NUMBER}[ \t]*+\n\s*+{_NUMBER}\s*+\Z"
)
VIRTUAL_KITTI = re.compile(r"\A\s*+frame\s++cameraID\s++K\[0,0\]")  # head of its intrinsic.txt
COLMAP = re.compile(_COLMAP_ROW, re.MULTILINE)
DSO = re.compile(
    rf"\A\s*+([A-Za-z]*+)[ \t]*+((?:{_NUMBER}[ \t]++){{4,7}}{_NUMBER})[ \t]*+\r?\n\s*+(\d++)[ \t]++(\d++)[ \t]*+\r?\n"
    rf"[ \t]*+(?:crop|full|none|{_NUMBER}[ \t])"
)
ROBOTCAR = re.compile(
    rf"\A\s*+((?:{_NUMBER}[ \t]++){{3}}{_NUMBER})[ \t]*+\r?\n"
    rf"(?:(?:{_NUMBER}[ \t]++){{3}}{_NUMBER}[ \t]*+(?:\r?\n|\Z)){{4}}\s*+\Z"
)
MRCAL = re.compile(r"['\"]lensmodel['\"]\s*+:")
BASALT = re.compile(r'\A(?=[\s\S]*"T_imu_cam")[\s\S]*"camera_type"')
MRCAL_INPUTS = re.compile(r"['\"]optimization_inputs['\"][^\n]*")  # no YAML

_COLMAP_NAMES = {  # of the parameters of its models (colmap/src/colmap/sensor/models.h)
    "SIMPLE_PINHOLE": "f cx cy",
    "PINHOLE": "fx fy cx cy",
    "SIMPLE_RADIAL": "f cx cy k1",
    "RADIAL": "f cx cy k1 k2",
    "OPENCV": "fx fy cx cy k1 k2 p1 p2",
    "FULL_OPENCV": "fx fy cx cy k1 k2 p1 p2 k3 k4 k5 k6",
    "OPENCV_FISHEYE": "fx fy cx cy k1 k2 k3 k4",
    "SIMPLE_RADIAL_FISHEYE": "f cx cy k1",
    "RADIAL_FISHEYE": "f cx cy k1 k2",
    "SIMPLE_FISHEYE": "f cx cy",
    "FISHEYE": "fx fy cx cy",
}


def _numbers(text: str) -> list[float]:
    return [float(word) for word in re.findall(_NUMBER, text)]


def _foundation_stereo(text: str) -> dict[str, Any]:
    """K of rectified images, and a baseline."""
    *k, baseline = _numbers(text)
    return {"K": k, "baseline": baseline}


def _virtual_kitti(text: str) -> dict[str, Any]:
    """The first of the rows for frames and cameras."""
    rows = [line.split() for line in text.splitlines() if line.strip()][1:2]
    names = ("frame", "camera", "fx", "fy", "cx", "cy")
    return {name: word for row in rows for name, word in zip(names, row, strict=False)}


def _colmap(text: str) -> dict[str, Any]:
    """Cameras by their numbers: CAMERA_ID MODEL WIDTH HEIGHT PARAMS."""
    cameras = {}
    for number, model, width, height, params in COLMAP.findall(text):
        # an unknown model is refused by its name
        names = _COLMAP_NAMES.get(model, "f cx cy").split()
        values = dict(zip(names, _numbers(params), strict=False))
        cameras[number] = {"projection_model": model, "size": [int(width), int(height)], **values}
    return cameras


def _dso(text: str) -> dict[str, Any]:
    """One camera: MODEL fx fy cx cy terms, then the width and height; five numbers without a model
    are those of the FOV model, eight those of RadTan (DSO, Undistort.cpp).
    """
    model, words, width, height = DSO.findall(text)[0]
    numbers = _numbers(words)
    terms = numbers[4:]
    model = model or ("radtan" if len(terms) > 1 else "fov")
    is_ideal = len(terms) == 1 and not terms[0]
    return {
        "distortion_model": "none" if is_ideal else model,
        "intrinsics": numbers[:4],
        "distortion": terms if len(terms) > 1 else [],
        "size": [int(width), int(height)],
    }


def _robotcar(text: str) -> dict[str, Any]:
    """One camera: fx fy cx cy, then the transform to the frame of its images."""
    return {"intrinsics": _numbers(text)[:4]}


def of_mrcal(values: Mapping[str, Any]) -> dict[str, Any]:
    """One camera: fx fy cx cy and the terms in one list, and its pose by rotation vector and
    position.
    """
    intrinsics: Sequence[float] = values["intrinsics"]
    content = {
        "distortion_model": values["lensmodel"],
        "intrinsics": intrinsics[:4],
        "distortion": intrinsics[4:] if len(intrinsics) <= 18 else [],
        "size": values.get("imagersize"),
    }
    pose = np.array(values.get("extrinsics", ()), np.float64)
    if pose.shape == (6,):
        motion = rigid_motion(cv2.Rodrigues(pose[:3])[0], pose[3:])
        content["T_cam_ref"] = motion.ravel().tolist()
    return content


def of_basalt(values: Mapping[str, Any]) -> dict[str, Any]:
    """The cameras of the lists of poses, x_imu = T x_camera, of intrinsics and of sizes."""
    content = values["value0"]
    parts = zip(content["T_imu_cam"], content["intrinsics"], content["resolution"], strict=True)
    cameras = []
    for number, (pose, camera, size) in enumerate(parts):
        rotation = Rotation.from_quat([pose[name] for name in ("qx", "qy", "qz", "qw")]).as_matrix()
        motion = rigid_motion(rotation, [pose[name] for name in ("px", "py", "pz")])
        named = {"distortion_model": camera["camera_type"], "size": size, **camera["intrinsics"]}
        cameras.append({"name": f"cam{number}", **named, "T_imu_cam": motion.ravel().tolist()})
    return {"cameras": cameras}


# kinds of text, and their values by name
TABLES = (
    (K_AND_BASELINE, _foundation_stereo),
    (VIRTUAL_KITTI, _virtual_kitti),
    (COLMAP, _colmap),
    (DSO, _dso),
    (ROBOTCAR, _robotcar),
)
