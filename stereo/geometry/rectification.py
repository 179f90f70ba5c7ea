"""Rectifier: rectifies a stereo pair, so that corresponding points have equal rows; Undistorter:
undistorts one image.

Both cameras are rotated about their centres until their x axes lie along the baseline and their
image planes coincide (Bouguet's method, OpenCV's stereoRectify); the same remapping removes the
lens distortion. Distances are measured along the z axis of the rotated left camera. Images of wide
lenses are remapped to virtual pinholes (`virtual_pinhole.py`), whose image size differs from the
recorded one.

The left image is rectified completely, for the detector; the right image is rectified only where it
is read: remapping the strips in which 15 boxes are matched takes a tenth of the time of the entire
image.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass, replace

import cv2
import numpy as np
import numpy.typing as npt

from track_range.foundation.arrays import FloatArray, FloatArray32, Image
from track_range.stereo.geometry.camera import PinholeCamera
from track_range.stereo.geometry.frames import ImageView, grey
from track_range.stereo.geometry.rig import RigError, StereoRig
from track_range.stereo.geometry.rig_checks import NO_VERTICAL_PAIRS, check_rig
from track_range.stereo.geometry.virtual_pinhole import (
    axial_focal_px,
    view_from_camera,
    virtual_pinhole,
)

# OpenCV's fixed-point maps: whole pixels and fractions
Maps = tuple[npt.NDArray[np.int16], npt.NDArray[np.uint16]]
_Matrix = cv2.typing.MatLike
# Largest rotation between the cameras, and by rectification; beyond it, hardly any of the scene is
# in both views.
_MAX_ROTATION_RAD = math.radians(45.0)
# largest factor between the focal lengths before and after rectification in a plausible calibration
_MAX_ZOOM = 4.0
# relative difference of focal lengths of different cameras; identical lenses differ by 1 or 2 %
_FOCAL_SCATTER = 0.1
# factor by which the right image is reduced above which it is smoothed first, against aliasing
_MIN_REDUCTION = 1.3
# number of fixed-point steps of `recorded_boxes`; each reduces the error about ten times
_N_BOX_STEPS = 4
# number of points of each edge of a box in the recorded image, where edges are curves
N_OUTLINE = 8
# source of the pixels that the lens does not image; black, as everything outside the image
_OUTSIDE_PX = -100.0


class _UndistortedImages:
    """The left, or only, images of a rectifier or undistorter in relation to the recorded video."""

    recorded_size_px: tuple[int, int]  # (width, height) of the images of the video
    _view: _View | None  # None = images of the video
    is_turned = False  # whether the images of the video are turned by 180 degrees first
    # shapes of the last depth image; (h, w) source of its pixels, and factor of their depths
    _depth_map: tuple[object, npt.NDArray[np.int64], FloatArray32] | None = None

    def _turned(self, xy_px: FloatArray) -> FloatArray:
        """Points (N, 2) or boxes (N, 4) of the video turned by 180 degrees if its images are
        turned; and in reverse.
        """
        if not self.is_turned:
            return xy_px
        last_px = np.array(self.recorded_size_px, np.float64) - 1
        return (
            last_px - xy_px if xy_px.shape[1] == 2 else np.tile(last_px, 2) - xy_px[:, [2, 3, 0, 1]]
        )

    def left_boxes(self, xyxy_px: FloatArray) -> FloatArray:
        """Boxes (N, 4) in pixels of the left video -> of its undistorted images: each edge moves
        like its midpoint.
        """
        xyxy_px = self._turned(xyxy_px)
        return xyxy_px if self._view is None else _moved_boxes(xyxy_px, self._view.points)

    def recorded_points(self, xy_px: FloatArray) -> FloatArray:
        """Points (N, 2) in pixels of the undistorted left images -> of the left video; NaN where
        not imaged.
        """
        return self._turned(xy_px if self._view is None else self._view.recorded_points(xy_px))

    def recorded_boxes(self, xyxy_px: FloatArray) -> FloatArray:
        """Boxes (N, 4) in pixels of the undistorted left images -> of the left video; inverse of
        `left_boxes`.
        """
        return self._turned(xyxy_px if self._view is None else self._view.recorded_boxes(xyxy_px))

    def left_depth(self, depth_m: FloatArray32, size_px: tuple[int, int]) -> FloatArray32:
        """Depth (h, w) of the whole recorded left image, NaN = unknown, as that of the undistorted
        one of (width, height) `size_px`, along its axis; of the nearest pixel, since edges have no
        depth between both sides.
        """
        if self.is_turned:
            depth_m = np.ascontiguousarray(depth_m[::-1, ::-1])
        if self._view is None:
            return depth_m
        key = depth_m.shape, size_px
        if self._depth_map is None or self._depth_map[0] != key:
            moved = _depth_map(self._view, depth_m.shape, size_px, self.recorded_size_px)
            self._depth_map = key, *moved
        _, pixel, factor = self._depth_map
        return np.asarray(depth_m.ravel()[pixel] * factor, np.float32)

    def recorded_outlines(self, xyxy_px: FloatArray) -> FloatArray:
        """(N, 4 N_OUTLINE, 2) closed outlines of boxes (N, 4) of the undistorted images, in pixels
        of the video.
        """
        if not len(xyxy_px):
            return np.zeros((0, 4 * N_OUTLINE, 2))
        corners = xyxy_px[:, [0, 1, 2, 1, 2, 3, 0, 3]].reshape(-1, 4, 2)
        following = np.roll(corners, -1, axis=1)
        fraction = (np.arange(N_OUTLINE) / N_OUTLINE)[:, None]
        points = corners[:, :, None] * (1 - fraction) + following[:, :, None] * fraction
        return self.recorded_points(points.reshape(-1, 2)).reshape(len(xyxy_px), -1, 2)


class Rectifier(_UndistortedImages):
    """Rectifies the pairs of one rig.

    Example:
        >>> import numpy as np, track_range as tr
        >>> rectifier = tr.Rectifier(tr.load_rig("rig.yaml"))
        >>> rectifier.rig.is_rectified
        True

    Attributes:
        rig: the rectified rig, which describes the rectified images.
    """

    def __init__(
        self,
        rig: StereoRig,
        *,
        row_offset_px: float = 0.0,
        right_correction: FloatArray | None = None,
        shift_px: float = 0.0,
        fov_deg: float | None = None,
        is_turned: bool = False,
        source: object = "the rig",
    ) -> None:
        """Compute the remapping.

        Args:
            rig: the calibrated pair.
            row_offset_px: vertical offset y_right - y_left that remains after rectification;
                removed from the right image.
            right_correction: (3, 3) matrix from directions in the rectified right image to
                corrected ones; None = no correction.
            shift_px: horizontal shift of the right image to the left, which increases all
                disparities.
            fov_deg: horizontal field of view to which the images of wide lenses are undistorted;
                None = the left lens's, up to 120 degrees.
            is_turned: whether both videos are turned by 180 degrees against the rig.
            source: file of the rig, for messages.

        Raises:
            RigError: the rig is implausible, the cameras are not side by side, or a camera is
                upside down.
        """
        check_rig(rig, source)
        self.is_turned = is_turned
        self.recorded_size_px, self._right_size_px = rig.left.size_px, rig.right.size_px
        if rig.is_rectified:
            self.rig, self._view, right_view = (
                rig,
                None,
                _View(rig.right, np.eye(3), rig.right.matrix),
            )
        else:
            self.rig, self._view, right_view = _rectified(rig, fov_deg, source)
        size_px = self.rig.left.size_px
        self._left_maps = None if self._view is None else _maps(self._view, size_px)
        reduction = axial_focal_px(rig.right) / self.rig.left.fx_px
        self._right_blur_px = (
            0.5 * math.sqrt(reduction**2 - 1) if reduction > _MIN_REDUCTION else 0.0
        )
        is_moved = (
            not rig.is_rectified
            or row_offset_px != 0.0
            or shift_px != 0.0
            or right_correction is not None
        )
        self._right_view = (
            right_view.moved(right_correction, shift_px, row_offset_px) if is_moved else None
        )
        self._right_maps = None if self._right_view is None else _maps(self._right_view, size_px)

    def rectify(self, left: Image, right: Image) -> tuple[Image, ImageView]:
        """Both images, (H, W) or (H, W, 3), rectified; the same arrays if the rig is already
        rectified.

        A remapped right image is grey and computed only where it is read. Pixels outside a camera's
        view are black. Raises ValueError if the size of an image differs from its camera's.
        """
        _check_size(left, self.recorded_size_px, "left")
        _check_size(right, self._right_size_px, "right")
        if self.is_turned:
            left, right = (
                np.asarray(cv2.rotate(image, cv2.ROTATE_180), np.uint8) for image in (left, right)
            )
        if self._right_blur_px:
            right = np.asarray(cv2.GaussianBlur(right, (0, 0), self._right_blur_px), np.uint8)
        return (
            left if self._left_maps is None else _remapped(left, self._left_maps),
            right if self._right_maps is None else RemappedView(right, self._right_maps),
        )

    def points(self, left_px: FloatArray, right_px: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Points (N, 2) in pixels of the left and of the right video -> in pixels of the rectified
        images.
        """
        return (
            left_px if self._view is None else self._view.points(left_px),
            right_px if self._right_view is None else self._right_view.points(right_px),
        )


