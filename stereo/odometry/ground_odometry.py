r"""GroundOdometry: speed of one camera at a known height above the road, one frame after another.

The road ahead is resampled on a grid of X and Z as seen from above, in the previous frame and in this one, with the
rotation between them removed. Driving s metres then shifts the picture along Z:

    now(X, Z - s) = before(X, Z)        pixel of (X, Z): pi(R C [X, h, Z])

C is the rotation of a level frame that looks along the direction of travel to the camera's, R that from frame to frame,
both from `ImageMotion`: a car drives parallel to the road, so the horizon has the row of the epipole. It follows the
pitch rate from frame to frame, and the epipole over a second. A horizon in a wrong row makes distant parts of the road
shift more, or less, than near ones: `HorizonOffset` corrects it.

The picture is divided into strips. The shift is the maximum of their mean normalised correlation; strips under boxes of
road users or without texture do not count. The speed is unknown if the maximum is low or not unique.

An error of the camera height is an equal relative error of the speed. The road is taken to be plane up to 15 m.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import NamedTuple

import cv2
import numpy as np

from track_range.foundation.arrays import FloatArray, FloatArray32, Image, check_shape
from track_range.foundation.sparse_flow import BackgroundFlow, small_grey
from track_range.stereo.geometry.camera import PinholeCamera
from track_range.stereo.geometry.frames import Frame
from track_range.stereo.odometry.ego_motion import EgoMotion
from track_range.stereo.odometry.image_motion import ImageMotion, ImageMotionEstimator
from track_range.stereo.odometry.speed_filter import SpeedFilter

_MIN_STRIP_GREY = 1.0
"""Smallest standard deviation of a strip in grey levels; below it there is only noise."""

_MAX_MASKED_SHARE = 0.05
"""Largest fraction of a strip under boxes of road users."""

_HORIZON_SIGMA_RAD, _HORIZON_DRIFT_RAD = 0.01, 0.005
"""Standard deviation of the difference of epipole and horizon in rad, and its random walk per square root of a second;
chosen on simulated drives, seeds 0-9, where errors of the epipole's row are 0.005 to 0.01 rad."""

_MIN_STRIPS, _STRIP_SIGMA_M = 4, 0.05
"""Minimum number of strips for a correction of the horizon, and standard deviation of the shift of one strip: half a
cell, as strips overlap."""

_MAX_STRIP_CELLS, _MIN_STRIP_CORRELATION = 6, 0.4
"""Largest difference of a strip's shift from the common one in cells, that of the farthest strip for an error of 0.012
rad at 30 m/s, and minimum correlation of the strip."""

_MIN_UNIQUE_M = 0.35
"""Shifts nearer than this to the maximum belong to it."""


@dataclass(frozen=True, slots=True, kw_only=True)
class GroundOdometrySettings:
    """Settings of the picture from above and of the search.

    Attributes:
        half_width_m: half the width of the picture.
        nearest_m: nearest road in the picture, if the image shows it.
        farthest_m: farthest road in the picture; beyond it, a pixel of the camera covers 0.2 m.
        step_x_m, step_z_m: size of a cell of the picture.
        strip_m: length of a strip.
        max_speed_mps: largest speed that is searched.
        min_correlation: smallest mean correlation of a reliable shift.
        min_uniqueness: smallest difference from the second best maximum.
        shift_sigma_m: standard deviation of a shift; assumed, a fifth of a cell.
        scale_sigma: relative error of all speeds, from a road that is not plane and the camera height; the errors on
            simulated drives, seeds 0-9, then have a standard deviation of 0.6 in units of their sigma.
        horizon_time_s: time constant with which the horizon follows the epipole.
    """

    half_width_m: float = 1.5
    nearest_m: float = 4.5
    farthest_m: float = 15.0
    step_x_m: float = 0.15
    step_z_m: float = 0.1
    strip_m: float = 2.0
    max_speed_mps: float = 45.0
    min_correlation: float = 0.25
    min_uniqueness: float = 0.05
    shift_sigma_m: float = 0.02
    scale_sigma: float = 0.03
    horizon_time_s: float = 1.0


class _Strip(NamedTuple):
    """Distance of the centre of a strip, and its correlations with all shifts; NaN = outside the picture."""

    distance_m: float
    score: FloatArray


