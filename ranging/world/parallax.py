r"""Parallax: distances of parked vehicles, signs and lights, triangulated over time from the motion
of the camera.

With the rotation between two frames removed, the points of a static object move by

    p' - q = g (d_z q - d),   q = R p,   g = V dt / Z        d: unit direction of travel

away from the epipole d / d_z, so V dt, which the camera travels, and the growth g give the distance
Z, the better the farther the object is from the epipole. Corners inside each box are tracked from
frame to frame, in an image of twice the size of odometry's; g is their median. A filter of 1 / Z
follows the object:

    rho' = rho / (1 - rho V dt d_z)

A moving vehicle has a growth as well, by its own speed along the road: a car that moves with half
of the camera's speed appears twice as far. An object counts as static if its triangulated distance
agrees with its distance by size within `_MAX_SIGMA` for `_MIN_STATIC_S`; only vehicles, signs and
lights are considered, since people walk slowly.
"""

import math
from typing import NamedTuple

import cv2
import numpy as np

from track_range.foundation.arrays import FloatArray, FloatArray32, Image, IntArray
from track_range.foundation.robust_statistics import MAD_TO_SIGMA, median_of
from track_range.foundation.sparse_flow import small_grey, tracked_corners
from track_range.foundation.track_state import TrackState
from track_range.ranging.measurement.ranges import Ranges
from track_range.ranging.size_models.size_model import SIZE_CLASSES
from track_range.stereo.geometry.camera import PinholeCamera
from track_range.stereo.odometry.ego_motion import CameraStep
from track_range.tracking.tracks import Tracks

_STATIC_CLASSES = ("car", "truck", "bus", "van", "motorcycle", "traffic light", "traffic sign")
_MAY_BE_STATIC = np.array([name in _STATIC_CLASSES for name in SIZE_CLASSES])  # (size classes,)
# largest number of corners per object, and smallest number of a measurement
_N_CORNERS, _MIN_CORNERS = 12, 4
# of corners relative to the best in the box, and between corners
_MIN_QUALITY, _MIN_DISTANCE_PX = 0.02, 3
_INNER = 0.12  # margin of the box, as a fraction of its sides, that may show the background
_MIN_SIDE_PX = 8  # smallest side of the inner box, pixels of that image
# tracked window and pyramid levels; the start is predicted from the distance
_WINDOW_PX, _N_LEVELS = 9, 2
_CORNER_PX = 0.15  # standard deviation of the motion of a tracked corner, pixels of that image
# motion of a corner across the direction from the epipole; if larger, the object moves
_MAX_ACROSS_PX = 0.8
_MIN_RADIUS = 0.02  # smallest distance of an object from the epipole, as a tangent
_CORRELATED_S = 1.0  # time over which errors of the rotation are correlated
# standard deviation of the distance of an object's corners from the surface at the middle of its
# box
_SURFACE_M = 0.4
# largest difference from the other distance of static objects, and for how long
_MAX_SIGMA, _MIN_STATIC_S = 2.5, 0.2
_MAX_REPORTED = 0.15  # largest relative standard deviation of a distance
# longest time without a measurement, and lower bound of 1 - rho V dt
_MAX_GAP_S, _MIN_APPROACH = 0.3, 0.1
_MIN_TRAVELLED_M = 0.1  # smallest distance travelled between two frames for a measurement


class _Picture(NamedTuple):
    """Tracks and image of one frame; the image is halved `n_halved` times."""

    tracks: Tracks
    image: Image
    n_halved: int