class RemappedView:
    """A grey image, `recorded`, that is remapped only where it is read, and stored once it was read
    completely.
    """

    def __init__(self, image: Image, maps: Maps) -> None:
        """The view of `image`, (H, W) or (H, W, 3) BGR, through `maps`."""
        self.recorded = grey(image)
        self._maps = maps
        self._whole: Image | None = None

    @property
    def shape(self) -> tuple[int, ...]:
        """(H, W)."""
        return self._maps[0].shape[:2]

    def __getitem__(self, window: tuple[slice, slice], /) -> Image:
        """The pixels of `[top:bottom, start:end]`, as with an array."""
        if self._whole is not None:
            return self._whole[window]
        remapped = _remapped(self.recorded, (self._maps[0][window], self._maps[1][window]))
        if remapped.shape == self.shape:
            self._whole = remapped
        return remapped


class Undistorter(_UndistortedImages):
    """Removes the lens distortion from the images of one camera.

    The images of a wide lens are undistorted to the horizontal field of view `fov_deg` (None = the
    field of the lens, up to 120 degrees) about an axis `yaw_deg` to the right of the camera's axis.
    The attribute `camera` is the ideal camera of the undistorted images: the same matrix with
    square pixels, or the virtual pinhole of a wide lens.
    """

    def __init__(
        self, camera: PinholeCamera, *, fov_deg: float | None = None, yaw_deg: float = 0.0
    ) -> None:
        self.camera = (
            virtual_pinhole(camera, fov_deg, yaw_deg) if camera.is_wide else camera.squared()
        )
        self.recorded_size_px = camera.size_px
        view = _View(camera, view_from_camera(yaw_deg), self.camera.matrix)
        self._view = view if camera.is_distorted or not camera.has_square_pixels else None
        self._maps = None if self._view is None else _maps(self._view, self.camera.size_px)

    def undistort(self, image: Image) -> Image:
        """The image, (H, W) or (H, W, 3), without distortion; the same array if the camera has
        none.

        Raises ValueError if the size of the image differs from the camera's image size.
        """
        _check_size(image, self.recorded_size_px, "image")
        return image if self._maps is None else _remapped(image, self._maps)


