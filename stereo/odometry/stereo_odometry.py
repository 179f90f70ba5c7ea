r"""StereoOdometry: motion of a rectified pair from corners with disparities, one frame after
another.

    left t-1 --LK--> left t        m: ray of a corner, d: its disparity, rho = d / (fx B): its inverse depth
       |                           R, t: motion `now_from_before`
       LK
       v                           p' = pi(R m + t rho)
    right t-1

1. Corners outside the boxes of road users get disparities: block matching on a quarter of the size, then Lucas-Kanade.
2. Lucas-Kanade finds them in the next left image, from where the previous motion predicts them.
3. The motion of a random triple that most corners agree with is the start (RANSAC). For a small rotation w
   a triple is a linear system, exact in t: p' (m + w x m + t rho)_z = (m + w x m + t rho)_xy.
4. Gauss-Newton minimises the reprojection errors, weighted by the Tukey function and the inverse of their variance
   noise^2 + disparity_noise^2 |d p' / d d|^2, so that uncertain depths have little weight.

The static scene is assumed to have the most corners outside the boxes.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import cv2
import numpy as np

from track_range.foundation.arrays import BoolArray, FloatArray, FloatArray32, Image, check_shape
from track_range.foundation.robust_statistics import median_of
from track_range.foundation.sparse_flow import (
    BackgroundFlow,
    FlowFrame,
    are_masked,
    halved,
    small_grey,
    tracked_corners,
)
from track_range.stereo.geometry.alignment import Alignment, column_from_axis
from track_range.stereo.geometry.frames import Frame
from track_range.stereo.geometry.rig import StereoRig
from track_range.stereo.odometry.ego_motion import EgoMotion
from track_range.stereo.odometry.right_camera import RightCamera
from track_range.stereo.odometry.right_camera_monitor import RightCameraMonitor
from track_range.stereo.odometry.speed_filter import SpeedFilter

# residual, in standard deviations, above which the weight is 0 (95 % efficiency with normal noise)
_TUKEY = 4.685
_N_ROUNDS = 5  # rounds of Gauss-Newton; the last one changes the translation by less than 1 mm
# the same with a free offset of the inverse depths, while it changes by more than some sigmas
_N_OFFSET_ROUNDS, _LARGE_OFFSET_SIGMAS = 5, 2.0
# random triples of corners: of half static ones, one is all static with a probability of 99.5 %
_N_TRIPLES = 40
_CHI2_MEDIAN = 1.386  # median of the chi-squared distribution with 2 degrees of freedom
# largest squared Mahalanobis distance of a static corner, which 1.1 % of them exceed
_MAX_DISTANCE2 = 9.0
_MIN_RATIO = 0.05  # smallest ratio of the depths now and before; a nearer point leaves the image
_BLOCK_PX = 9  # side of the blocks of the coarse matcher, pixels of the quarter-size image
_MIN_SIDE_PX = 64  # smallest side of a small image that has room for windows in its halved copy

# Tracking of corners; in pixels of the small image:
_N_FEATURES = 300  # largest number of corners
_MIN_QUALITY = 0.001  # minimum quality of a corner, as a fraction of the best corner's
_WINDOW_PX = 9  # side of the tracked window
_N_LEVELS = 4  # pyramid levels above the small image for tracking over time
_N_LEVELS_PREDICTED = 2  # the same with a predicted motion
_NOISE_PX = 0.15  # standard deviation of a corner tracked over time; larger residuals raise both
# Standard deviation of a disparity; with both and an exact alignment, the rms error of the speed on
# simulated drives is 0.7 (seeds 0-9) and 0.6 (20-29) of its sigma.
_DISPARITY_NOISE_PX = 0.15
_MAX_ROW_PX = 0.75  # largest difference of rows between left and right
_MIN_DISPARITY_PX = 0.5
_NEAREST_M = 3.2  # nearest point of the scene; sets the largest disparity

# Limits of reliable motions:
_MIN_FEATURES = 20  # minimum number of static corners
# minimum fraction of static corners among those tracked with a disparity
_MIN_STATIC_FRACTION = 0.35
_MAX_NOISE_FACTOR = 5.0  # largest ratio of the residuals to those expected
_MAX_SIGMA_MPS = 0.5  # largest standard deviation of a reliable speed
_MAX_RELATIVE_SIGMA = 0.05  # the same as a fraction of the speed; one of the two suffices
_SCALE_SIGMA = 0.005  # relative error of all speeds, from calibration and subpixel bias
_MAX_STILL_MPS = 0.15  # largest speed of a camera at rest
_MAX_GAP_S = 0.6  # longest time between two frames


class _View(NamedTuple):
    """Time, small left image, (N, 2) corners and (N,) disparities of one frame, in small pixels."""

    time_s: float
    left: Image
    corners: FloatArray32
    disparity_px: FloatArray


class RigidMotion(NamedTuple):
    """Motion `now_from_before`: (3, 3) rotation R and (3,) translation t in metres."""

    rotation: FloatArray
    translation_m: FloatArray

    def moved(self, rays: FloatArray, inverse_depth: FloatArray) -> FloatArray:
        """(N, 3) R m + t rho of rays (N, 3) with inverse depths (N,) in 1/m: the points scaled by
        rho.
        """
        return np.asarray(rays @ self.rotation.T + inverse_depth[:, None] * self.translation_m)

    def moved_by(self, step: FloatArray) -> RigidMotion:
        """The motion after a small change (6,) of rotation and translation."""
        return RigidMotion(_rotation(step[:3]) @ self.rotation, self.translation_m + step[3:])


AT_REST = RigidMotion(np.eye(3), np.zeros(3))


class MotionFit(NamedTuple):
    """A motion fitted to N points."""

    motion: RigidMotion  # the motion
    covariance: FloatArray  # (6, 6) of rotation and translation
    # (6,) change of rotation and translation per common error of all inverse depths, in 1/m
    by_offset: FloatArray
    # common error of all inverse depths that fits best, in 1/m, and its standard deviation
    offset: tuple[float, float]
    is_static: BoolArray  # (N,) which points agree with it
    noise_factor: float  # ratio of the residuals to those expected, at least 1


class _Tracked(NamedTuple):
    """Corners of the previous frame that were found in this one."""

    fit: MotionFit
    points: FloatArray32  # (N, 2) in this frame, small pixels
    disparity_px: FloatArray  # (N,) disparities in this frame by the motion, small pixels

    @property
    def reliable(self) -> MotionFit | None:
        """The motion, if enough corners are static and fit it."""
        fit = self.fit
        has_static = (
            fit.is_static.sum() >= _MIN_FEATURES and fit.is_static.mean() >= _MIN_STATIC_FRACTION
        )
        return fit if has_static and fit.noise_factor <= _MAX_NOISE_FACTOR else None

    @property
    def static(self) -> tuple[FloatArray32, FloatArray]:
        """(M, 2) points and (M,) disparities of the static ones."""
        return self.points[self.fit.is_static], self.disparity_px[self.fit.is_static]


class _Matches(NamedTuple):
    """N points of a frame in both images, in small pixels."""

    left: FloatArray32  # (N, 2)
    right: FloatArray32  # (N, 2) in the corrected right image
    expected_px: FloatArray  # (N,) disparities there by the motion; NaN = unknown
    is_corner: BoolArray  # (N,) whether a new corner, not a tracked point


class StereoOdometry:
    """Measures the motion of a rectified pair; the state belongs to the instance.

    `alignment` corrects its disparities; None = that of each frame, or of the rig. Other estimators may use the same
    `flow` of the background in the left images; None = a separate one. Raises ValueError if the rig
    is not rectified.
    """

    source = "stereo odometry"

    def __init__(
        self,
        rig: StereoRig,
        alignment: Alignment | None = None,
        *,
        flow: BackgroundFlow | None = None,
    ) -> None:
        if not rig.is_rectified:
            raise ValueError("rig: expected a rectified pair")
        self._rig, self._given = rig, alignment
        self._image_hw = rig.left.height_px, rig.left.width_px
        self._flow = flow or BackgroundFlow()
        self._n_halved = self._flow.n_halvings(self._image_hw)
        self._focal_px = rig.left.fx_px / (1 << self._n_halved)
        self._focal_baseline_m = self._focal_px * rig.baseline_m
        # block matching on the halved small images, for the start of Lucas-Kanade
        self._n_disparities = 16 * max(1, math.ceil(self._focal_baseline_m / _NEAREST_M / 2 / 16))
        self._coarse = cv2.StereoBM.create(self._n_disparities, _BLOCK_PX)
        self._coarse.setTextureThreshold(5)
        self._coarse.setUniquenessRatio(5)
        self._before: _View | None = None
        self._right = RightCameraMonitor(rig)
        self._filter = SpeedFilter()
        self._motion = AT_REST
        self._rng = np.random.default_rng(0)

    def update(self, frame: Frame, xyxy_px: FloatArray) -> EgoMotion:
        """Motion since the previous frame, with boxes (N, 4) of road users in the rectified left
        image.

        Unknown for the first frame, after a gap, without a right image, and where it is not
        reliable.
        """
        check_shape("xyxy_px", xyxy_px, (None, 4))
        check_shape(
            "left", frame.left[:, :, 0] if frame.left.ndim == 3 else frame.left, self._image_hw
        )
        before, self._before = self._before, None
        self._flow.add(frame.left, xyxy_px, frame.time_s)
        now = self._flow.now
        if frame.right is None or now is None or min(now.small.shape) < _MIN_SIDE_PX:
            return EgoMotion()
        own = self._given or self._rig.alignment_of(frame)
        self._right.follow(own)
        warped = self._right.now
        right = small_grey(warped.warped(frame.right), self._n_halved)
        if before is not None and not 0 < frame.time_s - before.time_s <= _MAX_GAP_S:
            before = None
        tracked = None if before is None else self._tracked(before, now)
        fit = None if tracked is None else tracked.reliable
        matches = self._matches(now, right, warped.alignment, tracked)
        dt_s = frame.time_s - (frame.time_s if before is None else before.time_s)
        moved = self._right_moved(matches, fit, frame.time_s, dt_s)
        self._before = self._view(frame.time_s, now.small, matches, (warped, moved))
        if before is None:
            return EgoMotion()
        if fit is not None:
            speed_mps, sigma_mps, systematic_mps = self._speed(fit, dt_s, moved.alignment)
            if sigma_mps <= max(_MAX_SIGMA_MPS, _MAX_RELATIVE_SIGMA * abs(speed_mps)):
                self._motion = fit.motion
                filtered = self._filter.update(
                    frame.time_s, dt_s, speed_mps, sigma_mps, systematic_mps
                )
                yaw_rad = -float(cv2.Rodrigues(fit.motion.rotation)[0][1, 0])
                return EgoMotion(*filtered, yaw_rad / dt_s, abs(speed_mps) <= _MAX_STILL_MPS)
        # without a measurement: the predicted speed, for a short time
        return EgoMotion(*self._filter.update(frame.time_s, dt_s, math.nan, math.nan, math.nan))

    @property
    def notes(self) -> tuple[str, ...]:
        """Messages for the user so far."""
        return self._right.notes

    @property
    def right_camera(self) -> RightCamera:
        """How the right camera moved so far against its rig."""
        return self._right.now

    def _matches(
        self, frame: FlowFrame, right: Image, alignment: Alignment, tracked: _Tracked | None
    ) -> _Matches:
        """Corners of the left image, and static points tracked to it, that are also found in the
        right image.
        """
        corners = frame.corners.points[: frame.corners.n_good(_N_FEATURES, _MIN_QUALITY)]
        coarse_px = self._coarse_disparities(frame.small, right, corners)
        is_known = np.isfinite(coarse_px)
        corners, start_px = corners[is_known], coarse_px[is_known]
        n_corners = len(corners)
        expected_px = np.full(n_corners, np.nan)
        if tracked is not None and tracked.reliable is not None:
            points, disparity_px = tracked.static
            measured_px = disparity_px - self._correction_px(points, alignment)
            corners = np.concatenate([corners, points])
            start_px = np.concatenate([start_px, measured_px])
            expected_px = np.concatenate([expected_px, measured_px])
        start = corners - np.stack([start_px, np.zeros(len(corners))], axis=1).astype(np.float32)
        matches, is_matched = tracked_corners(
            frame.small, right, corners, window_px=_WINDOW_PX, n_levels=1, start=start
        )
        disparity_px, row_px = (corners - matches).astype(np.float64).T
        centre_px = float(np.median(row_px[is_matched])) if is_matched.any() else 0.0
        if abs(centre_px) < _MAX_ROW_PX / 2:
            centre_px = 0.0
        is_matched &= np.abs(row_px - centre_px) <= _MAX_ROW_PX
        return _Matches(
            corners[is_matched],
            matches[is_matched],
            expected_px[is_matched],
            np.arange(len(corners))[is_matched] < n_corners,
        )

    def _right_moved(
        self, matches: _Matches, fit: MotionFit | None, time_s: float, dt_s: float
    ) -> RightCamera:
        """How the right camera moved, by the matches of a frame."""
        if not dt_s:
            return self._right.now
        offset_px = math.nan, math.nan
        if fit is not None:
            per_inverse_depth = self._focal_baseline_m * (1 << self._n_halved)
            offset_px = fit.offset[0] * per_inverse_depth, fit.offset[1] * per_inverse_depth
        return self._right.update(
            time_s,
            dt_s,
            self._full(matches.left),
            self._full(matches.right),
            matches.expected_px * (1 << self._n_halved),
            offset_px,
        )

    def _view(
        self,
        time_s: float,
        left: Image,
        matches: _Matches,
        moved: tuple[RightCamera, RightCamera],
    ) -> _View:
        """The corners of a frame, with the disparities after the second correction of the right
        camera; the images have the first one.
        """
        warped, right = moved
        corners = matches.left[matches.is_corner]
        factor = 1 << self._n_halved
        points = right.moved_from(warped, self._full(matches.right[matches.is_corner]))
        disparity_px, row_px = (self._full(corners) - points).T / factor
        is_used = (disparity_px >= _MIN_DISPARITY_PX) & (np.abs(row_px) <= _MAX_ROW_PX)
        corners, disparity_px = corners[is_used], disparity_px[is_used]
        correction_px = self._correction_px(corners, right.alignment)
        return _View(time_s, left, corners, disparity_px + correction_px)

    def _correction_px(self, points: FloatArray32, alignment: Alignment) -> FloatArray:
        """(N,) correction of the disparities of points (N, 2), in small pixels."""
        # the alignment counts in full pixels
        u = column_from_axis(self._full(points)[:, 0], self._rig.left)
        return alignment.error_px(u) / (1 << self._n_halved)

    def _full(self, points: FloatArray32) -> FloatArray:
        """(N, 2) points of the small image in full pixels."""
        factor = 1 << self._n_halved
        return np.asarray(factor * points.astype(np.float64) + (factor - 1) / 2)

    def _coarse_disparities(self, left: Image, right: Image, corners: FloatArray32) -> FloatArray:
        """(N,) disparities of corners (N, 2) of the small left image, small pixels; NaN =
        unknown.
        """
        pad = self._n_disparities
        images = [
            cv2.copyMakeBorder(halved(image), 0, 0, pad, 0, cv2.BORDER_REPLICATE)
            for image in (left, right)
        ]
        steps = self._coarse.compute(*images)[:, pad:]
        column = np.clip((corners[:, 0] - 0.5) / 2 + 0.5, 0, steps.shape[1] - 1).astype(int)
        row = np.clip((corners[:, 1] - 0.5) / 2 + 0.5, 0, steps.shape[0] - 1).astype(int)
        disparity_px = steps[row, column] / 8.0  # sixteenths of pixels of half the size
        return np.where(disparity_px >= 0, disparity_px, np.nan)

    def _tracked(self, before: _View, now: FlowFrame) -> _Tracked | None:
        """The corners of the previous frame in this one, and the motion that fits them; None if
        there are too few.
        """
        rays = self._rays(before.corners)
        inverse_depth = before.disparity_px / self._focal_baseline_m
        predicted = self._pixels(self._motion.moved(rays, inverse_depth)).astype(np.float32)
        points, is_tracked = tracked_corners(
            before.left,
            now.small,
            before.corners,
            window_px=_WINDOW_PX,
            n_levels=_N_LEVELS if self._motion is AT_REST else _N_LEVELS_PREDICTED,
            start=np.where(np.isfinite(predicted), predicted, before.corners),
        )
        is_tracked[is_tracked] = ~are_masked(points[is_tracked], now.is_masked)
        self._motion = AT_REST
        if is_tracked.sum() < _MIN_FEATURES:
            return None
        rays, inverse_depth = rays[is_tracked], inverse_depth[is_tracked]
        fit = fit_motion(
            rays,
            inverse_depth,
            self._rays(points[is_tracked]),
            noise=_NOISE_PX / self._focal_px,
            inverse_depth_noise=_DISPARITY_NOISE_PX / self._focal_baseline_m,
            rng=self._rng,
            expected_offset=self._right.expected_offset_px
            / (self._focal_baseline_m * (1 << self._n_halved)),
        )
        depth_ratio = fit.motion.moved(rays, inverse_depth)[:, 2]
        disparity_px = inverse_depth * self._focal_baseline_m / np.maximum(depth_ratio, _MIN_RATIO)
        return _Tracked(fit, points[is_tracked], disparity_px)

    def _speed(
        self, fit: MotionFit, dt_s: float, alignment: Alignment
    ) -> tuple[float, float, float]:
        """Speed along the optical axis, its independent standard deviation, and the deviation
        common to all frames.
        """
        # z of the displacement -R^T t
        forward_m = -float(fit.motion.rotation[:, 2] @ fit.motion.translation_m)
        speed_mps, sigma_mps = forward_m / dt_s, math.sqrt(fit.covariance[5, 5]) / dt_s
        alignment_sigma_px = alignment.residual_px / (1 << self._n_halved)
        offset = alignment_sigma_px / self._focal_baseline_m
        return (
            speed_mps,
            sigma_mps,
            math.hypot(fit.by_offset[5] * offset / dt_s, _SCALE_SIGMA * speed_mps),
        )

    def _rays(self, points: FloatArray32) -> FloatArray:
        """(N, 3) rays of points (N, 2) of the small image."""
        factor = 1 << self._n_halved
        return self._rig.left.rays(factor * points.astype(np.float64) + (factor - 1) / 2)

    def _pixels(self, xyz: FloatArray) -> FloatArray:
        """(N, 2) points of the small image, NaN behind the camera."""
        factor = 1 << self._n_halved
        return (self._rig.left.project(xyz) - (factor - 1) / 2) / factor


def fit_motion(
    rays: FloatArray,
    inverse_depth: FloatArray,
    now: FloatArray,
    *,
    noise: float,
    inverse_depth_noise: float,
    rng: np.random.Generator,
    expected_offset: float = 0.0,
) -> MotionFit:
    """Motion of the camera from N points with inverse depths.

    `rays` (N, 3) m in the previous frame and `now` (N, 3) p' in this frame have z = 1;
    `inverse_depth` (N,) is rho in 1/m. The standard deviations are `noise` of p', rad, and
    `inverse_depth_noise` of rho, 1/m; `rng` draws triples. `expected_offset` is the
    common error of all rho, near which the one that fits best is sought.
    """
    motion = _of_triples(
        rays, inverse_depth, now, noise=noise, inverse_depth_noise=inverse_depth_noise, rng=rng
    )
    points = _Points(rays, inverse_depth, now, noise, inverse_depth_noise)
    for _ in range(_N_ROUNDS):
        equations = points.equations(motion)
        information = equations.information[:6, :6]
        step = np.asarray(-np.linalg.solve(information, equations.gradient[:6]), np.float64)
        motion = motion.moved_by(step)
    by_offset = -np.linalg.solve(information, equations.information[:6, 6])
    covariance = np.linalg.inv(information) * equations.spread2
    is_static = equations.distance2 <= _MAX_DISTANCE2 * equations.spread2
    # the camera has not passed the point
    is_static &= motion.moved(rays, inverse_depth)[:, 2] > _MIN_RATIO
    return MotionFit(
        motion,
        np.asarray(covariance, np.float64),
        np.asarray(by_offset, np.float64),
        _offset(points, motion, expected_offset),
        np.asarray(is_static),
        math.sqrt(equations.spread2),
    )


class _Equations(NamedTuple):
    """Normal equations of rotation, translation and a common error of all inverse depths."""

    information: FloatArray  # (7, 7)
    gradient: FloatArray  # (7,)
    distance2: FloatArray  # (N,) squared Mahalanobis distances
    spread2: float  # ratio of the squared residuals to those expected, at least 1


class _Points(NamedTuple):
    """N points of a motion, as in `fit_motion`."""

    rays: FloatArray
    inverse_depth: FloatArray
    now: FloatArray
    noise: float
    inverse_depth_noise: float

    def equations(self, motion: RigidMotion, offset: float = 0.0) -> _Equations:
        """The normal equations at a motion and an offset of the inverse depths."""
        residual, jacobian, by_depth = _reprojection(
            motion, self.rays, self.inverse_depth + offset, self.now
        )
        variance = self.noise**2 + self.inverse_depth_noise**2 * (by_depth**2).sum(axis=0)
        distance2 = (residual**2).sum(axis=0) / variance
        spread2 = max(1.0, float(median_of(distance2)) / _CHI2_MEDIAN)
        weight = np.maximum(1 - distance2 / (_TUKEY**2 * spread2), 0.0) ** 2 / variance
        whole = np.concatenate([jacobian, by_depth[:, None]], axis=1)
        weighted = whole * weight
        information = np.asarray((weighted @ whole.transpose(0, 2, 1)).sum(axis=0), np.float64)
        information[:6, :6] += 1e-9 * np.trace(information[:6, :6]) * np.eye(6)
        gradient = np.asarray(np.einsum("ajn,an->j", weighted, residual), np.float64)
        return _Equations(information, gradient, np.asarray(distance2), spread2)


def _offset(points: _Points, motion: RigidMotion, offset: float) -> tuple[float, float]:
    """The common error of all inverse depths that fits best, with the motion that fits it, and its
    standard deviation; NaN = unknown. The search starts from a motion and an error.
    """
    sigma = math.nan
    for _ in range(_N_OFFSET_ROUNDS):
        equations = points.equations(motion, offset)
        if not equations.information[6, 6] > 0:
            return math.nan, math.nan
        covariance = np.linalg.inv(equations.information)
        step = -covariance @ equations.gradient
        sigma = math.sqrt(max(covariance[6, 6], 0.0) * equations.spread2)
        motion, offset = motion.moved_by(step[:6]), offset + float(step[6])
        if abs(step[6]) < _LARGE_OFFSET_SIGMAS * sigma:
            break
    return offset, sigma


def _rotation(vector: FloatArray) -> FloatArray:
    return np.asarray(cv2.Rodrigues(vector)[0], np.float64)


def _reprojection(
    motion: RigidMotion, rays: FloatArray, inverse_depth: FloatArray, now: FloatArray
) -> tuple[FloatArray, FloatArray, FloatArray]:
    """(2, N) reprojection errors of x and y, and their derivatives: (2, 6, N) by w and t, (2, N) by inverse depth.

    With q = R m + t rho and u = R m:  d q = w x u + rho dt + t drho,  d (q_x / q_z) = (d q_x - x d q_z) / q_z.
    """
    u_x, u_y, u_z = motion.rotation @ rays.T
    t_x, t_y, t_z = motion.translation_m.tolist()
    z = np.maximum(u_z + t_z * inverse_depth, _MIN_RATIO)
    x, y = (u_x + t_x * inverse_depth) / z, (u_y + t_y * inverse_depth) / z
    zero = np.zeros(len(z))
    by_x = [-x * u_y, u_z + x * u_x, -u_y, inverse_depth, zero, -x * inverse_depth]
    by_y = [-u_z - y * u_y, y * u_x, u_x, zero, inverse_depth, -y * inverse_depth]
    jacobian = np.array([by_x, by_y]) / z
    by_depth = np.array([t_x - x * t_z, t_y - y * t_z]) / z
    return np.array([x, y]) - now[:, :2].T, jacobian, by_depth


def _of_triples(
    rays: FloatArray,
    inverse_depth: FloatArray,
    now: FloatArray,
    *,
    noise: float,
    inverse_depth_noise: float,
    rng: np.random.Generator,
) -> RigidMotion:
    """The motion of a random triple of points, or rest, that has the smallest robust cost over all
    points.
    """
    x, y, rho = now[:, 0], now[:, 1], inverse_depth
    m_x, m_y = rays[:, 0], rays[:, 1]
    zero = np.zeros(len(x))
    columns = np.array(
        [
            [-x * m_y, 1 + x * m_x, -m_y, rho, zero, -x * rho],
            [-1 - y * m_y, y * m_x, m_x, zero, rho, -y * rho],
        ]
    )
    moved = np.array([x - m_x, y - m_y])
    triples = rng.integers(0, len(x), (_N_TRIPLES, 3))
    systems = columns[:, :, triples].transpose(2, 0, 3, 1).reshape(_N_TRIPLES, 6, 6)
    right = moved[:, triples].transpose(1, 0, 2).reshape(_N_TRIPLES, 6, 1)
    transposed = systems.transpose(0, 2, 1)
    solutions = np.linalg.solve(transposed @ systems + 1e-12 * np.eye(6), transposed @ right)[
        :, :, 0
    ]
    solutions = np.concatenate([np.zeros((1, 6)), solutions])
    error2 = ((solutions @ columns - moved[:, None]) ** 2).sum(axis=0)
    depth_change = 1.0 + solutions[:, 5:] * rho  # the equations are multiplied by z' / z
    variance = (depth_change * noise) ** 2 + (solutions[:, 3:] ** 2).sum(axis=1)[
        :, None
    ] * inverse_depth_noise**2
    best = solutions[int(np.argmin(np.minimum(error2 / variance, _MAX_DISTANCE2).sum(axis=1)))]
    return RigidMotion(_rotation(best[:3]), best[3:])
