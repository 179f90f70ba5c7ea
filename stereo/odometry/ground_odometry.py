r"""GroundOdometry: speed of one camera at a known height above the road, one frame after another.

The road ahead is resampled on a grid of X and Z as seen from above, in the previous frame and in this one, with the
rotation between them removed. Driving s metres then shifts the picture along Z:

    now(X, Z - s) = before(X, Z)        pixel of (X, Z): pi(R C [X, h, Z])

C is the rotation of a level frame that looks along the direction of travel to the camera's, R that from frame to frame,
both from `ImageMotion`: a car drives parallel to the road, so the horizon has the row of the epipole. It follows the
pitch rate from frame to frame, and the epipole over a second.

The picture is divided into strips. The shift is the maximum of their mean normalised correlation; strips under boxes of
road users or without texture do not count. The speed is unknown if the maximum is low or not unique.

An error of the camera height is an equal relative error of the speed.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

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
        scale_sigma: relative error of all speeds, from the camera height and from a road that is not level.
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
    scale_sigma: float = 0.05
    horizon_time_s: float = 1.0


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
        return self._best_shift_m(pictures[0], pictures[1], masked_share, motion.dt_s)

    def _best_shift_m(self, before: FloatArray32, now: FloatArray32, masked_share: FloatArray, dt_s: float) -> float:
        """Shift along Z of two pictures, whose rows run from far to near."""
        settings = self._settings
        n_strip = round(settings.strip_m / settings.step_z_m)
        n_shifts = min(round(settings.max_speed_mps * dt_s / settings.step_z_m), len(before) - n_strip) + 1
        total, count = np.zeros(n_shifts), np.zeros(n_shifts)
        for top in range(0, len(before) - n_strip + 1, n_strip // 2):
            strip = before[top : top + n_strip]
            if masked_share[top : top + n_strip].mean() > _MAX_MASKED_SHARE or strip.std() < _MIN_STRIP_GREY:
                continue
            score = cv2.matchTemplate(now[top:], strip, cv2.TM_CCOEFF_NORMED)[:, 0][:n_shifts]
            total[: len(score)] += score
            count[: len(score)] += 1
        score = np.where(count >= 2, total / np.maximum(count, 1), -1.0)
        best = int(score.argmax())
        if best in (0, n_shifts - 1) or score[best] < settings.min_correlation:
            return math.nan
        n_near = round(_MIN_UNIQUE_M / settings.step_z_m)
        others = np.concatenate([score[: max(best - n_near, 0)], score[best + n_near :]])
        if score[best] - others.max(initial=-1.0) < settings.min_uniqueness:
            return math.nan
        low, mid, high = score[best - 1 : best + 2].tolist()
        curvature = low - 2 * mid + high
        return settings.step_z_m * (best + (0.5 * (low - high) / curvature if curvature < 0 else 0.0))


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
