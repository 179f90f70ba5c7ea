"""What a calibration must fulfil before metres are computed from it, and how it is fitted to an image size.

A wrong calibration gives wrong metres said with confidence; so each check here refuses with the value that it found.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, replace

import numpy as np

from track_range.foundation.arrays import FloatArray
from track_range.stereo.geometry.camera import PinholeCamera
from track_range.stereo.geometry.rig import RigError, StereoRig

BASELINE_M = (0.01, 5.0)
"""Plausible distance between the two eyes."""

_FOCAL_PER_WIDTH = (0.1, 20.0)
"""Plausible focal length as a multiple of the image's width: 157 degrees .. 3 degrees of view."""

_ROTATION_TOLERANCE = 1e-3
"""Largest deviation of R^T R from the identity; files carry six digits or more."""

_CROPPED_PX = 2
"""Rows or columns that video codecs need cut off."""

_ASPECT_TOLERANCE = 0.01

_LENS_TERMS = (0, 4, 5, 8, 12, 14)
"""Numbers of lens terms that OpenCV's model has."""


@dataclass(frozen=True, slots=True)
class Calibration:
    """What a file says, in whichever format.

    Attributes:
        left: the left (or only) camera; width_px = height_px = 0 where the file gives no size.
        right: the right camera; None where the file has one camera only.
        right_from_left: (4, 4) rigid motion, metres; None where `right` is.
        left_from_reference_m: (3,) shift that takes points of the frame that the data set's labels are given in into
            the left camera's; zeros but for KITTI.
        notes: sentences for the user.
    """

    left: PinholeCamera
    right: PinholeCamera | None
    right_from_left: FloatArray | None
    left_from_reference_m: tuple[float, float, float] = (0.0, 0.0, 0.0)
    notes: tuple[str, ...] = ()


def check_rig(rig: StereoRig, source: object) -> None:
    """Refuse a rig that cannot be right; `source` names it in the message.

    Raises:
        RigError: focal length, lens terms, rotation or baseline are not plausible.
    """
    check_camera(rig.left, f"{source}: left")
    check_camera(rig.right, f"{source}: right")
    if not np.isfinite(rig.right_from_left).all():
        raise RigError(f"{source}: right_from_left holds a number that is not finite; calibrate again.")
    rotation = rig.right_from_left[:3, :3]
    deviation = float(np.abs(rotation.T @ rotation - np.eye(3)).max())
    if deviation > _ROTATION_TOLERANCE or np.linalg.det(rotation) < 0:
        raise RigError(
            f"{source}: the rotation of right_from_left is none (R^T R differs from the identity by {deviation:.3g}, "
            f"determinant {np.linalg.det(rotation):.3g}); give the 3 x 3 matrix row by row."
        )
    x_m, y_m, _ = rig.right_from_left[:3, 3]
    if abs(y_m) > abs(x_m):
        raise RigError(
            f"{source}: the eyes stand one above the other ({y_m:.3g} m in y, {x_m:.3g} m in x); "
            "only eyes side by side can be used."
        )
    _check_baseline(rig.baseline_m, source)


def _check_baseline(baseline_m: float, source: object) -> None:
    low, high = BASELINE_M
    if baseline_m == 0:
        raise RigError(f"{source}: the baseline is 0 m; two eyes at one place see no distance, give their shift.")
    if low <= baseline_m <= high:
        return
    if low <= -baseline_m <= high:
        raise RigError(
            f"{source}: the baseline is {baseline_m:.6g} m: the right camera stands left of the left one; "
            "swap left and right in it."
        )
    raise RigError(
        f"{source}: the baseline is {baseline_m:.6g} m, which is not within {low:g} .. {high:g} m; "
        "is it in millimetres, or in squares of the chessboard? Give it in metres."
    )


