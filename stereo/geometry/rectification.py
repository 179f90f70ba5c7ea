"""Rectifier: turns two images so that each point of the world lies in the same row of both; Undistorter: one image.

Both cameras are turned, about their own centres, until their x axes run along the baseline and their image planes
coincide (Bouguet's method, OpenCV's stereoRectify); the lens terms go in the same step. Distances of the rectified pair
are measured along the turned left camera's z axis.

The left image is rectified whole, for the detector; the right one only where it is looked at: remapping the strips that
15 boxes are matched in takes a tenth of the time of the frame.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import NamedTuple

import cv2
import numpy as np
import numpy.typing as npt

from track_range.foundation.arrays import FloatArray, Image
from track_range.stereo.geometry.camera import PinholeCamera
from track_range.stereo.geometry.frames import ImageView
from track_range.stereo.geometry.rig import RigError, StereoRig
from track_range.stereo.geometry.rig_checks import check_rig

Maps = tuple[npt.NDArray[np.int16], npt.NDArray[np.uint16]]

_MAX_TURN_RAD = math.radians(45.0)
"""Cameras turned further towards each other than this share hardly any view: the calibration is wrong."""

_MAX_ZOOM = 4.0
"""Largest change of the focal length that lens terms of a sane calibration cause."""


class Rectifier:
    """Rectifies the pairs of one rig.

    Example:
        >>> import numpy as np, track_range as tr
        >>> rectifier = tr.Rectifier(tr.load_rig("rig.yaml"))
        >>> rectifier.rig.is_rectified
        True

    Attributes:
        rig: the rectified rig that the images which come out seem to be taken with.
    """

    def __init__(self, rig: StereoRig, *, row_offset_px: float = 0.0) -> None:
        """Work out the maps.

        Args:
            rig: the pair as calibrated.
            row_offset_px: y_right - y_left that its rectification is known to leave; taken out of the right image.

        Raises:
            RigError: the rig is implausible, its eyes stand one above the other, or one of them is upside down.
        """
        check_rig(rig, "the rig")
        self._size_px = (rig.left.width_px, rig.left.height_px)
        self._right_size_px = (rig.right.width_px, rig.right.height_px)
        views = _Views(rig, None, _View(rig.right, np.eye(3), rig.right.matrix))
        if not rig.is_rectified:
            views = _rectified(rig)
        self.rig, self._left_view = views.rig, views.left
        self._left_maps = None if views.left is None else _maps(views.left, self._size_px)
        is_moved = not rig.is_rectified or row_offset_px != 0.0
        self._right_maps = _maps(views.right.shifted_vertically(row_offset_px), self._size_px) if is_moved else None

    def rectify(self, left: Image, right: Image) -> tuple[Image, ImageView]:
        """Both images, (H, W) or (H, W, 3), rectified; the same arrays where there is nothing to do.

        The right one is then grey, and worked out only where it is looked at. Pixels that no camera saw are black.

        Raises:
            ValueError: an image has another size than its camera.
        """
        _check_size(left, self._size_px, "left")
        _check_size(right, self._right_size_px, "right")
        return (
            left if self._left_maps is None else _remapped(left, self._left_maps),
            right if self._right_maps is None else RemappedView(right, self._right_maps),
        )

    def left_boxes(self, xyxy_px: FloatArray) -> FloatArray:
        """Boxes (N, 4) of the left video's own pixels -> of its rectified images."""
        return xyxy_px if self._left_view is None else self._left_view.boxes(xyxy_px)


class RemappedView:
    """A grey image that is remapped where it is looked at, and kept whole once somebody wanted all of it."""

    def __init__(self, image: Image, maps: Maps) -> None:
        """Look at `image`, (H, W) or (H, W, 3) BGR, through `maps`."""
        self._image = np.asarray(cv2.cvtColor(image, cv2.COLOR_BGR2GRAY), np.uint8) if image.ndim == 3 else image
        self._maps = maps
        self._whole: Image | None = None

    @property
    def shape(self) -> tuple[int, ...]:
        """(H, W)."""
        return self._maps[0].shape[:2]

    def __getitem__(self, window: tuple[slice, slice], /) -> Image:
        """The pixels of `[top:bottom, start:end]`, as an array's."""
        if self._whole is not None:
            return self._whole[window]
        seen = _remapped(self._image, (self._maps[0][window], self._maps[1][window]))
        if seen.shape == self.shape:
            self._whole = seen
        return seen


class Undistorter:
    """Takes the lens terms out of the images of one camera.

    Attributes:
        camera: the ideal camera that the images which come out seem to be taken with; its matrix is the same.
    """

    def __init__(self, camera: PinholeCamera) -> None:
        self.camera = camera.without_distortion()
        self._size_px = (camera.width_px, camera.height_px)
        self._view = _View(camera, np.eye(3), camera.matrix)
        self._maps = _maps(self._view, self._size_px) if camera.is_distorted else None

    def undistort(self, image: Image) -> Image:
        """The image, (H, W) or (H, W, 3), without distortion; the same array where there is none.

        Raises:
            ValueError: the image has another size than the camera.
        """
        _check_size(image, self._size_px, "image")
        return image if self._maps is None else _remapped(image, self._maps)

    def boxes(self, xyxy_px: FloatArray) -> FloatArray:
        """Boxes (N, 4) of the video's own pixels -> of its undistorted images."""
        return xyxy_px if self._maps is None else self._view.boxes(xyxy_px)


