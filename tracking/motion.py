"""Motion: constant-velocity Kalman filters of all boxes, as arrays.

A box is cx, cy, w, h; each coordinate has a state x = [value px, rate px/s] and a measurement z of the value.

    predict   x <- F x,  P <- F P F^T + Q         F = [[1, dt], [0, 1]],  H = [1, 0]
    update    y = z - H x,  S = H P H^T + R,  K = P H^T / S,  x <- x + K y,  P <- (I - K H) P
    gating    d^2 = sum of y^2 / S over the four coordinates, chi-square distributed with 4 degrees of freedom

    Q = s^2 q (d^2 [[dt, 0], [0, 0]] + a^2 [[dt^3/3, dt^2/2], [dt^2/2, dt]])        R = s^2 r^2

The noise has no cross terms between coordinates, so the usual 8x8 filter separates into four exact 2x2 filters
(`ConstantVelocity`); it is equal for all four, so they share one covariance P and one gain K. s is the height of the
last detected box: near objects move more pixels (nwojke/deep_sort's scaling). d and a are densities of continuous
noise, so that 10 Hz and 30 Hz behave alike. q is the process-noise scale of the stream
(`track_range.tracking.process_noise`).
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from track_range.detection.boxes import xyxy_from_cxcywh
from track_range.foundation.arrays import BoolArray, FloatArray, IntArray
from track_range.foundation.constant_velocity import ConstantVelocity

_MIN_SIZE_PX = 1.0
"""Smallest width and height of a predicted box: IoU needs a positive size."""


@dataclass(frozen=True, slots=True, kw_only=True)
class MotionNoise:
    """Standard deviations in heights of the box: nwojke/deep_sort's, converted from per frame at 30 Hz to per second.

    Values between half and twice these improve IDF1 by at most 0.1 on average over KITTI, MOT15 and MOT17.

    Attributes:
        measured: r, noise of a detected coordinate, heights.
        drift: d, random walk of the value, heights per sqrt(s).
        acceleration: a, random walk of the rate, heights per s^1.5.
        first_rate: standard deviation of the rate of a box detected once, heights per s.
    """

    measured: float = 0.05
    drift: float = 0.27
    acceleration: float = 1.0
    first_rate: float = 1.9


@dataclass(frozen=True, slots=True)
class BoxFilters:
    """Filters of N boxes at one time.

    Attributes:
        state: x (N, 4) cx, cy, w, h in px, v (N, 4) in px/s, and covariances (N, 1), equal for all four coordinates.
        height_px: (N,) s, height of the last detected box, the unit of the noise.
    """

    state: ConstantVelocity
    height_px: FloatArray

    def __len__(self) -> int:
        return len(self.height_px)

    @property
    def xyxy_px(self) -> FloatArray:
        """(N, 4) boxes at the time of the state; no side is shorter than a pixel."""
        box = self.state.x.copy()
        box[:, 2:] = np.maximum(box[:, 2:], _MIN_SIZE_PX)
        return xyxy_from_cxcywh(box)

    @property
    def position_sigma(self) -> FloatArray:
        """(N,) standard deviation of a coordinate, in heights of the last detected box."""
        return np.asarray(np.sqrt(self.state.P_xx[:, 0]) / self.height_px)

    def select(self, rows: BoolArray | IntArray) -> BoxFilters:
        """The rows that a mask or an index array selects, in its order."""
        s = self.state
        state = ConstantVelocity(s.x[rows], s.v[rows], s.P_xx[rows], s.P_xv[rows], s.P_vv[rows])
        return BoxFilters(state, self.height_px[rows])

    def assign(self, rows: IntArray, filters: BoxFilters) -> None:
        """Replace the filters in rows (M,), in place."""
        target, source = self.state, filters.state
        target.x[rows], target.v[rows] = source.x, source.v
        target.P_xx[rows], target.P_xv[rows], target.P_vv[rows] = source.P_xx, source.P_xv, source.P_vv
        self.height_px[rows] = filters.height_px

    def concatenate(self, other: BoxFilters) -> BoxFilters:
        """The filters of both, `other`'s last."""
        a, b = self.state, other.state
        state = ConstantVelocity(
            x=np.concatenate([a.x, b.x]),
            v=np.concatenate([a.v, b.v]),
            P_xx=np.concatenate([a.P_xx, b.P_xx]),
            P_xv=np.concatenate([a.P_xv, b.P_xv]),
            P_vv=np.concatenate([a.P_vv, b.P_vv]),
        )
        return BoxFilters(state, np.concatenate([self.height_px, other.height_px]))


