r"""StereoOdometry: motion of a rectified pair from corners with disparities, one frame after
another.

    left t-1 --LK--> left t        m: ray of a corner, d: its disparity, rho = d / (fx B): its inverse depth
       |                           R, t: motion `now_from_before`
       LK
       v                           p' = pi(R m + t rho)
    right t-1

1. Corners outside the boxes of road users get disparities: block matching on a quarter of the size, then Lucas-Kanade.
2. Lucas-Kanade finds them in the next left image, from where the previous motion predicts them.
3. The previous motion is the start, if most corners agree with a motion near it, or else that of a random triple that
   most agree with (RANSAC). For a small rotation w, a triple is a linear system, exact in t:
   p' (m + w x m + t rho)_z = (m + w x m + t rho)_xy.
4. Gauss-Newton minimises the reprojection errors, weighted by the Tukey function and the inverse of their variance
   noise^2 + disparity_noise^2 |d p' / d d|^2, so that uncertain depths have little weight.

The static scene is assumed to have the most corners outside the boxes.
"""

from __future__ import annotations

import math
from dataclasses import replace
from typing import NamedTuple

import cv2
import numpy as np

from track_range.foundation.arrays import (
    BoolArray,
    FloatArray,
    FloatArray32,
    Image,
    IntArray,
    check_shape,
)
from track_range.foundation.background import Background
from track_range.foundation.errors import Note
from track_range.foundation.robust_statistics import median_of
from track_range.foundation.sparse_flow import (
    BackgroundFlow,
    FlowFrame,
    halved,
    small_grey,
    tracked_corners,
)
from track_range.stereo.alignment.health import Move
from track_range.stereo.geometry.alignment import Alignment, column_from_axis
from track_range.stereo.geometry.frames import Frame
from track_range.stereo.geometry.rig import StereoRig
from track_range.stereo.odometry.common_zoom import common_zoom
from track_range.stereo.odometry.ego_motion import EgoMotion
from track_range.stereo.odometry.motion_fit import (
    AT_REST,
    MIN_RATIO,
    MotionFit,
    RigidMotion,
    fit_motion,
)
from track_range.stereo.odometry.speed_filter import SpeedFilter
from track_range.stereo.odometry.vibration import Vibration
from track_range.stereo.right_camera.correction import RightCamera
from track_range.stereo.right_camera.monitor import RightCameraMonitor
from track_range.stereo.right_camera.realignment import Realignment

_BLOCK_PX = 9  # side of the blocks of the coarse matcher, pixels of the quarter-size image
_MIN_SIDE_PX = 64  # smallest side of a small image that has room for windows in its halved copy

# Tracking of corners; in pixels of the small image:
_N_FEATURES = 300  # largest number of corners
_MIN_QUALITY = 0.001  # minimum quality of a corner, as a fraction of the best corner's
_WINDOW_PX = 9  # side of the tracked window
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
# difference of the offset from the expected one at which the motion is not that of a rigid scene
_UNUSUAL_SIGMAS = 5.0
_MAX_GAP_S = 0.6  # longest time between two frames


class _View(NamedTuple):
    """Corners of one frame with disparities, in small pixels."""

    time_s: float
    number: IntArray  # (N,) numbers of the corners in the flow of the background
    rays: FloatArray  # (N, 3)
    inverse_depth: FloatArray  # (N,) in 1/m
    motion: RigidMotion  # to the next frame, as it is expected; at rest = unknown
    # (N, 2) points and (N,) disparities in the next frame by this motion
    expected: FloatArray32
    expected_px: FloatArray


class _Tracked(NamedTuple):
    """N corners of the previous frame that were found in this one, in small pixels."""

    fit: MotionFit
    points: FloatArray32  # (N, 2) in this frame
    # (N, 2) points and (N,) disparities in this frame, expected by the motion before
    expected: FloatArray32
    expected_px: FloatArray
    disparity_px: FloatArray  # (N,) disparities in this frame by the motion that fits
    expected_offset: float  # of the fit

    @property
    def reliable(self) -> MotionFit | None:
        """The motion, if enough corners are static and fit it."""
        fit = self.fit
        has_static = (
            fit.is_static.sum() >= _MIN_FEATURES and fit.is_static.mean() >= _MIN_STATIC_FRACTION
        )
        return fit if has_static and fit.noise_factor <= _MAX_NOISE_FACTOR else None

    @property
    def is_usual(self) -> bool:
        """Whether a motion fits with about the offset of the inverse depths that is expected."""
        offset, sigma = self.fit.offset
        is_near = abs(offset - self.expected_offset) < _UNUSUAL_SIGMAS * sigma
        return self.reliable is not None and is_near

    @property
    def static(self) -> tuple[IntArray, FloatArray]:
        """(M,) numbers of the static points, and their disparities (M,); those of all points by the
        motion before, if no usual one fits them.
        """
        if not self.is_usual:
            is_known = np.isfinite(self.expected_px)
            return np.flatnonzero(is_known), self.expected_px[is_known]
        number = np.flatnonzero(self.fit.is_static)
        return number, self.disparity_px[number]


