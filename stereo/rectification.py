"""Rectifier: turns two images so that each point of the world lies in the same row of both; Undistorter: one image.

Both cameras are turned, about their own centres, until their x axes run along the baseline and their image planes
coincide (Bouguet's method, OpenCV's stereoRectify); the lens terms go in the same step. Distances of the rectified pair
are measured along the turned left camera's z axis.
"""

from __future__ import annotations

import math

import cv2
import numpy as np
import numpy.typing as npt

from stereo.camera import PinholeCamera
from stereo.frames import Image
from stereo.rig import RigError, StereoRig
from stereo.rig_checks import check_rig

FloatArray = npt.NDArray[np.float64]
Maps = tuple[npt.NDArray[np.int16], npt.NDArray[np.uint16]]

_MAX_TURN_RAD = math.radians(45.0)
"""Cameras turned further towards each other than this share hardly any view: the calibration is wrong."""

_MAX_ZOOM = 4.0
"""Largest change of the focal length that lens terms of a sane calibration cause."""


class Rectifier:
    """Rectifies the pairs of one rig.

    Attributes:
        rig: the rectified rig that the images which come out seem to be taken with.
    """

    def __init__(self, rig: StereoRig) -> None:
        """Work out the maps.

        Raises:
            RigError: the rig is implausible, its eyes stand one above the other, or one of them is upside down.
        """
        check_rig(rig, "the rig")
        self.rig = rig
        self._size_px = (rig.left.width_px, rig.left.height_px)
        self._right_size_px = (rig.right.width_px, rig.right.height_px)
        self._maps: tuple[Maps, Maps] | None = None
        if not rig.is_rectified:
            self.rig, self._maps = _rectified(rig)

    def rectify(self, left: Image, right: Image) -> tuple[Image, Image]:
        """Both images, (H, W) or (H, W, 3), rectified; the same arrays where the rig is rectified already.

        Pixels that no camera saw are black.

        Raises:
            ValueError: an image has another size than its camera.
        """
        _check_size(left, self._size_px, "left")
        _check_size(right, self._right_size_px, "right")
        if self._maps is None:
            return left, right
        return _remapped(left, self._maps[0]), _remapped(right, self._maps[1])


class Undistorter:
    """Takes the lens terms out of the images of one camera.

    Attributes:
        camera: the ideal camera that the images which come out seem to be taken with; its matrix is the same.
    """

    def __init__(self, camera: PinholeCamera) -> None:
        self.camera = camera.without_distortion()
        self._size_px = (camera.width_px, camera.height_px)
        self._maps = _maps(camera, np.eye(3), camera.matrix, self._size_px) if camera.is_distorted else None

    def undistort(self, image: Image) -> Image:
        """The image, (H, W) or (H, W, 3), without distortion; the same array where there is none.

        Raises:
            ValueError: the image has another size than the camera.
        """
        _check_size(image, self._size_px, "image")
        return image if self._maps is None else _remapped(image, self._maps)


def _rectified(rig: StereoRig) -> tuple[StereoRig, tuple[Maps, Maps]]:
    """The rectified rig, and the maps of its left and right image."""
    _check_rotation(rig.right_from_left[:3, :3])
    size_px = (rig.left.width_px, rig.left.height_px)
    left_turn, right_turn, left_projection, right_projection, *_ = cv2.stereoRectify(
        rig.left.matrix,
        _lens_terms(rig.left),
        rig.right.matrix,
        _lens_terms(rig.right),
        size_px,
        rig.right_from_left[:3, :3],
        rig.right_from_left[:3, 3:],
        flags=cv2.STEREO_ZERO_DISPARITY,
        alpha=0,  # no black borders where the lenses allow it
    )
    focal_px = float(left_projection[0, 0])
    _check_turn(left_turn, right_turn, right_projection)
    _check_zoom(focal_px, rig.left)
    baseline_m = -float(right_projection[0, 3]) / focal_px
    camera = PinholeCamera(focal_px, focal_px, float(left_projection[0, 2]), float(left_projection[1, 2]), *size_px)
    left = _maps(rig.left, left_turn, left_projection, size_px)
    right = _maps(rig.right, right_turn, right_projection, size_px)
    return StereoRig.rectified(camera, baseline_m), (left, right)


def _check_rotation(right_from_left: FloatArray) -> None:
    angle_rad = _angle_rad(right_from_left)
    if angle_rad > _MAX_TURN_RAD:
        raise RigError(
            f"the rig: its cameras are turned against each other by {math.degrees(angle_rad):.0f} degrees (one upside "
            "down, or looking elsewhere); check the rotation, or calibrate again."
        )


def _angle_rad(rotation: cv2.typing.MatLike) -> float:
    return math.acos(float(np.clip((np.trace(rotation) - 1) / 2, -1.0, 1.0)))


def _check_turn(left_turn: cv2.typing.MatLike, right_turn: cv2.typing.MatLike, projection: cv2.typing.MatLike) -> None:
    if abs(float(projection[1, 3])) > abs(float(projection[0, 3])):
        raise RigError("the rig: its eyes stand one above the other; a pair side by side is wanted.")
    for eye, turn in (("left", left_turn), ("right", right_turn)):
        if _angle_rad(turn) > _MAX_TURN_RAD:
            raise RigError(
                f"the rig: the {eye} camera would have to be turned by {math.degrees(_angle_rad(turn)):.0f} degrees to "
                "look across the baseline; check the translation, or calibrate again."
            )


def _check_zoom(focal_px: float, camera: PinholeCamera) -> None:
    zoom = focal_px / camera.fx_px
    if not 1 / _MAX_ZOOM <= zoom <= _MAX_ZOOM:
        raise RigError(f"the rig: rectifying would zoom by {zoom:.2g}; the lens terms are wrong, calibrate again.")


def _maps(camera: PinholeCamera, turn: cv2.typing.MatLike, new: cv2.typing.MatLike, size_px: tuple[int, int]) -> Maps:
    """Where each pixel of the new image comes from, in OpenCV's fixed-point form (1/32 px), its fastest."""
    whole, fraction = cv2.initUndistortRectifyMap(
        camera.matrix, _lens_terms(camera), turn, new[:, :3], size_px, cv2.CV_16SC2
    )
    return np.asarray(whole, np.int16), np.asarray(fraction, np.uint16)


def _lens_terms(camera: PinholeCamera) -> FloatArray:
    return np.array(camera.distortion or (0.0,) * 5)


def _remapped(image: Image, maps: Maps) -> Image:
    return np.asarray(cv2.remap(image, maps[0], maps[1], cv2.INTER_LINEAR), np.uint8)


def _check_size(image: Image, size_px: tuple[int, int], name: str) -> None:
    if (image.shape[1], image.shape[0]) != size_px:
        got = f"{image.shape[1]}x{image.shape[0]}"
        raise ValueError(f"{name}: {size_px[0]}x{size_px[1]} px wanted, {got} got")