class Parallax:
    """Triangulates static objects; the state belongs to one camera."""

    def __init__(self, camera: PinholeCamera) -> None:
        """The estimator for `camera` (undistorted)."""
        self._camera = camera
        self._before: _Picture | None = None
        self._step_s = math.nan  # time of the last step
        self._state = TrackState(np.array([np.nan, np.nan, np.nan, 0.0]))
        """By track: 1 / Z, its variance, time of the last measurement, seconds in agreement with
        other distances."""

    def measure(self, tracks: Tracks, step: CameraStep | None, other: Ranges) -> Ranges:
        """Distances of N tracks that are static; NaN = moving, unknown, or not precise.

        `step` is the motion of the camera since the previous frame, None = unknown; in frames
        between two steps, it is the last one. `other` are by another method.
        """
        if step is not None and step.time_s == self._step_s:  # a frame after the step
            return Ranges.unmeasured(tracks.track_id)
        before, self._before = self._before, None
        self._step_s = math.nan if step is None else step.time_s
        if step is None:
            return Ranges.unmeasured(tracks.track_id)
        n_halved = max(step.now.n_halved - 1, 0)
        self._before = now = _Picture(tracks, small_grey(step.now.grey, n_halved), n_halved)
        if (
            before is None
            or before.image.shape != now.image.shape
            or step.travelled_m < _MIN_TRAVELLED_M
        ):
            return Ranges.unmeasured(tracks.track_id)
        with np.errstate(invalid="ignore", divide="ignore"):  # NaN = unknown
            rho, P, measured_s, agreed_s = self._filtered(before, now, step, other)
            distance_m = np.where(rho > 0, 1.0 / rho, np.nan)
            relative = np.sqrt(
                P * distance_m**2 + step.travelled_sigma**2 + (_SURFACE_M / distance_m) ** 2
            )
            difference = np.abs(np.log(distance_m / other.distance_m))
            agrees = difference < _MAX_SIGMA * np.hypot(relative, other.sigma_m / other.distance_m)
            agreed_s = np.where(agrees, agreed_s + step.dt_s, 0.0)
            is_static = (
                (agreed_s >= _MIN_STATIC_S)
                & (relative < _MAX_REPORTED)
                & (measured_s == step.time_s)
            )
        self._state.put(
            tracks.track_id,
            np.array([rho, P, measured_s, agreed_s]),
            keep_known=step.time_s - self._state.known[2] < _MAX_GAP_S,
        )
        distance_m = np.where(is_static, distance_m, np.nan)
        return Ranges(tracks.track_id, distance_m, distance_m * relative)

    def _filtered(
        self, before: _Picture, now: _Picture, step: CameraStep, other: Ranges
    ) -> FloatArray:
        """(4, N) states of the present tracks, with the growth of this frame."""
        rho, P, measured_s, agreed_s = self._state.get(now.tracks.track_id)
        is_followed = np.isfinite(rho) & (step.time_s - measured_s < _MAX_GAP_S)
        approach = np.maximum(1.0 - rho * step.travelled_m * step.travel[2], _MIN_APPROACH)
        rho, P = np.where(is_followed, [rho / approach, P / approach**4], np.nan)
        growth, variance = self._growths(
            before, now, step, np.where(is_followed, 1.0 / rho, other.distance_m)
        )
        z, R = growth / step.travelled_m, variance / step.travelled_m**2
        gain = np.where(is_followed, P / (P + R), 1.0)
        is_measured = np.isfinite(z)
        rho = np.where(is_measured, np.where(is_followed, rho + gain * (z - rho), z), rho)
        P = np.where(is_measured, gain * R, P)
        return np.array([rho, P, np.where(is_measured, step.time_s, measured_s), agreed_s])

    def _growths(
        self, before: _Picture, now: _Picture, step: CameraStep, expected_m: FloatArray
    ) -> tuple[FloatArray, FloatArray]:
        """(N,) growths g of the present tracks since the frame before, and their variances; NaN =
        not measured.

        The search starts from the expected distances (N,), NaN = unknown.
        """
        growth, variance = np.full((2, len(now.tracks)), np.nan)
        parts = _corners_of_tracks(before, now.tracks)
        if not parts:
            return growth, variance
        n_corners = [len(corners) for _, corners in parts]
        owner = np.repeat([row for row, _ in parts], n_corners)
        corners = np.concatenate([corners for _, corners in parts])
        turned = self._rays(corners, now.n_halved) @ step.rotation.T
        q = turned[:, :2] / turned[:, 2:]
        from_epipole = step.travel[2] * q - step.travel[:2]
        camera, factor = self._camera, 1 << now.n_halved
        expected = step.travelled_m / expected_m[owner, None]
        tangents = q + from_epipole * np.where(np.isfinite(expected), expected, 0.0)
        full_px = tangents * [camera.fx_px, camera.fy_px] + [camera.cx_px, camera.cy_px]
        start = np.asarray((full_px - (factor - 1) / 2) / factor, np.float32)
        points, is_tracked = tracked_corners(
            before.image, now.image, corners, window_px=_WINDOW_PX, n_levels=_N_LEVELS, start=start
        )
        moved = self._rays(points, now.n_halved)[:, :2] - q
        focal_px = camera.fx_px / factor
        radius = np.sqrt((from_epipole * from_epipole).sum(axis=1))
        np.maximum(radius, _MIN_RADIUS / 10, out=radius)
        away = from_epipole / radius[:, None]
        across_px = focal_px * np.abs(moved[:, 0] * away[:, 1] - moved[:, 1] * away[:, 0])
        g = (moved * away).sum(axis=1) / radius
        is_good = is_tracked & (across_px < _MAX_ACROSS_PX) & (radius > _MIN_RADIUS)
        n_correlated = max(_CORRELATED_S / step.dt_s, 1.0)  # frames
        first = 0
        for (row, _), n in zip(parts, n_corners, strict=True):
            corners_of_track = slice(first, first + n)
            first += n
            is_used = is_good[corners_of_track]
            growths, radii = g[corners_of_track][is_used], radius[corners_of_track][is_used]
            if len(growths) < max(_MIN_CORNERS, 0.5 * n):
                continue
            growth[row] = median_of(growths)
            spread = MAD_TO_SIGMA * float(median_of(np.abs(growths - growth[row])))
            mean_radius = float(median_of(radii))
            noise = max(spread, _CORNER_PX / focal_px / mean_radius)
            systematic = step.rotation_sigma_rad / mean_radius
            variance[row] = (1.25 * noise) ** 2 / len(growths) + systematic**2 * n_correlated
        return growth, variance

    def _rays(self, points: FloatArray32, n_halved: int) -> FloatArray:
        """(N, 3) rays of points (N, 2) of an image halved `n_halved` times."""
        factor = 1 << n_halved
        return self._camera.rays(factor * points.astype(np.float64) + (factor - 1) / 2)