class _Static(NamedTuple):
    """N static points that were tracked to a frame, in small pixels."""

    number: IntArray  # (N,) numbers of the tracked points
    points: FloatArray32  # (N, 2)
    disparity_px: FloatArray  # (N,) in the corrected right image, by the motion


class _Matches(NamedTuple):
    """N points of a frame in both images, in small pixels."""

    left: FloatArray32  # (N, 2)
    right: FloatArray32  # (N, 2) in the corrected right image
    expected_px: FloatArray  # (N,) disparities there by the motion; NaN = unknown
    number: IntArray  # (N,) numbers of tracked points; -1 = a new corner
    corner: IntArray  # (N,) numbers of new corners; -1 = a tracked point

    @property
    def is_corner(self) -> BoolArray:
        """(N,) whether a new corner, not a tracked point."""
        return self.number < 0


class StereoOdometry:
    """Measures the motion of a rectified pair; the state belongs to the instance.

    `alignment` corrects its disparities; None = that of each frame, or of the rig. Other estimators
    may use the same `flow` of the background in the left images; None = a separate one. Raises
    ValueError if the rig is not rectified.
    """

    source = "stereo odometry"

    def __init__(
        self,
        rig: StereoRig,
        alignment: Alignment | None = None,
        *,
        flow: BackgroundFlow | None = None,
        background: Background | None = None,
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
        self._right, self._realignment = RightCameraMonitor(rig), Realignment(rig, background)
        self._vibration = Vibration()
        self._focal_factor, self._zoomed_s = 1.0, math.nan
        self._filter = SpeedFilter()
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
        self._right.follow(self._given or self._rig.alignment_of(frame))
        warped = self._right.now
        right = small_grey(warped.warped(frame.right), self._n_halved)
        if before is not None and not self._follows(before, frame.time_s):
            before = None
        tracked = None if before is None else self._tracked(before)
        fit = None if tracked is None else tracked.reliable
        matches = self._matches(now, right, warped.alignment, tracked)
        dt_s = frame.time_s - (frame.time_s if before is None else before.time_s)
        is_usual = tracked is not None and tracked.is_usual
        if not is_usual:
            zoom = 0.0 if tracked is None else self._zoom(matches, tracked)
            if zoom:
                self._focal_factor *= 1 + zoom
                self._zoomed_s, fit = frame.time_s, None
            matches = matches._replace(expected_px=np.full(len(matches.number), np.nan))
        moved = self._right_moved(matches, fit, frame.time_s, dt_s)
        is_aligned_again = self._realign(frame, tracked, matches)
        motion, ego = AT_REST, EgoMotion()
        if before is not None:
            motion, ego = self._moved(frame.time_s, dt_s, fit, moved.alignment)
        if not is_aligned_again:
            self._before = self._view(now, matches, (warped, moved), motion)
        return ego

    def _moved(
        self, time_s: float, dt_s: float, fit: MotionFit | None, alignment: Alignment
    ) -> tuple[RigidMotion, EgoMotion]:
        """The motion to the next frame, as it is expected, at rest = unknown, and the motion since
        the previous frame.
        """
        self._vibration.add(time_s, None if fit is None else fit.rotation_rad)
        if fit is not None:
            speed_mps, sigma_mps, systematic_mps = self._speed(fit, dt_s, alignment)
            speed_mps += self._right.missed_offset_px * self._by_offset_px(fit) / dt_s
            if sigma_mps <= max(_MAX_SIGMA_MPS, _MAX_RELATIVE_SIGMA * abs(speed_mps)):
                filtered = self._filter.update(time_s, dt_s, speed_mps, sigma_mps, systematic_mps)
                yaw_rad = -float(fit.rotation_rad[1])
                shows_rest = abs(speed_mps) <= _MAX_STILL_MPS
                return fit.motion, EgoMotion(
                    *filtered,
                    yaw_rad / dt_s,
                    self._filter.is_rest(filtered, shows_rest=shows_rest),
                    noise_mps=self._filter.noise_mps,
                    is_predicted=not self._filter.is_measured,
                )
        # without a measurement: the predicted speed, for a short time
        filtered = self._filter.update(time_s, dt_s, math.nan, math.nan, math.nan)
        return AT_REST, EgoMotion(
            *filtered, noise_mps=self._filter.noise_mps, is_predicted=not self._filter.is_measured
        )

    def _follows(self, before: _View, time_s: float) -> bool:
        """Whether the flow leads from the corners of a frame to the frame of `time_s`."""
        last = self._flow.before
        is_last = last is not None and last.time_s == before.time_s
        return is_last and 0 < time_s - before.time_s <= _MAX_GAP_S

    @property
    def notes(self) -> tuple[str, ...]:
        """Messages for the user so far."""
        notes = (
            *self._right.notes,
            *self._realignment.notes,
            *self._vibration.notes(self._rig.left.fx_px),
        )
        if self._focal_factor == 1.0:
            return notes
        pct = 100 * (self._focal_factor - 1)
        return (
            *notes,
            Note(
                f"The focal length of both cameras changed by {pct:+.1f} % at about "
                f"{self._zoomed_s:.1f} s, as if they zoomed or focused: this is part of the sigma of "
                "every distance. Fix zoom and focus.",
                "focal-length-changed",
                "warning",
                "pair",
            ),
        )

    @property
    def focal_change(self) -> float:
        """Relative change of the focal length of both cameras since the start."""
        return self._focal_factor - 1.0

    @property
    def move(self) -> Move | None:
        """The first movement of the right camera that mattered; None = none."""
        return self._right.move

    @property
    def right_camera(self) -> RightCamera:
        """How the right camera moved so far against its rig."""
        now = self._right.now
        return replace(now, is_lost=True) if self._realignment.is_lost else now

    def _realign(self, frame: Frame, tracked: _Tracked | None, matches: _Matches) -> bool:
        """Align the pair again after a far movement; returns whether it is lost, or has another
        alignment from this frame on.
        """
        if tracked is not None and tracked.is_usual:
            n_static, n_shown = len(tracked.static[0]), int((~matches.is_corner).sum())
            self._realignment.check(frame.time_s, n_static, n_shown, self._right.now)
        other = self._realignment.update(frame, self._right.now)
        if other is not None:
            self._right.restart(frame.time_s, *other)
        return other is not None or self._realignment.is_lost

    def _matches(
        self, frame: FlowFrame, right: Image, alignment: Alignment, tracked: _Tracked | None
    ) -> _Matches:
        """Corners of the left image, and static points tracked to it, that are also found in the
        right image.
        """
        corners = _corners(frame)
        coarse_px = self._coarse_disparities(frame.small, right, corners)
        static = self._static(tracked, alignment)
        return _matched((frame.small, right), corners, coarse_px, static)

    def _static(self, tracked: _Tracked | None, alignment: Alignment) -> _Static:
        """The static points that were tracked to a frame with an alignment."""
        if tracked is None:
            return _Static(np.zeros(0, np.int64), np.zeros((0, 2), np.float32), np.zeros(0))
        number, disparity_px = tracked.static
        points = tracked.points[number]
        return _Static(number, points, disparity_px - self._correction_px(points, alignment))

    def _zoom(self, matches: _Matches, tracked: _Tracked) -> float:
        """Relative change of the focal length of both cameras that the points show; 0 = none, or
        while the pair is aligned.
        """
        if self._realignment.is_rough:
            return 0.0
        is_tracked = ~matches.is_corner
        number = matches.number[is_tracked]
        points, expected = matches.left[is_tracked], tracked.expected[number]
        camera = self._rig.left
        centre = (np.array([camera.cx_px, camera.cy_px]) + 0.5) / (1 << self._n_halved) - 0.5
        return common_zoom(
            expected - centre,
            points - centre,
            matches.expected_px[is_tracked],
            (points - matches.right[is_tracked]).astype(np.float64)[:, 0],
        )

    def _right_moved(
        self, matches: _Matches, fit: MotionFit | None, time_s: float, dt_s: float
    ) -> RightCamera:
        """How the right camera moved, by the matches of a frame."""
        if not dt_s or self._realignment.is_lost:
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
        frame: FlowFrame,
        matches: _Matches,
        moved: tuple[RightCamera, RightCamera],
        motion: RigidMotion,
    ) -> _View:
        """The corners of a frame, with the disparities after the second correction of the right
        camera; the images have the first one. The flow expects them where `motion` leads.
        """
        (warped, right), first, time_s = moved, _corners(frame), frame.time_s
        number, corners = matches.corner[matches.is_corner], matches.left[matches.is_corner]
        factor = 1 << self._n_halved
        points = right.moved_from(warped, self._full(matches.right[matches.is_corner]))
        disparity_px, row_px = (self._full(corners) - points).T / factor
        is_used = (disparity_px >= _MIN_DISPARITY_PX) & (np.abs(row_px) <= _MAX_ROW_PX)
        number, corners, disparity_px = number[is_used], corners[is_used], disparity_px[is_used]
        disparity_px = disparity_px + self._correction_px(corners, right.alignment)
        # corners without disparity are mostly far away
        rays = self._rays(first)
        inverse_depth = np.zeros(len(first))
        inverse_depth[number] = disparity_px / self._focal_baseline_m
        after = motion.moved(rays, inverse_depth)
        expected = self._pixels(after).astype(np.float32)
        expected_px = disparity_px / np.maximum(after[number, 2], MIN_RATIO)
        if motion is AT_REST:
            expected_px = np.full(len(number), np.nan)
        else:
            self._flow.expect(expected)
        return _View(
            time_s,
            number,
            rays[number],
            inverse_depth[number],
            motion,
            expected[number],
            expected_px,
        )

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

    def _tracked(self, before: _View) -> _Tracked | None:
        """The corners of the previous frame in this one, and the motion that fits them; None if
        there are too few.
        """
        followed, is_followed = self._flow.followed(_N_FEATURES, _MIN_QUALITY)
        points, is_tracked = followed[before.number], is_followed[before.number]
        if is_tracked.sum() < _MIN_FEATURES:
            return None
        rays, inverse_depth = before.rays[is_tracked], before.inverse_depth[is_tracked]
        full_focal_baseline = self._focal_baseline_m * (1 << self._n_halved)
        expected_offset = self._right.expected_offset_px / full_focal_baseline
        fit = fit_motion(
            rays,
            inverse_depth,
            self._rays(points[is_tracked]),
            noise=_NOISE_PX / self._focal_px,
            inverse_depth_noise=_DISPARITY_NOISE_PX / self._focal_baseline_m,
            rng=self._rng,
            expected_offset=expected_offset,
            start=before.motion,
        )
        depth_ratio = fit.motion.moved(rays, inverse_depth)[:, 2]
        disparity_px = inverse_depth * self._focal_baseline_m / np.maximum(depth_ratio, MIN_RATIO)
        return _Tracked(
            fit,
            points[is_tracked],
            before.expected[is_tracked],
            before.expected_px[is_tracked],
            disparity_px,
            expected_offset,
        )

    def _by_offset_px(self, fit: MotionFit) -> float:
        """Change of the distance travelled along the axis, in m, per pixel of all disparities."""
        backwards = fit.motion.rotation[:, 2] @ fit.by_offset[3:]
        return -float(backwards) / (self._focal_baseline_m * (1 << self._n_halved))

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


