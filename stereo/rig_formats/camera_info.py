"""CameraInfo: the calibration of one camera in ROS (sensor_msgs/CameraInfo, foxglove.CameraCalibration); rigs of two.

P = [K' | K' t'],  x' = R x,  t' = (-baseline, 0, 0) for the right camera

x = point in the camera's frame, x' = in its rectified frame (http://docs.ros.org/en/api/sensor_msgs/html/msg/CameraInfo.html).
"""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import numpy as np

from track_range.foundation.arrays import FloatArray
from track_range.foundation.files.input_files import quoted
from track_range.stereo.geometry.camera import PinholeCamera
from track_range.stereo.geometry.lenses.kannala_brandt import KANNALA_BRANDT
from track_range.stereo.geometry.lenses.registry import PINHOLE
from track_range.stereo.geometry.rig import RigError, StereoRig
from track_range.stereo.geometry.rig_checks import NO_VERTICAL_PAIRS

_MODELS = ("", "plumb_bob", "rational_polynomial", "pinhole", "none")  # distortion models that are OpenCV's
_FISHEYE_MODELS = ("equidistant", "fisheye")  # distortion models that are OpenCV's fisheye model
_FOCAL_DIFFERENCE = 0.01  # largest relative difference of the focal lengths of two rectified cameras
_ROW_DIFFERENCE_PX = 2.0  # largest difference of their principal rows
_COEFFICIENTS = (0, 4, 5, 8, 12, 14)  # numbers of coefficients of OpenCV's model


@dataclass(frozen=True, slots=True)
class CameraInfo:
    """Calibration of one camera.

    Attributes:
        size_px: width and height of the images.
        model: name of the distortion model.
        distortion: its coefficients.
        k, r, p: camera matrix (3, 3), rotation to the rectified frame (3, 3), and projection matrix (3, 4).
    """

    size_px: tuple[int, int]
    model: str
    distortion: tuple[float, ...]
    k: FloatArray
    r: FloatArray
    p: FloatArray


def camera_of(message: CameraInfo, path: Path, *, is_rectified: bool) -> PinholeCamera:
    """The camera of a message: P for rectified images, K with distortion for raw ones.

    Raises RigError if unknown distortion model.
    """
    matrix = message.p[:, :3] if is_rectified else message.k
    width_px, height_px = message.size_px
    distortion = () if is_rectified else _distortion(message, path)
    is_fisheye = message.model in _FISHEYE_MODELS and not is_rectified
    return PinholeCamera(
        float(matrix[0, 0]),
        float(matrix[1, 1]),
        float(matrix[0, 2]),
        float(matrix[1, 2]),
        width_px,
        height_px,
        distortion,
        KANNALA_BRANDT.name if is_fisheye else PINHOLE,
    )


def rig_of(left: CameraInfo, right: CameraInfo, path: Path, *, is_rectified: bool) -> StereoRig:
    """The rig of two messages.

    Raises RigError if unknown distortion model, the messages contain no baseline, or contradict each other.
    """
    if not left.p[0, 0] or not right.p[0, 0]:
        raise RigError(f"{path}: expected projection matrices P in both calibrations, found zeros; give a rig.yaml.")
    # the origin of the rectified frames is that of the left camera in most recordings, in KITTI's that of another one
    offset_m = right.p[0, 3] / right.p[0, 0] - left.p[0, 3] / left.p[0, 0]
    if not offset_m:
        if left.p[1, 3] != right.p[1, 3]:
            raise RigError(
                f"{path}: expected cameras side by side, found one above the other (P[0, 3] is 0, P[1, 3] is not); "
                f"{NO_VERTICAL_PAIRS}."
            )
        raise RigError(
            f"{path}: expected a baseline, P[0, 3] = -f B of the right camera, found 0 in both matrices P; calibrate "
            "the cameras as a pair, or give a rig.yaml."
        )
    if is_rectified:
        _check_equal_projection(left, right, path)
    right_from_left = np.eye(4)
    right_from_left[0, 3] = offset_m
    if not is_rectified:
        rotation: FloatArray = right.r.T @ left.r
        right_from_left[:3, :3] = rotation
        right_from_left[:3, 3] = right.r.T @ np.array([offset_m, 0.0, 0.0])
    cameras = [camera_of(message, path, is_rectified=is_rectified) for message in (left, right)]
    return StereoRig(cameras[0], cameras[1], right_from_left)


def _check_equal_projection(left: CameraInfo, right: CameraInfo, path: Path) -> None:
    """Check that rectified images have equal focal lengths and rows."""
    focal_px = [(message.p[0, 0], message.p[1, 1]) for message in (left, right)]
    row_px = [message.p[1, 2] for message in (left, right)]
    if (
        not np.allclose(focal_px[0], focal_px[1], rtol=_FOCAL_DIFFERENCE)
        or abs(row_px[0] - row_px[1]) > _ROW_DIFFERENCE_PX
    ):
        raise RigError(
            f"{path}: expected equal focal lengths and principal rows in the matrices P of rectified images, found "
            f"{focal_px[0][0]:.6g} and {focal_px[1][0]:.6g} px, rows {row_px[0]:.6g} and {row_px[1]:.6g}; give a "
            "rig.yaml."
        )


def is_undistorted(message: CameraInfo) -> bool:
    """Whether the message describes rectified images: no distortion, and P equals K."""
    return (
        not any(message.distortion)
        and message.model not in _FISHEYE_MODELS
        and np.allclose(message.r, np.eye(3))
        and np.allclose(message.p[:, :3], message.k)
    )


def _distortion(message: CameraInfo, path: Path) -> tuple[float, ...]:
    if message.model in _FISHEYE_MODELS and len(message.distortion) == 4:
        return message.distortion
    if not any(message.distortion):
        return ()
    if message.model not in _MODELS or len(message.distortion) not in _COEFFICIENTS:
        raise RigError(
            f"{path}: expected a distortion model plumb_bob, rational_polynomial or equidistant, found "
            f"{quoted(message.model)} with {len(message.distortion)} coefficients; use rectified images, or give a "
            "rig.yaml."
        )
    return message.distortion