@dataclass(frozen=True, slots=True)
class _View:
    """How a camera's image is to look: turned by `turn` (3, 3), seen through the ideal camera `matrix` (3, 3 or 4)."""

    camera: PinholeCamera
    turn: cv2.typing.MatLike
    matrix: cv2.typing.MatLike

    def shifted_vertically(self, by_px: float) -> _View:
        """This view with everything `by_px` rows further up."""
        matrix = np.array(self.matrix, np.float64)
        matrix[1] -= by_px * matrix[2]
        return _View(self.camera, self.turn, matrix)

    def boxes(self, xyxy_px: FloatArray) -> FloatArray:
        """Boxes (N, 4) as this view shows them: each edge goes where its middle goes."""
        if not len(xyxy_px):
            return xyxy_px
        x1, y1, x2, y2 = xyxy_px.T
        x, y = (x1 + x2) / 2, (y1 + y2) / 2
        middles = np.stack([x1, y, x, y1, x2, y, x, y2], axis=1).reshape(-1, 1, 2)
        lens, new = lens_terms(self.camera), np.ascontiguousarray(self.matrix[:, :3])
        moved = cv2.undistortPoints(middles, self.camera.matrix, lens, R=self.turn, P=new).reshape(-1, 4, 2)
        return np.stack([moved[:, 0, 0], moved[:, 1, 1], moved[:, 2, 0], moved[:, 3, 1]], axis=1).astype(np.float64)


class _Views(NamedTuple):
    """A rectified rig and how its images look; left None = as they are."""

    rig: StereoRig
    left: _View | None
    right: _View


class StereoRectification(NamedTuple):
    """Rotations R1, R2 (3, 3) and projections P1, P2 (3, 4) of the rectified cameras, Q (4, 4), as of OpenCV."""

    r1: cv2.typing.MatLike
    r2: cv2.typing.MatLike
    p1: cv2.typing.MatLike
    p2: cv2.typing.MatLike
    q: cv2.typing.MatLike


def stereo_rectification(rig: StereoRig) -> StereoRectification:
    """Bouguet's rectification of a rig (`cv2.stereoRectify`), unchecked."""
    found = cv2.stereoRectify(
        rig.left.matrix,
        lens_terms(rig.left),
        rig.right.matrix,
        lens_terms(rig.right),
        (rig.left.width_px, rig.left.height_px),
        rig.right_from_left[:3, :3],
        rig.right_from_left[:3, 3:],
        flags=cv2.STEREO_ZERO_DISPARITY,
        alpha=0,  # no black borders where the lenses allow it
    )
    return StereoRectification(*found[:5])


def _rectified(rig: StereoRig) -> _Views:
    """The rig once its cameras are turned until their rows agree."""
    _check_rotation(rig.right_from_left[:3, :3])
    size_px = (rig.left.width_px, rig.left.height_px)
    left_turn, right_turn, left_projection, right_projection, _ = stereo_rectification(rig)
    focal_px = float(left_projection[0, 0])
    _check_turn(left_turn, right_turn, right_projection)
    _check_zoom(focal_px, rig.left)
    baseline_m = -float(right_projection[0, 3]) / focal_px
    camera = PinholeCamera(focal_px, focal_px, float(left_projection[0, 2]), float(left_projection[1, 2]), *size_px)
    left = _View(rig.left, left_turn, left_projection)
    right = _View(rig.right, right_turn, right_projection)
    return _Views(StereoRig.rectified(camera, baseline_m), left, right)


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


def _maps(view: _View, size_px: tuple[int, int]) -> Maps:
    """Where each pixel of the new image comes from, in OpenCV's fixed-point form (1/32 px), its fastest."""
    whole, fraction = cv2.initUndistortRectifyMap(
        view.camera.matrix, lens_terms(view.camera), view.turn, view.matrix[:, :3], size_px, cv2.CV_16SC2
    )
    return np.asarray(whole, np.int16), np.asarray(fraction, np.uint16)


def lens_terms(camera: PinholeCamera) -> FloatArray:
    """(5,) or more of OpenCV's lens terms; zeros for an ideal lens."""
    return np.array(camera.distortion or (0.0,) * 5)


def _remapped(image: Image, maps: Maps) -> Image:
    return np.asarray(cv2.remap(image, maps[0], maps[1], cv2.INTER_LINEAR), np.uint8)


def _check_size(image: Image, size_px: tuple[int, int], name: str) -> None:
    if (image.shape[1], image.shape[0]) != size_px:
        got = f"{image.shape[1]}x{image.shape[0]}"
        raise ValueError(f"{name}: {size_px[0]}x{size_px[1]} px wanted, {got} got")