def check_camera(camera: PinholeCamera, source: object) -> None:
    """Refuse a camera that cannot be right.

    Raises:
        RigError: focal length, principal point or lens terms are not plausible.
    """
    for name, focal_px in (("fx_px", camera.fx_px), ("fy_px", camera.fy_px)):
        if not (math.isfinite(focal_px) and focal_px > 0):
            raise RigError(f"{source}: the focal length {name} is {focal_px:g}; a positive number of pixels is wanted.")
        low, high = (share * max(camera.width_px, 1) for share in _FOCAL_PER_WIDTH)
        if camera.width_px and not low <= focal_px <= high:
            raise RigError(
                f"{source}: the focal length {name} is {focal_px:g} for an image {camera.width_px} px wide; "
                "is it in millimetres? Give it in pixels."
            )
    if not (math.isfinite(camera.cx_px) and math.isfinite(camera.cy_px)):
        raise RigError(f"{source}: the principal point is ({camera.cx_px:g}, {camera.cy_px:g}); give it in pixels.")
    if camera.width_px and not (0 <= camera.cx_px <= camera.width_px and 0 <= camera.cy_px <= camera.height_px):
        raise RigError(
            f"{source}: the principal point ({camera.cx_px:g}, {camera.cy_px:g}) lies outside the image of "
            f"{camera.width_px}x{camera.height_px} px."
        )
    terms = camera.distortion
    if len(terms) not in _LENS_TERMS or not all(math.isfinite(term) for term in terms):
        raise RigError(f"{source}: the distortion is {list(terms)}; 0, 4, 5, 8, 12 or 14 finite numbers are wanted.")


def fitted_to_size(
    camera: PinholeCamera, size_px: tuple[int, int], source: object
) -> tuple[PinholeCamera, tuple[str, ...]]:
    """The camera for images of `size_px` = (width, height), and notes for the user.

    A size that the calibration gives may differ by the rows or columns that a codec cuts off; otherwise the camera is
    scaled, if the aspect agrees. Where it gives none, the principal point must lie in the image's middle third.

    Raises:
        RigError: the calibration is for other images.
    """
    width, height = size_px
    if camera.width_px == 0:
        _check_principal_point(camera, size_px, source)
        return replace(camera, width_px=width, height_px=height), ()
    given = (camera.width_px, camera.height_px)
    if 0 <= given[0] - width <= _CROPPED_PX and 0 <= given[1] - height <= _CROPPED_PX:
        return replace(camera, width_px=width, height_px=height), ()
    scale_x, scale_y = width / given[0], height / given[1]
    if abs(scale_x / scale_y - 1) > _ASPECT_TOLERANCE:
        raise RigError(
            f"{source}: it is for images of {given[0]}x{given[1]} px, but these are {width}x{height} px, of another "
            "aspect; give the calibration of these images."
        )
    scaled = _scaled(camera, scale_x, scale_y)
    note = f"{source}: scaled from {given[0]}x{given[1]} px to the images' {width}x{height} px."
    return replace(scaled, width_px=width, height_px=height), (note,)


def _scaled(camera: PinholeCamera, scale_x: float, scale_y: float) -> PinholeCamera:
    """The camera of resized images; pixel areas map onto pixel areas, hence the half pixels."""
    return replace(
        camera,
        fx_px=camera.fx_px * scale_x,
        fy_px=camera.fy_px * scale_y,
        cx_px=(camera.cx_px + 0.5) * scale_x - 0.5,
        cy_px=(camera.cy_px + 0.5) * scale_y - 0.5,
    )


def _check_principal_point(camera: PinholeCamera, size_px: tuple[int, int], source: object) -> None:
    width, height = size_px
    if not (width / 3 <= camera.cx_px <= width * 2 / 3 and height / 3 <= camera.cy_px <= height * 2 / 3):
        raise RigError(
            f"{source}: its principal point ({camera.cx_px:.1f}, {camera.cy_px:.1f}) is not in the middle third of "
            f"these {width}x{height} px images, so it belongs to others; give the calibration of these images."
        )