@dataclass(frozen=True, slots=True)
class _View:
    """Target of a remapping: the camera rotated by `rotation` (3, 3), with the ideal camera matrix
    (3, 3 or 4).
    """

    camera: PinholeCamera
    rotation: _Matrix
    matrix: _Matrix

    def moved(self, correction: FloatArray | None, left_px: float, up_px: float) -> _View:
        """The view with its directions multiplied by a matrix (3, 3), and its content moved to the
        left and up.
        """
        rotation = self.rotation if correction is None else correction @ np.asarray(self.rotation)
        matrix = np.array(self.matrix, np.float64)
        matrix[:2] -= np.array([[left_px], [up_px]]) * matrix[2]
        return _View(self.camera, rotation, matrix)

    def points(self, xy_px: FloatArray) -> FloatArray:
        """Points (N, 2) of the recorded image in pixels of this view; NaN for directions that it
        cannot show.
        """
        matrix = np.ascontiguousarray(self.matrix[:, :3])
        if self.camera.is_wide:
            rays = (
                self.camera.recorded_rays(np.asarray(xy_px, np.float64))
                @ np.asarray(self.rotation).T
            )
            projected = rays @ matrix.T
            depth = np.where(projected[:, 2:] > 0, projected[:, 2:], np.nan)
            return np.asarray(projected[:, :2] / depth, np.float64)
        distortion = distortion_coefficients(self.camera)
        source = np.ascontiguousarray(xy_px, np.float64).reshape(-1, 1, 2)
        moved = cv2.undistortPoints(
            source, self.camera.matrix, distortion, R=np.asarray(self.rotation), P=matrix
        )
        return np.asarray(moved, np.float64).reshape(-1, 2)

    def recorded_points(self, xy_px: FloatArray) -> FloatArray:
        """Points (N, 2) of this view in pixels of the recorded image; NaN where the lens shows
        nothing.
        """
        homogeneous = np.concatenate([xy_px, np.ones((len(xy_px), 1))], axis=1)
        rays = homogeneous @ np.linalg.inv(self.matrix[:, :3]).T @ np.asarray(self.rotation)
        return self.camera.recorded_px(np.asarray(rays, np.float64))

    def recorded_boxes(self, xyxy_px: FloatArray) -> FloatArray:
        """Boxes (N, 4) in pixels of the recorded image, from boxes in pixels of this view."""
        target = _moved_boxes(xyxy_px, self.recorded_points)
        recorded = target
        with np.errstate(over="ignore", invalid="ignore"):  # of boxes far outside the image
            for _ in range(_N_BOX_STEPS):  # midpoints of edges become points beside the midpoints
                recorded = (
                    recorded
                    + target
                    - _moved_boxes(_moved_boxes(recorded, self.points), self.recorded_points)
                )
        return recorded