def _corners_of_tracks(before: _Picture, now: Tracks) -> list[tuple[int, FloatArray32]]:
    """Rows of present tracks that may be static, and (K, 2) corners in their previous boxes."""
    row_before = {
        key: row
        for row, key in enumerate(before.tracks.track_id.tolist())
        if before.tracks.observed[row]
    }
    candidates = np.flatnonzero(now.observed & _MAY_BE_STATIC[now.class_id]).tolist()
    inner_px = _inner_boxes_px(before)
    return [
        (row, corners)
        for row in candidates
        if (last := row_before.get(int(now.track_id[row]))) is not None
        and len(corners := _corners_in(before.image, inner_px[last])) >= _MIN_CORNERS
    ]


def _inner_boxes_px(picture: _Picture) -> IntArray:
    """(N, 4) first column and row of the inner part of each box, and those behind its last, in pixels
    of the image.
    """
    low_px, high_px = picture.tracks.xyxy_px[:, :2], picture.tracks.xyxy_px[:, 2:]
    margin = _INNER * (high_px - low_px)
    factor, (height, width) = 1 << picture.n_halved, picture.image.shape
    first = np.maximum(np.ceil((low_px + margin) / factor), 0)
    behind = np.minimum(np.floor((high_px - margin) / factor) + 1, [width, height])
    return np.asarray(np.concatenate([first, behind], axis=1), np.int64)


def _corners_in(image: Image, inner_px: IntArray) -> FloatArray32:
    """(K, 2) corners in the inner part of a box in the image."""
    x1, y1, x2, y2 = inner_px.tolist()
    if min(x2 - x1, y2 - y1) < _MIN_SIDE_PX:
        return np.zeros((0, 2), np.float32)
    corners = cv2.goodFeaturesToTrack(
        image[y1:y2, x1:x2], _N_CORNERS, _MIN_QUALITY, _MIN_DISTANCE_PX
    )
    if corners is None:
        return np.zeros((0, 2), np.float32)
    return np.asarray(corners.reshape(-1, 2) + np.array([x1, y1], np.float32), np.float32)
