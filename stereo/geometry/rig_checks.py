"""Plausibility checks of calibrations.

A wrong calibration silently gives wrong distances, so implausible values are errors.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Annotated, NamedTuple

import numpy as np
from pydantic import Field

from track_range.foundation.arrays import FloatArray
from track_range.foundation.files.input_files import quoted, shortened
from track_range.foundation.schemas.validation import Integer
from track_range.stereo.geometry.camera import PinholeCamera
from track_range.stereo.geometry.image_size import has_aspect_of, is_size_of
from track_range.stereo.geometry.mounting import Mounting
from track_range.stereo.geometry.rig import (
    RigAccuracy,
    RigError,
    RoadCalibration,
    StereoRig,
    rigid_motion,
)
from track_range.stereo.lenses.registry import LENSES

BASELINE_M = (0.01, 5.0)  # plausible range of the baseline, metres
# largest plausible width or height of an image, pixels; four times that of 8K video
MAX_SIDE_PX = 32768
# width or height of an image in a calibration file, pixels
ImageSide = Annotated[Integer, Field(ge=1, le=MAX_SIDE_PX)]
# plausible focal length / image width: fields of view from 157 to 3 degrees
_FOCAL_PER_WIDTH = (0.1, 20.0)
# largest deviation of R^T R from the identity; calibration files have six digits or more
_ROTATION_TOLERANCE = 1e-3
# largest magnitude of a number in a transform that is compared with the limits
_MAX_TRANSFORM = 1e6
# largest plausible magnitude of a distortion coefficient; badly conditioned fits reach thousands
_MAX_DISTORTION = 1e6
# largest plausible magnitude of a principal point in a file without an image size
_MAX_PRINCIPAL_POINT_PX = 1e6
# smallest distance of a principal point from the border / side; cropped images have small ones
_MIN_MARGIN = 0.01
# possible numbers of distortion coefficients in OpenCV's model
_N_DISTORTION_COEFFICIENTS = (0, 4, 5, 8, 12, 14)
# description of them for messages
_COEFFICIENTS = "0, 4, 5, 8, 12 or 14 finite distortion coefficients"
# fraction of the image width around the principal point that a plausible wide lens images at least
_MIN_IMAGED = 0.5
# advice for vertical pairs
NO_VERTICAL_PAIRS = "mount them side by side, or run on one video with --mono"
# number of points along each side of the image at which the shared view is sampled
_N_VIEW_POINTS = 25
# Fractions of the left image in the right camera's view below which a rig is refused, and below
# which there is a note. Pairs for driving share more than 90 %.
_MIN_SHARED_VIEW, _FULL_SHARED_VIEW = 0.05, 0.7


class NamedCamera(NamedTuple):
    """A camera of a file with several: one of its name for each size of its images."""

    name: str
    camera: PinholeCamera
    # (4, 4) transform from a frame that the cameras of the file share, metres; None = unknown
    pose: FloatArray | None = None
    notes: tuple[str, ...] = ()  # messages for the user, if it is chosen

    def scaled(self, metres: float, note: str) -> NamedCamera:
        """The camera with its position in metres, of one in another unit."""
        if self.pose is None:
            return self
        pose = rigid_motion(self.pose[:3, :3], self.pose[:3, 3] * metres)
        return self._replace(pose=pose, notes=(*self.notes, note))


@dataclass(frozen=True, slots=True)
class RigCalibration:
    """Content of a calibration file in any format."""

    # the left (or only) camera; width_px = height_px = 0 if the file has no image size
    left: PinholeCamera
    right: PinholeCamera | None  # the right camera; None for a single camera
    right_from_left: FloatArray | None  # (4, 4) rigid transform, metres; None for a single camera
    # (3,) translation from the frame of the data set's labels to the left camera's frame; zeros
    # except for KITTI
    left_from_reference_m: tuple[float, float, float] = (0.0, 0.0, 0.0)
    notes: tuple[str, ...] = ()  # messages for the user
    # the cameras of images of other sizes, of the sensor's other modes or before rectification; the
    # image size decides
    others: tuple[RigCalibration, ...] = ()
    metres_per_unit: float = 1.0  # of the lengths in the file
    unit_doubt: str = ""  # why the unit of the lengths is not known, as a message; "" = it is known
    # height and pitch of a single camera, and the uncertainty of its focal length; None = unknown
    road: RoadCalibration | None = None
    # where the left (or only) camera is in its vehicle, and where it looks; None = unknown
    mounting: Mounting | None = None
    accuracy: RigAccuracy | None = None  # of a calibration with a board; None = unknown
    # all cameras of a file with several, of which `left` and `right` are the usual ones; empty = it
    # has no others
    cameras: tuple[NamedCamera, ...] = ()

    @property
    def known_cameras(self) -> tuple[NamedCamera, ...]:
        """The cameras by name: `cameras`, else left and right."""
        if self.cameras:
            return self.cameras
        left = NamedCamera("left", self.left, np.eye(4), self.notes)
        if self.right is None:
            return (left,)
        return (left, NamedCamera("right", self.right, self.right_from_left, self.notes))

    def checked_rig(self, source: object) -> StereoRig | None:
        """The rig; None for a single camera. Raises RigError if it is implausible, or its unit is
        not known.
        """
        if self.right is None or self.right_from_left is None:
            return None
        if self.unit_doubt:
            raise RigError(self.unit_doubt)
        rig = StereoRig(self.left, self.right, self.right_from_left, accuracy=self.accuracy)
        check_rig(rig, source)
        return rig

    def of_size(self, size_px: tuple[int, int] | None) -> RigCalibration:
        """The cameras of images of `size_px` = (width, height), else of larger images of this
        shape; None = any.
        """
        if size_px is None or not self.others:
            return self
        modes = (self, *self.others)
        for mode in modes:
            if is_size_of(mode.left, size_px):
                return mode
        alike = [mode for mode in modes if has_aspect_of(mode.left, size_px)]
        if not alike or (len(modes) == 2 and has_aspect_of(self.left, size_px)):
            return self
        width_px = size_px[0]
        return min(
            alike,
            key=lambda mode: (mode.left.width_px < width_px, abs(mode.left.width_px - width_px)),
        )

    def in_unit(self, metres_per_unit: float | None) -> RigCalibration:
        """The content in another unit of length, for a file whose unit is not `metres_per_unit`;
        None = as it is.
        """
        if metres_per_unit is None or self.right_from_left is None:
            return self
        motion = self.right_from_left.copy()
        motion[:3, 3] *= metres_per_unit / self.metres_per_unit
        notes = (
            *(note for note in self.notes if "baseline is" not in note),
            "Lengths are in the given unit.",
        )
        return replace(
            self,
            right_from_left=motion,
            metres_per_unit=metres_per_unit,
            others=tuple(other.in_unit(metres_per_unit) for other in self.others),
            unit_doubt="",
            notes=notes,
        )


def check_rig(rig: StereoRig, source: object) -> None:
    """Raise RigError, which begins with `source`, for implausible focal lengths, distortion,
    rotation or baseline.
    """
    check_camera(rig.left, f"{source}: left")
    check_camera(rig.right, f"{source}: right")
    if not np.abs(rig.right_from_left).max() <= _MAX_TRANSFORM:
        raise RigError(
            f"{source}: expected finite numbers up to {_MAX_TRANSFORM:g} in right_from_left, found "
            "other values; calibrate again."
        )
    rotation = rig.right_from_left[:3, :3]
    deviation = float(np.abs(rotation.T @ rotation - np.eye(3)).max())
    if deviation > _ROTATION_TOLERANCE or np.linalg.det(rotation) < 0:
        raise RigError(
            f"{source}: expected a rotation matrix in right_from_left, found R^T R differing from "
            f"the identity by {deviation:.3g} and a determinant of {np.linalg.det(rotation):.3g}; "
            "give the 3 x 3 matrix row by row."
        )
    x_m, y_m, z_m = rig.right_from_left[:3, 3]
    if abs(y_m) > abs(x_m):
        raise RigError(
            f"{source}: expected cameras side by side, found a translation of {x_m:.3g} m in x and "
            f"{y_m:.3g} m in y; {NO_VERTICAL_PAIRS}."
        )
    if abs(z_m) > 2 * abs(x_m):
        raise RigError(
            f"{source}: expected cameras side by side, found a translation of {x_m:.3g} m in x and "
            f"{z_m:.3g} m in z, one behind the other; calibrate again, with the board near to the "
            "cameras and tilted."
        )
    low, high = BASELINE_M
    if low <= -rig.baseline_m <= high:
        raise RigError(
            f"{source}: expected the right camera to the right of the left one, found a baseline "
            f"of {rig.baseline_m:.6g} m; swap left and right."
        )
    if not low <= rig.baseline_m <= high:
        raise RigError(
            f"{source}: expected a baseline between {low:g} and {high:g} m, found "
            f"{rig.baseline_m + 0.0:.6g} m; translations must be in metres."
        )


def shared_view(rig: StereoRig) -> float:
    """Fraction of the left image, 0 to 1, that the right camera sees far away; distortion of wide
    lenses only.
    """
    x, y = np.meshgrid(
        *(np.linspace(0, side_px - 1, _N_VIEW_POINTS) for side_px in rig.left.size_px)
    )
    xy_px = np.stack([x.ravel(), y.ravel()], axis=1)
    left, right = rig.left, rig.right
    rays = left.recorded_rays(xy_px) if left.is_wide else left.rays(xy_px)
    rays = rays[np.isfinite(rays).all(axis=1)] @ rig.right_from_left[:3, :3].T
    u, v = (right.recorded_px(rays) if right.is_wide else right.project(rays)).T
    is_in_columns = (u >= 0) & (u <= right.width_px - 1)
    is_in_rows = (v >= 0) & (v <= right.height_px - 1)
    return float((is_in_columns & is_in_rows).mean())


def shared_view_notes(rig: StereoRig, source: object) -> tuple[str, ...]:
    """Notes on a right camera that sees only a part of the left image; RigError if it sees hardly
    any part.
    """
    fraction = shared_view(rig)
    if fraction < _MIN_SHARED_VIEW:
        raise RigError(
            f"{source}: expected cameras that see the same scene, found a right camera that sees "
            f"{fraction:.0%} of the left image; check the rotation and the image sizes."
        )
    if fraction >= _FULL_SHARED_VIEW:
        return ()
    return (
        f"{source}: the right camera sees {fraction:.0%} of the left image; the rest is "
        "measured with one camera.",
    )


def check_camera(camera: PinholeCamera, source: object) -> None:
    """Raise RigError, which begins with `source`, for an implausible size, focal length, centre or
    distortion.
    """
    size_px = camera.size_px
    if size_px != (0, 0) and not all(1 <= side <= MAX_SIDE_PX for side in size_px):
        raise RigError(
            f"{source}: expected an image size of 1 to {MAX_SIDE_PX} px, found "
            f"{shortened(f'{size_px[0]}x{size_px[1]}')} px; correct the file."
        )
    _check_focal_length("fx_px", camera.fx_px, camera.width_px, source)
    _check_focal_length("fy_px", camera.fy_px, camera.width_px, source)
    _check_principal_point(camera, source)
    _check_distortion(camera, source)
    if camera.is_wide and camera.width_px:
        _check_wide(camera, source)


def _check_focal_length(name: str, focal_px: float, width_px: int, source: object) -> None:
    """Check a focal length; `width_px` 0 = the file has no image size."""
    low, high = _FOCAL_PER_WIDTH
    if not 0 < focal_px <= high * MAX_SIDE_PX:
        raise RigError(
            f"{source}: expected a positive focal length {name} in pixels, found {focal_px:g}."
        )
    if width_px and not low * width_px <= focal_px <= high * width_px:
        raise RigError(
            f"{source}: expected a focal length {name} between {low * width_px:g} and "
            f"{high * width_px:g} px for images {width_px} px wide, found {focal_px:g}; give it in "
            "pixels, not in millimetres."
        )


def _check_principal_point(camera: PinholeCamera, source: object) -> None:
    """Check that the principal point is inside of the image, or finite without an image size."""
    cx_px, cy_px = camera.cx_px, camera.cy_px
    if not max(abs(cx_px), abs(cy_px)) <= _MAX_PRINCIPAL_POINT_PX:  # also NaN
        raise RigError(
            f"{source}: expected a finite principal point in pixels, found ({cx_px:g}, {cy_px:g})."
        )
    if not camera.width_px:
        return
    margins = [
        min(centre_px, side_px - centre_px) / max(side_px, 1)
        for centre_px, side_px in ((cx_px, camera.width_px), (cy_px, camera.height_px))
    ]
    if min(margins) < _MIN_MARGIN:
        raise RigError(
            f"{source}: expected a principal point inside the image of "
            f"{camera.width_px}x{camera.height_px} px, at least {_MIN_MARGIN:.0%} of the side from "
            f"its border, found ({cx_px:g}, {cy_px:g}), as in images of about "
            f"{2 * cx_px:.0f}x{2 * cy_px:.0f} px; correct the image size, or calibrate again."
        )


def _check_distortion(camera: PinholeCamera, source: object) -> None:
    """Check the number and magnitude of the distortion coefficients."""
    names = LENSES.named(camera.lens).coefficients
    if camera.is_wide:
        numbers: tuple[int, ...] = (len(names),)
        expected = f"{len(names)} finite coefficients ({' '.join(names)})"
    else:
        numbers = _N_DISTORTION_COEFFICIENTS
        expected = _COEFFICIENTS
    coefficients = camera.distortion
    is_plausible = all(abs(value) <= _MAX_DISTORTION for value in coefficients)  # not NaN
    if len(coefficients) not in numbers or not is_plausible:
        raise RigError(
            f"{source}: expected {expected}, found {len(coefficients)}: "
            f"{quoted(list(coefficients))}; calibrate again."
        )


def _check_wide(camera: PinholeCamera, source: object) -> None:
    """Check that a wide lens images the middle of its images, each pixel from another direction."""
    steps_px = np.linspace(-_MIN_IMAGED, _MIN_IMAGED, 2 * _N_VIEW_POINTS) * camera.width_px / 2
    row_px = np.stack([camera.cx_px + steps_px, np.full_like(steps_px, camera.cy_px)], axis=1)
    rays = camera.recorded_rays(row_px)
    if not (np.diff(np.arctan2(rays[:, 0], rays[:, 2])) > 0).all():  # false for NaN
        raise RigError(
            f"{source}: expected coefficients of the lens model {camera.lens} that image at least "
            f"the middle {_MIN_IMAGED:.0%} of the picture, found "
            f"{quoted(list(camera.distortion))}; calibrate again."
        )