def _moved_boxes(xyxy_px: FloatArray, moved: Callable[[FloatArray], FloatArray]) -> FloatArray:
    """Boxes (N, 4) whose edges are each moved like their midpoint."""
    if not len(xyxy_px):
        return xyxy_px
    x1, y1, x2, y2 = xyxy_px.T
    x, y = (x1 + x2) / 2, (y1 + y2) / 2
    edges = moved(np.stack([x1, y, x, y1, x2, y, x, y2], axis=1).reshape(-1, 2)).reshape(-1, 4, 2)
    return np.stack([edges[:, 0, 0], edges[:, 1, 1], edges[:, 2, 0], edges[:, 3, 1]], axis=1)


def stereo_rectification(
    rig: StereoRig, fov_deg: float | None = None
) -> tuple[_Matrix, _Matrix, _Matrix, _Matrix, _Matrix]:
    """Bouguet's rectification of a rig (`cv2.stereoRectify`), without plausibility checks: R1, R2,
    P1, P2, Q.

    These are the rotations (3, 3) and projections (3, 4) of the rectified cameras, and Q (4, 4), as
    in OpenCV. Different cameras are rectified to the field of view and resolution of the left one:
    OpenCV knows one image size, and would cut both images to what the narrower camera sees. Pairs
    with wide lenses are rectified to the left lens's virtual pinhole with the horizontal field of
    view `fov_deg`, None = the lens's up to 120 degrees.
    """
    if rig.left.is_wide or rig.right.is_wide:
        return _wide_rectification(rig, fov_deg)
    has_equal_focal_px = abs(rig.right.fx_px / rig.left.fx_px - 1) <= _FOCAL_SCATTER
    right = rig.right if rig.left.size_px == rig.right.size_px and has_equal_focal_px else rig.left
    result = cv2.stereoRectify(
        rig.left.matrix,
        distortion_coefficients(rig.left),
        right.matrix,
        distortion_coefficients(right),
        rig.left.size_px,
        rig.right_from_left[:3, :3],
        rig.right_from_left[:3, 3:],
        flags=cv2.STEREO_ZERO_DISPARITY,
        alpha=0,  # no black borders where the lenses allow it
        newImageSize=rig.left.squared().size_px,
    )
    return result[:5]


