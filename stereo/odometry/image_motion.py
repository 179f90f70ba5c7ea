r"""ImageMotion: rotation of one camera and expansion of the image between two frames; the scale remains unknown.

A static point has the ray p before and p' now, and moves on its epipolar line:

    p'^T [t]x R p = 0        R, t: rotation and direction of the translation, now from before

Both are fitted to corners outside the boxes of road users by Gauss-Newton on Sampson's distance with Tukey weights
(Hartley and Zisserman, 2004, section 11.4.3). With the rotation removed, points move away from the epipole e by
(p' - e) = (1 + g) (R p - e); the expansion is the median of g per second, the forward speed over a typical depth.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import cv2
import numpy as np

from track_range.foundation.arrays import BoolArray, FloatArray, FloatArray32, Image, check_shape
from track_range.foundation.robust_statistics import MAD_TO_SIGMA
from track_range.foundation.sparse_flow import (
    are_masked,
    grid_corners,
    masked_cells,
    n_halvings_to,
    small_grey,
    tracked_corners,
)
from track_range.stereo.geometry.camera import PinholeCamera

_TUKEY = 4.685
"""Residual, in standard deviations, above which the weight is 0 (95 % efficiency with normal noise)."""

_N_ROTATION_ROUNDS, _N_ROUNDS = 4, 9
"""Rounds of Gauss-Newton for the rotation alone, which a wrong direction cannot mislead, and in all."""

_DIRECTION_SIGMA_RAD = 0.05
"""Standard deviation of the direction of travel between frames; it decides where the points do not."""

_MIN_SIDE_PX = 32
"""Smallest side of a small image that has room for windows."""

_MIN_FORWARD = 0.5
"""Smallest forward part of a unit translation; a smaller one has no epipole near the image."""

_MIN_RADIUS = 0.03
"""Smallest distance of a ray from the epipole, at depth 1, at which its growth is measured."""


@dataclass(frozen=True, slots=True, kw_only=True)
class ImageMotionSettings:
    """Settings of feature tracking, and limits of plausible motions, in pixels of the small image.

    Attributes:
        long_side_px: the image is halved until neither side is longer.
        n_features: largest number of corners.
        min_quality: minimum quality of a corner, as a fraction of the best corner's.
        window_px: side of the tracked window.
        n_levels: pyramid levels above the small image.
        noise_px: standard deviation of a tracked corner.
        max_residual_px: largest distance of a static point from its epipolar line.
        min_features: minimum number of static points.
        min_static_share: minimum fraction of static points among the tracked ones.
        max_still_px: largest median motion of the static points of a camera at rest.
        max_gap_s: longest time between two frames.
    """

    long_side_px: int = 640
    n_features: int = 200
    min_quality: float = 0.003
    window_px: int = 9
    n_levels: int = 4
    noise_px: float = 0.1
    max_residual_px: float = 0.5
    min_features: int = 16
    min_static_share: float = 0.4
    max_still_px: float = 0.1
    max_gap_s: float = 0.6


@dataclass(frozen=True, slots=True, kw_only=True)
class ImageMotion:
    """Motion between a frame and the previous one; rates are NaN where the motion is unknown.

    Attributes:
        time_s: time of the frame.
        dt_s: time since the previous frame; NaN for the first one.
        yaw_rad_s: rate of the heading, positive = to the right.
        yaw_sigma_rad_s: its standard deviation.
        pitch_rad_s: pitch rate, positive = upwards.
        roll_rad_s: roll rate, positive = clockwise as the driver sees it.
        expansion_hz: median relative growth of the distances from the epipole per second, positive = forwards.
        expansion_sigma_hz: its standard deviation.
        epipole_px: x, y of the direction of travel in full pixels, NaN = unknown.
        static_share: fraction of the tracked corners that move like a static scene.
        n_features: number of tracked corners.
        is_still: whether the camera is at rest; False if unknown.
    """

    time_s: float
    dt_s: float = math.nan
    yaw_rad_s: float = math.nan
    yaw_sigma_rad_s: float = math.nan
    pitch_rad_s: float = math.nan
    roll_rad_s: float = math.nan
    expansion_hz: float = math.nan
    expansion_sigma_hz: float = math.nan
    epipole_px: tuple[float, float] = (math.nan, math.nan)
    static_share: float = math.nan
    n_features: int = 0
    is_still: bool = False

    @property
    def is_known(self) -> bool:
        """Whether the motion was measured."""
        return math.isfinite(self.yaw_rad_s)


@dataclass(frozen=True, slots=True)
class _View:
    """Time, small grey image and (N, 2) corners of one frame."""

    time_s: float
    grey: Image
    corners: FloatArray32


class ImageMotionEstimator:
    """Measures the motion of one camera, one frame after another.

    Args:
        camera: the camera without distortion; an approximate focal length suffices for correlations.
        settings: None = the defaults.
    """

    def __init__(self, camera: PinholeCamera, settings: ImageMotionSettings | None = None) -> None:
        self._camera = camera
        self._settings = settings or ImageMotionSettings()
        self._n_halved = n_halvings_to(self._settings.long_side_px, (camera.height_px, camera.width_px))
        self._before: _View | None = None
        self._direction = np.array([0.0, 0.0, -1.0])

    def update(self, image: Image, time_s: float, xyxy_px: FloatArray | None = None) -> ImageMotion:
        """Motion since the previous frame, which must be earlier; unknown for the first frame and after a gap.

        Args:
            image: (H, W, 3) BGR or (H, W) grey, of the size of the camera.
            time_s: time of the frame.
            xyxy_px: (N, 4) boxes of road users, which are not static; None = none known.

        Raises:
            ValueError: an argument has another shape.
        """
        check_shape("image", image[:, :, 0] if image.ndim == 3 else image, self._image_hw)
        boxes = np.zeros((0, 4)) if xyxy_px is None else xyxy_px
        check_shape("xyxy_px", boxes, (None, 4))
        before, self._before = self._before, None
        if min(self._image_hw) >> self._n_halved < _MIN_SIDE_PX:
            return ImageMotion(time_s=time_s)
        grey = small_grey(image, self._n_halved)
        is_masked = masked_cells(boxes, grey.shape, self._n_halved)
        settings = self._settings
        corners = grid_corners(grey, is_masked, settings.n_features, min_quality=settings.min_quality)
        self._before = _View(time_s, grey, corners)
        if before is None or not 0 < time_s - before.time_s <= settings.max_gap_s:
            return ImageMotion(time_s=time_s)
        return self._motion(before, self._before, is_masked)

    @property
    def _image_hw(self) -> tuple[int, int]:
        return self._camera.height_px, self._camera.width_px

    def _motion(self, before: _View, now: _View, is_masked: BoolArray) -> ImageMotion:
        settings, dt_s = self._settings, now.time_s - before.time_s
        points, is_tracked = tracked_corners(
            before.grey, now.grey, before.corners, window_px=settings.window_px, n_levels=settings.n_levels
        )
        is_tracked[is_tracked] = ~are_masked(points[is_tracked], is_masked)
        n_features = int(is_tracked.sum())
        if n_features < settings.min_features:
            return ImageMotion(time_s=now.time_s, dt_s=dt_s, n_features=n_features)
        focal_px = self._camera.fx_px / (1 << self._n_halved)
        pair = self._rays(before.corners[is_tracked]), self._rays(points[is_tracked])
        fit = fit_epipolar(
            *pair,
            direction=self._direction,
            noise=settings.noise_px / focal_px,
            max_residual=settings.max_residual_px / focal_px,
        )
        static_share = float(fit.is_static.mean())
        if fit.is_static.sum() < settings.min_features or static_share < settings.min_static_share:
            return ImageMotion(time_s=now.time_s, dt_s=dt_s, n_features=n_features, static_share=static_share)
        turned = _turned(pair[0], fit.rotation)
        motion_px = focal_px * np.linalg.norm((pair[1] - turned)[fit.is_static], axis=1)
        is_still = bool(np.median(motion_px) <= settings.max_still_px)
        if not is_still:
            self._direction = fit.direction
        growth, growth_sigma = _growth(turned[fit.is_static], pair[1][fit.is_static], fit.direction)
        pitch, yaw, roll = (-rate / dt_s for rate in fit.rotation.tolist())  # the camera turns against the scene
        return ImageMotion(
            time_s=now.time_s,
            dt_s=dt_s,
            yaw_rad_s=yaw,
            yaw_sigma_rad_s=float(fit.rotation_sigma[1]) / dt_s,
            pitch_rad_s=pitch,
            roll_rad_s=roll,
            expansion_hz=0.0 if is_still else growth / dt_s,
            expansion_sigma_hz=growth_sigma / dt_s,
            epipole_px=(math.nan, math.nan) if is_still else self._epipole_px(fit.direction),
            static_share=static_share,
            n_features=n_features,
            is_still=is_still,
        )

    def _rays(self, points: FloatArray32) -> FloatArray:
        """(N, 3) rays of points (N, 2) of the small image."""
        factor = 1 << self._n_halved
        return self._camera.rays(factor * points.astype(np.float64) + (factor - 1) / 2)

    def _epipole_px(self, direction: FloatArray) -> tuple[float, float]:
        if abs(direction[2]) < _MIN_FORWARD:
            return math.nan, math.nan
        x, y = (direction[:2] / direction[2]).tolist()
        return self._camera.fx_px * x + self._camera.cx_px, self._camera.fy_px * y + self._camera.cy_px


@dataclass(frozen=True, slots=True)
class EpipolarFit:
    """Rotation and direction of travel between two frames.

    Attributes:
        rotation: (3,) rotation vector `now_from_before`, rad.
        rotation_sigma: (3,) its standard deviations.
        direction: (3,) unit vector t of the translation `now_from_before`; (0, 0, -1) = straight ahead.
        is_static: (N,) whether a point is near its epipolar line.
    """

    rotation: FloatArray
    rotation_sigma: FloatArray
    direction: FloatArray
    is_static: BoolArray


def fit_epipolar(
    before: FloatArray, now: FloatArray, *, direction: FloatArray, noise: float, max_residual: float
) -> EpipolarFit:
    """Rotation and direction of the translation from rays (N, 3) with z = 1 of the same points in both frames.

    Args:
        before: rays in the previous frame.
        now: rays in this frame.
        direction: (3,) unit translation from which the iteration starts.
        noise: standard deviation of a ray, rad.
        max_residual: largest Sampson distance of a static point, rad.
    """
    w, t = _first_rotation(before, now), direction
    prior = np.diag([0.0, 0.0, 0.0, 1.0, 1.0]) / _DIRECTION_SIGMA_RAD**2
    for k in range(_N_ROUNDS):
        residual, jacobian, tangents = _sampson(before, now, w, t)
        sigma = max(MAD_TO_SIGMA * float(np.median(np.abs(residual))), noise)
        weight = (1.0 - np.minimum(np.abs(residual) / (_TUKEY * sigma), 1.0) ** 2) ** 2
        weighted = jacobian * (weight / sigma**2)[:, None]
        away = np.concatenate([np.zeros(3), tangents @ (t - direction)])
        information = np.asarray(weighted.T @ jacobian + prior, np.float64)
        gradient = weighted.T @ residual + prior @ away
        if k < _N_ROTATION_ROUNDS:
            w = _composed(-_solution(information[:3, :3], gradient[:3]), w)
        else:
            step = -_solution(information, gradient)
            w = _composed(step[:3], w)
            t = t + tangents.T @ step[3:]
            t = t / np.linalg.norm(t)
    residual = _sampson(before, now, w, t)[0]
    covariance = np.linalg.inv(information)
    t = t * _sign(before, now, w, t)
    return EpipolarFit(w, np.sqrt(np.diag(covariance)[:3]), t, np.asarray(np.abs(residual) <= max_residual))


def _solution(matrix: FloatArray, vector: FloatArray) -> FloatArray:
    """Solution of linear equations with a symmetric matrix that is singular if too few points have weight."""
    return np.asarray(np.linalg.solve(matrix + 1e-9 * np.trace(matrix) * np.eye(len(matrix)), vector), np.float64)


def _first_rotation(before: FloatArray, now: FloatArray) -> FloatArray:
    """(3,) yaw and pitch of the median motion of the rays."""
    x, y = np.median(now[:, :2] - before[:, :2], axis=0).tolist()
    return np.array([-y, x, 0.0])


def _turned(rays: FloatArray, rotation: FloatArray) -> FloatArray:
    """Rays (N, 3) after a rotation (3,), scaled to z = 1."""
    turned = rays @ cv2.Rodrigues(rotation)[0].T
    return np.asarray(turned / turned[:, 2:])


def _composed(later: FloatArray, earlier: FloatArray) -> FloatArray:
    """(3,) rotation vector of two rotations, one after the other."""
    return np.asarray(cv2.Rodrigues(cv2.Rodrigues(later)[0] @ cv2.Rodrigues(earlier)[0])[0], np.float64).reshape(3)


def _sampson(
    before: FloatArray, now: FloatArray, w: FloatArray, t: FloatArray
) -> tuple[FloatArray, FloatArray, FloatArray]:
    """(N,) Sampson distances, their derivatives (N, 5) by rotation and direction, and the (2, 3) tangents of t."""
    q = before @ cv2.Rodrigues(w)[0].T
    line = np.cross(t, q)  # p'^T [t]x q = p' . line
    back = np.cross(now, t)  # = q . back
    scale = np.sqrt((line[:, :2] ** 2).sum(axis=1) + (back[:, :2] ** 2).sum(axis=1)) + 1e-9
    first = np.cross(t, [0.0, 1.0, 0.0] if abs(t[1]) < 0.9 else [1.0, 0.0, 0.0])
    first = first / np.linalg.norm(first)
    tangents = np.stack([first, np.cross(t, first)])
    by_rotation = np.cross(q, back)  # d(q . back) for q + dw x q = dw . (q x back)
    by_direction = np.cross(q, now) @ tangents.T  # d(p' . (t x q)) = dt . (q x p')
    jacobian = np.concatenate([by_rotation, by_direction], axis=1) / scale[:, None]
    return np.asarray((now * line).sum(axis=1) / scale, np.float64), jacobian, np.asarray(tangents, np.float64)


def _sign(before: FloatArray, now: FloatArray, w: FloatArray, t: FloatArray) -> float:
    """1 if the points move as by the translation t, -1 if as by -t: the epipolar lines of both are the same."""
    flow, expected = now - _turned(before, w), t - now * t[2]  # the flow is (t - p' t_z) / z for a point at depth z
    return -1.0 if np.median((flow * expected).sum(axis=1)) < 0 else 1.0


def _growth(turned: FloatArray, now: FloatArray, direction: FloatArray) -> tuple[float, float]:
    """Median growth of the distances from the epipole, and its standard deviation."""
    forward = direction[2] if abs(direction[2]) >= _MIN_FORWARD else math.copysign(1.0, direction[2])
    epipole = direction[:2] / forward if abs(direction[2]) >= _MIN_FORWARD else np.zeros(2)
    from_epipole = turned[:, :2] - epipole
    radius2 = (from_epipole**2).sum(axis=1)
    is_far = radius2 >= _MIN_RADIUS**2
    if not is_far.any():
        return math.nan, math.nan
    growth = ((now[:, :2] - epipole) * from_epipole).sum(axis=1)[is_far] / radius2[is_far] - 1.0
    spread = MAD_TO_SIGMA * float(np.median(np.abs(growth - np.median(growth))))
    return float(np.median(growth)), 1.25 * spread / math.sqrt(len(growth))