def initiate(xyxy_px: FloatArray, noise: MotionNoise) -> BoxFilters:
    """Filters of boxes (N, 4) detected for the first time: rate 0 with the standard deviation `first_rate`."""
    box = cxcywh(xyxy_px)
    height_px = box[:, 3]
    variance = height_px[:, None] ** 2
    state = ConstantVelocity(
        x=box,
        v=np.zeros_like(box),
        P_xx=variance * noise.measured**2,
        P_xv=np.zeros_like(variance),
        P_vv=variance * noise.first_rate**2,
    )
    return BoxFilters(state, height_px)


def predict(filters: BoxFilters, dt_s: float, noise: MotionNoise, *, noise_scale: float = 1.0) -> BoxFilters:
    """The filters `dt_s` >= 0 seconds later; `noise_scale` is q, a factor of the process noise's variance."""
    variance = noise_scale * filters.height_px[:, None] ** 2
    state = filters.state.predict(dt_s, q=variance * noise.acceleration**2, drift=variance * noise.drift**2)
    return BoxFilters(state, filters.height_px)


def update(filters: BoxFilters, xyxy_px: FloatArray, noise: MotionNoise) -> tuple[BoxFilters, FloatArray]:
    """The filters updated with their detected boxes (N, 4).

    Returns:
        The filters, and (N, 4) the innovations in standard deviations, y / sqrt(S).
    """
    z, R = cxcywh(xyxy_px), _measurement_variance(filters, noise)
    y, S = z - filters.state.x, filters.state.P_xx + R
    return BoxFilters(filters.state.update(y, R), z[:, 3]), y / np.sqrt(S)


def gating_distance(filters: BoxFilters, xyxy_px: FloatArray, noise: MotionNoise) -> FloatArray:
    """(N, M) squared Mahalanobis distances d^2 of boxes (M, 4) from each prediction."""
    y = cxcywh(xyxy_px)[None, :, :] - filters.state.x[:, None, :]
    S = filters.state.P_xx + _measurement_variance(filters, noise)
    return np.asarray((y**2).sum(axis=2) / S)


def compensate_camera_motion(filters: BoxFilters, now_from_before: FloatArray) -> BoxFilters:
    """The filters in pixels of the current frame: a similarity (2, 3) moves centres, rotates rates and scales sizes."""
    rotation = now_from_before * [1.0, 1.0, 0.0]
    scale = _scale(rotation)
    s, variance = filters.state, scale**2
    state = ConstantVelocity(
        x=transformed(s.x, now_from_before),
        v=transformed(s.v, rotation),
        P_xx=s.P_xx * variance,
        P_xv=s.P_xv * variance,
        P_vv=s.P_vv * variance,
    )
    return BoxFilters(state, filters.height_px * scale)


def transformed(box_cxcywh: FloatArray, now_from_before: FloatArray) -> FloatArray:
    """Centres and sizes (..., 4) transformed by a similarity (2, 3) from the previous frame to this one."""
    rotation, translation_px = now_from_before[:, :2], now_from_before[:, 2]
    centre = box_cxcywh[..., :2] @ rotation.T + translation_px
    return np.concatenate([centre, _scale(now_from_before) * box_cxcywh[..., 2:]], axis=-1)


def cxcywh(xyxy_px: FloatArray) -> FloatArray:
    """(..., 4) cx, cy, w, h of boxes (..., 4)."""
    size = xyxy_px[..., 2:] - xyxy_px[..., :2]
    return np.concatenate([xyxy_px[..., :2] + size / 2, size], axis=-1)


def _scale(now_from_before: FloatArray) -> float:
    """Scale of a similarity (2, 3)."""
    return float(np.sqrt(abs(np.linalg.det(now_from_before[:, :2]))))


def _measurement_variance(filters: BoxFilters, noise: MotionNoise) -> FloatArray:
    """(N, 1) measurement variance R."""
    return np.asarray((noise.measured * filters.height_px[:, None]) ** 2)