def _wide_rectification(
    rig: StereoRig, fov_deg: float | None
) -> tuple[_Matrix, _Matrix, _Matrix, _Matrix, _Matrix]:
    """Bouguet's R1 to Q for the left camera's virtual pinhole, whose view wide lenses cover after
    the rotations.
    """
    camera = _ideal(rig.left, fov_deg)
    translation = rig.right_from_left[:3, 3:]
    r1, r2, *_ = cv2.stereoRectify(
        camera.matrix,
        np.zeros(4),
        camera.matrix,
        np.zeros(4),
        camera.size_px,
        rig.right_from_left[:3, :3],
        translation,
    )
    moved_m = (np.asarray(r2) @ translation).ravel()
    p1 = np.concatenate([camera.matrix, np.zeros((3, 1))], axis=1)
    p2 = p1 + np.outer((1.0, 0.0, 0.0), (0.0, 0.0, 0.0, camera.fx_px * moved_m[0]))
    p2[1, 3] = camera.fy_px * moved_m[1]
    q = np.array(
        [
            [1.0, 0.0, 0.0, -camera.cx_px],
            [0.0, 1.0, 0.0, -camera.cy_px],
            [0.0, 0.0, 0.0, camera.fx_px],
            [0.0, 0.0, -1.0 / (moved_m[0] or np.nan), 0.0],
        ]
    )
    return r1, r2, p1, p2, q


def rectified_points(
    camera: PinholeCamera, rotation: _Matrix, projection: _Matrix, xy_px: FloatArray
) -> FloatArray:
    """(N, 2) points of a recorded image after the rectification of its camera by `rotation` and
    `projection`.
    """
    return _View(camera, rotation, projection).points(xy_px)


def _ideal(camera: PinholeCamera, fov_deg: float | None) -> PinholeCamera:
    """The virtual pinhole of a wide lens; any other camera without its distortion and with square
    pixels.
    """
    return virtual_pinhole(camera, fov_deg) if camera.is_wide else camera.squared()


def _rectified(
    rig: StereoRig, fov_deg: float | None, source: object
) -> tuple[StereoRig, _View, _View]:
    """The rectified rig, and the remappings of both cameras."""
    squared = replace(rig, left=rig.left.squared(), right=rig.right.squared())
    if squared.is_rectified and not (rig.left.is_distorted or rig.right.is_distorted):
        left, right = (
            _View(camera, np.eye(3), squared.left.matrix) for camera in (rig.left, rig.right)
        )
        return squared, left, right
    angle_rad = rotation_angle_rad(rig.right_from_left[:3, :3])
    if angle_rad > _MAX_ROTATION_RAD:
        raise RigError(
            f"{source}: expected cameras that point in similar directions, found a rotation of "
            f"{math.degrees(angle_rad):.0f} degrees between them; check the rotation, and whether "
            "a camera is inverted."
        )
    target = _ideal(rig.left, fov_deg)
    r1, r2, p1, p2, _ = stereo_rectification(rig, fov_deg)
    if abs(float(p2[1, 3])) > abs(float(p2[0, 3])):
        raise RigError(
            f"{source}: expected cameras side by side, found one above the other; "
            f"{NO_VERTICAL_PAIRS}."
        )
    for side, rotation in (("left", r1), ("right", r2)):
        if rotation_angle_rad(rotation) > _MAX_ROTATION_RAD:
            raise RigError(
                f"{source}: expected a baseline perpendicular to the viewing direction, but "
                f"rectification would rotate the {side} camera by "
                f"{math.degrees(rotation_angle_rad(rotation)):.0f} degrees; check the translation."
            )
    focal_px = float(p1[0, 0])
    zoom = focal_px / target.fx_px
    if not 1 / _MAX_ZOOM <= zoom <= _MAX_ZOOM:
        raise RigError(
            f"{source}: expected a rectification that changes the focal length by a factor of at "
            f"most {_MAX_ZOOM:g}, found {zoom:.2g}; check the distortion coefficients and the "
            "principal points, or calibrate again."
        )
    camera = PinholeCamera(focal_px, focal_px, float(p1[0, 2]), float(p1[1, 2]), *target.size_px)
    rectified = StereoRig.rectified(camera, -float(p2[0, 3]) / focal_px)
    return (
        replace(rectified, accuracy=rig.accuracy, baseline_sigma=rig.baseline_sigma),
        _View(rig.left, r1, p1),
        _View(rig.right, r2, p2),
    )


