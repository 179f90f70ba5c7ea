"""Motion: constant-velocity Kalman filters of all boxes, as arrays.

A box is cx, cy, w, h; each coordinate has a state [x, v] = [value px, rate px/s]. The noise has no cross terms between
coordinates, so that the usual 8x8 filter falls apart into four exact 2x2 ones (`ConstantVelocity`); it is the same for
all four, so that they share one covariance P and one gain.

    Q = s^2 q (d^2 [[dt, 0], [0, 0]] + a^2 [[dt^3/3, dt^2/2], [dt^2/2, dt]])        R = s^2 r^2

s is the height of the box last detected: near objects move more pixels (nwojke/deep_sort's scaling). d and a are
densities of continuous noise, so that 10 Hz and 30 Hz behave alike. q is the process-noise scale of the stream
(`track_range.tracking.process_noise`).
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from track_range.detection.boxes import xyxy_from_cxcywh
from track_range.foundation.arrays import BoolArray, FloatArray, IntArray
from track_range.foundation.constant_velocity import ConstantVelocity

_MIN_SIZE_PX = 1.0
"""Least width and height of a predicted box: IoU needs a positive size."""


@dataclass(frozen=True, slots=True, kw_only=True)
class MotionNoise:
    """Standard deviations, in heights of the box: nwojke/deep_sort's, converted from per frame at 30 Hz to per second.

    Others tried, from about half to double, gained at most 0.1 IDF1 in the mean of KITTI's, MOT15's and MOT17's boxes.

    Attributes:
        measured: of a detector's coordinate, heights.
        drift: random walk of the value, heights per sqrt(s).
        acceleration: random walk of the rate, heights per s^1.5.
        first_rate: of the rate of a box detected once, heights per s.
    """

    measured: float = 0.05
    drift: float = 0.27
    acceleration: float = 1.0
    first_rate: float = 1.9


@dataclass(frozen=True, slots=True)
class BoxFilters:
    """The motion of N boxes at one instant.

    Attributes:
        state: x (N, 4) cx, cy, w, h in px, v (N, 4) in px/s, and covariances (N, 1), the same for all four coordinates.
        height_px: (N,) height of the box last detected, the unit of the noise.
    """

    state: ConstantVelocity
    height_px: FloatArray

    def __len__(self) -> int:
        return len(self.height_px)

    @property
    def xyxy_px(self) -> FloatArray:
        """(N, 4) boxes now; no side is shorter than a pixel."""
        box = self.state.x.copy()
        box[:, 2:] = np.maximum(box[:, 2:], _MIN_SIZE_PX)
        return xyxy_from_cxcywh(box)

    @property
    def position_sigma(self) -> FloatArray:
        """(N,) standard deviation of a coordinate, in heights of the box last detected."""
        return np.asarray(np.sqrt(self.state.P_xx[:, 0]) / self.height_px)

    def select(self, rows: BoolArray | IntArray) -> BoxFilters:
        """The rows that a mask or an index array names, in its order."""
        s = self.state
        state = ConstantVelocity(s.x[rows], s.v[rows], s.P_xx[rows], s.P_xv[rows], s.P_vv[rows])
        return BoxFilters(state, self.height_px[rows])

    def assign(self, rows: IntArray, filters: BoxFilters) -> None:
        """Write M filters into these rows (M,), in place."""
        ours, theirs = self.state, filters.state
        ours.x[rows], ours.v[rows] = theirs.x, theirs.v
        ours.P_xx[rows], ours.P_xv[rows], ours.P_vv[rows] = theirs.P_xx, theirs.P_xv, theirs.P_vv
        self.height_px[rows] = filters.height_px

    def concatenate(self, other: BoxFilters) -> BoxFilters:
        """These rows, then the other's."""
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
    """Filters of boxes (N, 4) detected for the first time: rate 0, not known."""
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
    """The filters `dt_s` >= 0 seconds later; `noise_scale` multiplies the process noise's variance."""
    variance = noise_scale * filters.height_px[:, None] ** 2
    state = filters.state.predict(dt_s, q=variance * noise.acceleration**2, drift=variance * noise.drift**2)
    return BoxFilters(state, filters.height_px)


def update(filters: BoxFilters, xyxy_px: FloatArray, noise: MotionNoise) -> tuple[BoxFilters, FloatArray]:
    """The filters after each was given its detected box, (N, 4) in their order.

    Returns:
        The filters, and (N, 4) the innovations in standard deviations.
    """
    z, R = cxcywh(xyxy_px), _measurement_variance(filters, noise)
    innovation = z - filters.state.x
    sigma = np.sqrt(filters.state.P_xx + R)
    return BoxFilters(filters.state.update(innovation, R), z[:, 3]), innovation / sigma


def gating_distance(filters: BoxFilters, xyxy_px: FloatArray, noise: MotionNoise) -> FloatArray:
    """(N, M) squared Mahalanobis distances of boxes (M, 4) from each prediction.

    For a box of the same object it is chi-square distributed with 4 degrees of freedom.
    """
    innovation = cxcywh(xyxy_px)[None, :, :] - filters.state.x[:, None, :]
    variance = filters.state.P_xx + _measurement_variance(filters, noise)
    return np.asarray((innovation**2).sum(axis=2) / variance)


def compensate_camera_motion(filters: BoxFilters, now_from_before: FloatArray) -> BoxFilters:
    """The filters in the pixels of this frame: a similarity (2, 3) rotates centres and rates, and scales sizes."""
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
    """(..., 4) centres and sizes of the frame before -> the same in this frame, by a similarity (2, 3)."""
    turn, shift = now_from_before[:, :2], now_from_before[:, 2]
    centre, size = box_cxcywh[..., :2] @ turn.T + shift, _scale(now_from_before) * box_cxcywh[..., 2:]
    return np.concatenate([centre, size], axis=-1)


def cxcywh(xyxy_px: FloatArray) -> FloatArray:
    """(..., 4) centre and size of boxes."""
    size = xyxy_px[..., 2:] - xyxy_px[..., :2]
    return np.concatenate([xyxy_px[..., :2] + size / 2, size], axis=-1)


def _scale(now_from_before: FloatArray) -> float:
    return float(np.sqrt(abs(np.linalg.det(now_from_before[:, :2]))))


def _measurement_variance(filters: BoxFilters, noise: MotionNoise) -> FloatArray:
    """(N, 1) R."""
    return np.asarray((noise.measured * filters.height_px[:, None]) ** 2)