class GroundOdometry:
    """Measures the speed of one camera; the state belongs to the instance.

    Args:
        camera: the camera without distortion.
        height_m: its height above the road.
        settings: None = the defaults.
        flow: flow of the background, which other estimators of the same stream may use too; None = a separate one.
    """

    source = "the motion of the road in the images"

    def __init__(
        self,
        camera: PinholeCamera,
        height_m: float,
        settings: GroundOdometrySettings | None = None,
        *,
        flow: BackgroundFlow | None = None,
    ) -> None:
        self._camera, self._height_m = camera, height_m
        self._settings = settings or GroundOdometrySettings()
        self._flow = flow or BackgroundFlow()
        self._image_motion = ImageMotionEstimator(camera, flow=self._flow)
        self._filter = SpeedFilter()
        self._travel: FloatArray | None = None
        self._horizon = HorizonOffset(height_m)
        self._before: Image | None = None
        self._boxes_before: FloatArray = np.zeros((0, 4))

    def update(self, frame: Frame, xyxy_px: FloatArray) -> EgoMotion:
        """Motion since the previous frame; the speed is unknown for the first one, and where it is not reliable.

        Args:
            frame: the image.
            xyxy_px: (N, 4) boxes of road users.

        Raises:
            ValueError: an argument has another shape.
        """
        check_shape("xyxy_px", xyxy_px, (None, 4))
        motion = self._image_motion.update(frame.left, frame.time_s, xyxy_px)
        now = self._flow.now
        before, self._before = self._before, small_grey(frame.left, 0) if now is None else now.grey
        boxes_before, self._boxes_before = self._boxes_before, xyxy_px
        if not motion.is_known or before is None:
            self._travel = None if math.isnan(motion.dt_s) else self._travel
            return self._filtered(motion, math.nan)
        if motion.is_still:
            return self._filtered(motion, 0.0)
        travel_before = self._followed(motion)
        if travel_before is None:
            return self._filtered(motion, math.nan)
        shift_m = self._shift_m(motion, travel_before, before, self._before, (boxes_before, xyxy_px))
        return self._filtered(motion, shift_m / motion.dt_s)

    def _filtered(self, motion: ImageMotion, speed_mps: float) -> EgoMotion:
        if math.isnan(motion.dt_s):
            return EgoMotion()
        settings = self._settings
        speed_mps, sigma_mps = self._filter.update(
            motion.time_s,
            motion.dt_s,
            speed_mps,
            settings.shift_sigma_m / motion.dt_s,
            settings.scale_sigma * abs(speed_mps),
        )
        return EgoMotion(speed_mps, sigma_mps, motion.yaw_rad_s, motion.is_still)

    def _followed(self, motion: ImageMotion) -> FloatArray | None:
        """(2,) x, y of the ray of travel in the previous frame; the state moves on to this frame."""
        camera = self._camera
        x_px, y_px = motion.epipole_px
        if not (math.isfinite(x_px) and math.isfinite(y_px)):
            return None
        measured = np.array([(x_px - camera.cx_px) / camera.fx_px, (y_px - camera.cy_px) / camera.fy_px])
        pitched = np.array([0.0, motion.pitch_rad_s * motion.dt_s])
        if self._travel is None:
            self._travel = measured
            return np.asarray(measured - pitched, np.float64)
        before = self._travel
        share = min(1.0, motion.dt_s / self._settings.horizon_time_s)
        self._travel = before + pitched + share * (measured - before - pitched)
        return np.asarray(self._travel - pitched, np.float64)

    def _shift_m(
        self,
        motion: ImageMotion,
        travel: FloatArray,
        before: Image,
        now: Image,
        boxes: tuple[FloatArray, FloatArray],
    ) -> float:
        """Distance driven between two frames; NaN = not reliable."""
        settings = self._settings
        travel = travel - [0.0, self._horizon.offset_rad]
        nearest_m = max(
            settings.nearest_m,
            self._height_m / ((self._camera.height_px - 2 - self._camera.cy_px) / self._camera.fy_px - travel[1]),
        )
        if not 0 < nearest_m < settings.farthest_m - 2 * settings.strip_m:
            return math.nan
        turn = np.array([-motion.pitch_rad_s, -motion.yaw_rad_s, -motion.roll_rad_s]) * motion.dt_s
        level = cv2.Rodrigues(np.array([-travel[1], travel[0], 0.0]))[0]
        Z = np.arange(settings.farthest_m, nearest_m, -settings.step_z_m)
        X = np.arange(-settings.half_width_m, settings.half_width_m, settings.step_x_m)
        road = np.stack([np.tile(X, len(Z)), np.full(len(X) * len(Z), self._height_m), np.repeat(Z, len(X))], axis=1)
        before_px = self._camera.project(road @ level.T)
        now_px = self._camera.project(road @ (cv2.Rodrigues(turn)[0] @ level).T)
        pictures = [_sampled(image, px, (len(Z), len(X))) for image, px in ((before, before_px), (now, now_px))]
        masked_share = (
            np.maximum(_inside(before_px, boxes[0]), _inside(now_px, boxes[1])).reshape(len(Z), len(X)).mean(axis=1)
        )
        strips = self._strips(pictures[0], pictures[1], masked_share, motion.dt_s)
        best = self._best_shift(strips)
        if best is None:
            return math.nan
        shift_m = settings.step_z_m * best
        return self._horizon.update(
            shift_m,
            np.array([strip.distance_m for strip in strips]) - shift_m / 2,
            settings.step_z_m * np.array([_peak_near(strip.score, round(best)) for strip in strips]),
            motion.dt_s,
        )

    def _strips(self, before: FloatArray32, now: FloatArray32, masked_share: FloatArray, dt_s: float) -> list[_Strip]:
        """Usable strips of two pictures, whose rows run from far to near."""
        settings = self._settings
        n_strip = round(settings.strip_m / settings.step_z_m)
        n_shifts = min(round(settings.max_speed_mps * dt_s / settings.step_z_m), len(before) - n_strip) + 1
        strips = []
        for top in range(0, len(before) - n_strip + 1, n_strip // 2):
            strip = before[top : top + n_strip]
            if masked_share[top : top + n_strip].mean() > _MAX_MASKED_SHARE or strip.std() < _MIN_STRIP_GREY:
                continue
            score = np.full(n_shifts, np.nan)
            known = cv2.matchTemplate(now[top:], strip, cv2.TM_CCOEFF_NORMED)[:n_shifts, 0]
            score[: len(known)] = known
            strips.append(_Strip(settings.farthest_m - settings.step_z_m * (top + (n_strip - 1) / 2), score))
        return strips

    def _best_shift(self, strips: list[_Strip]) -> float | None:
        """Shift of the strips in cells; None = not reliable."""
        settings = self._settings
        if len(strips) < 2:
            return None
        scores = np.array([strip.score for strip in strips])
        count = np.isfinite(scores).sum(axis=0)
        score = np.where(count >= 2, np.nansum(scores, axis=0) / np.maximum(count, 1), -1.0)
        best = int(score.argmax())
        if best in (0, len(score) - 1) or score[best] < settings.min_correlation:
            return None
        n_near = round(_MIN_UNIQUE_M / settings.step_z_m)
        others = np.concatenate([score[: max(best - n_near, 0)], score[best + n_near :]])
        if score[best] - others.max(initial=-1.0) < settings.min_uniqueness:
            return None
        return _vertex(score, best)


class HorizonOffset:
    r"""Corrects the row of the horizon from the shifts of near and distant strips, and the shift for it.

    If the horizon is taken to be d rad too low, a point at distance Z seems to be at Z + d Z^2 / h. A shift s with its
    middle at Z then becomes s (1 + 2 Z d / h): the slope of the shifts over the distances gives d.

    Args:
        height_m: height h of the camera above the road.
    """

    def __init__(self, height_m: float) -> None:
        self.offset_rad = 0.0
        self._height_m = height_m
        self._variance = _HORIZON_SIGMA_RAD**2

    def update(self, shift_m: float, distance_m: FloatArray, shifts_m: FloatArray, dt_s: float) -> float:
        """Shift for the corrected horizon.

        Args:
            shift_m: common shift of the strips.
            distance_m: (K,) distances of their centres, in the middle of the shift.
            shifts_m: (K,) the shift of each of them; NaN = unknown.
            dt_s: time since the previous frame.
        """
        self._variance = min(self._variance + _HORIZON_DRIFT_RAD**2 * dt_s, _HORIZON_SIGMA_RAD**2)
        is_known = np.isfinite(shifts_m)
        if is_known.sum() < _MIN_STRIPS or shift_m <= 0:
            return shift_m
        centred = distance_m[is_known] - distance_m[is_known].mean()
        spread = float(centred @ centred)
        slope = float(centred @ shifts_m[is_known]) / spread
        to_rad = self._height_m / (2 * shift_m)
        variance = (to_rad * _STRIP_SIGMA_M) ** 2 / spread
        gain = self._variance / (self._variance + variance)
        change_rad = gain * slope * to_rad
        self.offset_rad += change_rad
        self._variance *= 1 - gain
        return shift_m * (1 - 2 * float(distance_m[is_known].mean()) * change_rad / self._height_m)


def _peak_near(score: FloatArray, cell: int) -> float:
    """Maximum of a strip's correlation near the common one, in cells; NaN = none."""
    start = max(cell - _MAX_STRIP_CELLS, 1)
    near = score[start : cell + _MAX_STRIP_CELLS + 1]
    if not np.isfinite(near).all() or len(near) < 3:
        return math.nan
    best = start + int(near.argmax())
    if best in (start, start + len(near) - 1) or score[best] < _MIN_STRIP_CORRELATION:
        return math.nan
    return _vertex(score, best)


def _vertex(score: FloatArray, best: int) -> float:
    """Position of the vertex of the parabola through a maximum and its neighbours."""
    low, mid, high = score[best - 1 : best + 2].tolist()
    curvature = low - 2 * mid + high
    return best + (0.5 * (low - high) / curvature if curvature < 0 else 0.0)


def _sampled(image: Image, points_px: FloatArray, hw: tuple[int, int]) -> FloatArray32:
    """(H, W) grey levels at points (H W, 2); the edge is repeated outside the image."""
    maps = points_px.astype(np.float32).reshape(*hw, 2)
    sampled = cv2.remap(image, maps[..., 0], maps[..., 1], cv2.INTER_LINEAR, borderMode=cv2.BORDER_REPLICATE)
    return np.asarray(sampled, np.float32)


def _inside(points_px: FloatArray, xyxy_px: FloatArray) -> FloatArray:
    """(N,) 1.0 for points (N, 2) inside a box, else 0.0."""
    inside = np.zeros(len(points_px), np.bool_)
    x, y = points_px.T
    for x1, y1, x2, y2 in xyxy_px.tolist():
        inside |= (x >= x1) & (x <= x2) & (y >= y1) & (y <= y2)
    return inside.astype(np.float64)