def rotation_angle_rad(rotation: _Matrix) -> float:
    """Angle of a rotation (3, 3)."""
    return math.acos(float(np.clip((np.trace(rotation) - 1) / 2, -1.0, 1.0)))


def _maps(view: _View, size_px: tuple[int, int]) -> Maps:
    """Source of each pixel of the remapped image, in OpenCV's fixed-point form (1/32 px), which is
    the fastest.
    """
    if view.camera.is_wide:
        x, y = np.meshgrid(
            np.arange(size_px[0], dtype=np.float64), np.arange(size_px[1], dtype=np.float64)
        )
        source_px = view.recorded_points(np.stack([x.ravel(), y.ravel()], axis=1)).reshape(
            *x.shape, 2
        )
        known_px = np.where(np.isfinite(source_px), source_px, _OUTSIDE_PX).astype(np.float32)
        whole, fraction = cv2.convertMaps(known_px[..., 0], known_px[..., 1], cv2.CV_16SC2)
        return np.asarray(whole, np.int16), np.asarray(fraction, np.uint16)
    distortion = distortion_coefficients(view.camera)
    whole, fraction = cv2.initUndistortRectifyMap(
        view.camera.matrix, distortion, view.rotation, view.matrix[:, :3], size_px, cv2.CV_16SC2
    )
    return np.asarray(whole, np.int16), np.asarray(fraction, np.uint16)


def _depth_map(
    view: _View,
    shape: tuple[int, ...],
    size_px: tuple[int, int],
    recorded_size_px: tuple[int, int],
) -> tuple[npt.NDArray[np.int64], FloatArray32]:
    """(h, w) flat index of the source of each pixel of a depth image of this view, and the factor
    of its depth, z of the view over z of the recorded camera; NaN = not imaged.
    """
    h, w = shape
    column, row = np.meshgrid(np.arange(w), np.arange(h))
    x_px = (column.ravel() + 0.5) * size_px[0] / w - 0.5
    y_px = (row.ravel() + 0.5) * size_px[1] / h - 0.5
    xy_px = np.stack([x_px, y_px], axis=1)
    source = (view.recorded_points(xy_px) + 0.5) * [w, h] / np.array(recorded_size_px) - 0.5
    column, row = np.rint(np.nan_to_num(source, nan=-1.0)).astype(np.int64).T
    homogeneous = np.column_stack([xy_px, np.ones(len(xy_px))])
    rays = homogeneous @ np.linalg.inv(np.asarray(view.matrix)[:, :3]).T @ np.asarray(view.rotation)
    is_shown = (column >= 0) & (column < w) & (row >= 0) & (row < h) & (rays[:, 2] > 0)
    factor = np.where(is_shown, 1.0 / np.where(is_shown, rays[:, 2], 1.0), np.nan)
    pixel = np.where(is_shown, row * w + column, 0)
    return pixel.reshape(h, w), factor.reshape(h, w).astype(np.float32)


def distortion_coefficients(camera: PinholeCamera) -> FloatArray:
    """(5,) or more of OpenCV's distortion coefficients; zeros for an ideal lens."""
    return np.array(camera.distortion or (0.0,) * 5)


def _remapped(image: Image, maps: Maps) -> Image:
    return np.asarray(cv2.remap(image, *maps, cv2.INTER_LINEAR), np.uint8)


def _check_size(image: Image, size_px: tuple[int, int], name: str) -> None:
    if (image.shape[1], image.shape[0]) != size_px:
        raise ValueError(
            f"{name}: expected an image of {size_px[0]}x{size_px[1]} px, got "
            f"{image.shape[1]}x{image.shape[0]}"
        )