def _corners(frame: FlowFrame) -> FloatArray32:
    """(N, 2) best corners of a frame."""
    return frame.corners.points[: frame.corners.n_good(_N_FEATURES, _MIN_QUALITY)]


def _matched(
    images: tuple[Image, Image], corners: FloatArray32, start_px: FloatArray, static: _Static
) -> _Matches:
    """The corners (N, 2) and static points of the left one of two small images that are also found
    in the right one; the search of corners begins at disparities (N,), NaN = none.
    """
    corner = np.flatnonzero(np.isfinite(start_px))
    n_corners, n_static = len(corner), len(static.number)
    left = np.concatenate([corners[corner], static.points])
    disparity_px = np.concatenate([start_px[corner], static.disparity_px])
    expected_px = disparity_px.copy()
    expected_px[:n_corners] = np.nan
    corner = np.concatenate([corner, np.full(n_static, -1)])
    number = np.concatenate([np.full(n_corners, -1), static.number])
    start = left.copy()
    start[:, 0] -= disparity_px.astype(np.float32)
    right, is_matched = tracked_corners(
        *images, left, window_px=_WINDOW_PX, n_levels=1, start=start
    )
    row_px = (left[:, 1] - right[:, 1]).astype(np.float64)
    centre_px = float(median_of(row_px[is_matched])) if is_matched.any() else 0.0
    if abs(centre_px) < _MAX_ROW_PX / 2:
        centre_px = 0.0
    is_matched &= np.abs(row_px - centre_px) <= _MAX_ROW_PX
    return _Matches(
        left[is_matched],
        right[is_matched],
        expected_px[is_matched],
        number[is_matched],
        corner[is_matched],
    )
