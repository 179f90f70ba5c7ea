"""Motion: constant-velocity Kalman filters of all boxes, as arrays.

A box is cx, cy, w, h; each coordinate has a state x = [value px, rate px/s]. The noise has no cross terms between
coordinates, so that the usual 8x8 filter falls apart into four exact 2x2 ones; it is the same for all four, so that
they share one covariance P = [[var, cov], [cov, var_rate]] and one gain.

    F = [[1, dt], [0, 1]]   Q = s^2 q (d^2 [[dt, 0], [0, 0]] + a^2 [[dt^3/3, dt^2/2], [dt^2/2, dt]])   R = s^2 r^2

s is the height of the box last seen: near objects move more pixels (nwojke/deep_sort's scaling). d and a are densities
of continuous noise, so two steps of dt/2 give what one step of dt gives, and 10 Hz and 30 Hz behave alike. q is the
stream's level of noise (`tracking.noise_level`), 1 unless told.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from track_range.detection.boxes import xyxy_from_cxcywh
from track_range.foundation.arrays import BoolArray, FloatArray, IntArray

_MIN_SIZE_PX = 1.0  # a box predicted to shrink stops here: IoU wants a positive size
_VAR, _COV, _VAR_RATE = range(3)


@dataclass(frozen=True, slots=True, kw_only=True)
class MotionNoise:
    """Standard deviations, in heights of the box: nwojke/deep_sort's, taken from per frame at 30 Hz to per second.

    Others tried, from about half to double, gained at most 0.1 IDF1 in the mean of KITTI's, MOT15's and MOT17's boxes.

    Attributes:
        measured: of a detector's coordinate, heights.
        drift: random walk of the value, heights per sqrt(s).
        acceleration: random walk of the rate, heights per s^1.5.
        first_rate: of the rate of a box seen once, heights per s.
    """

    measured: float = 0.05
    drift: float = 0.27
    acceleration: float = 1.0
    first_rate: float = 1.9


@dataclass(frozen=True, slots=True)
class BoxFilters:
    """The motion of N boxes at one instant.

    Attributes:
        value: (N, 4) cx, cy, w, h in px.
        rate: (N, 4) of each, px/s.
        P: (N, 3) variance of a value, covariance of value and rate, variance of a rate; the same for all four.
        height_px: (N,) height of the box last measured, the unit of the noise.
    """

    value: FloatArray
    rate: FloatArray
    P: FloatArray
    height_px: FloatArray

    def __len__(self) -> int:
        return len(self.height_px)

    @property
    def xyxy_px(self) -> FloatArray:
        """(N, 4) boxes now; no side is shorter than a pixel."""
        value = self.value.copy()
        value[:, 2:] = np.maximum(value[:, 2:], _MIN_SIZE_PX)
        return xyxy_from_cxcywh(value)

    @property
    def spread(self) -> FloatArray:
        """(N,) standard deviation of a value, in heights of the box last measured."""
        return np.asarray(np.sqrt(self.P[:, _VAR]) / self.height_px)

    def select(self, keep: BoolArray | IntArray) -> BoxFilters:
        """The rows that a mask or an index array names, in its order."""
        return BoxFilters(self.value[keep], self.rate[keep], self.P[keep], self.height_px[keep])

    def joined(self, other: BoxFilters) -> BoxFilters:
        """These rows, then the other's."""
        return BoxFilters(
            np.concatenate([self.value, other.value]),
            np.concatenate([self.rate, other.rate]),
            np.concatenate([self.P, other.P]),
            np.concatenate([self.height_px, other.height_px]),
        )


def begun(xyxy_px: FloatArray, noise: MotionNoise) -> BoxFilters:
    """Filters of boxes (N, 4) seen for the first time: rate 0, not known."""
    value = cxcywh(xyxy_px)
    height_px = value[:, 3]
    P = np.outer(height_px**2, [noise.measured**2, 0.0, noise.first_rate**2])
    return BoxFilters(value, np.zeros_like(value), P, height_px)


def predicted(filters: BoxFilters, dt_s: float, noise: MotionNoise, *, level: float = 1.0) -> BoxFilters:
    """The filters `dt_s` >= 0 seconds later, in a stream whose motion is `level` times as noisy."""
    d2, a2 = noise.drift**2, noise.acceleration**2
    moved = np.array([[1.0, 0.0, 0.0], [2 * dt_s, 1.0, 0.0], [dt_s**2, dt_s, 1.0]])  # F P F^T, for var, cov, var_rate
    walked = level * np.array([d2 * dt_s + a2 * dt_s**3 / 3, a2 * dt_s**2 / 2, a2 * dt_s])
    P = filters.P @ moved + np.multiply.outer(filters.height_px**2, walked)
    return BoxFilters(filters.value + dt_s * filters.rate, filters.rate, P, filters.height_px)


def updated(filters: BoxFilters, xyxy_px: FloatArray, noise: MotionNoise) -> BoxFilters:
    """The filters after each has seen its box, (N, 4) in their order."""
    return updated_with_innovations(filters, xyxy_px, noise)[0]


def innovations(filters: BoxFilters, xyxy_px: FloatArray, noise: MotionNoise) -> FloatArray:
    """(N, 4) how far each filter's box, (N, 4) in their order, lies from its prediction, in standard deviations."""
    return updated_with_innovations(filters, xyxy_px, noise)[1]


def updated_with_innovations(
    filters: BoxFilters, xyxy_px: FloatArray, noise: MotionNoise
) -> tuple[BoxFilters, FloatArray]:
    """`updated` and `innovations` at once."""
    z, P, variance = cxcywh(xyxy_px), filters.P, _innovation_variance(filters, noise)
    innovation = z - filters.value
    gain = P[:, :2] / variance[:, None]
    value = filters.value + gain[:, :1] * innovation
    rate = filters.rate + gain[:, 1:] * innovation
    P = P - np.stack([gain[:, 0] * P[:, _VAR], gain[:, 0] * P[:, _COV], gain[:, 1] * P[:, _COV]], axis=1)
    return BoxFilters(value, rate, P, z[:, 3]), innovation / np.sqrt(variance)[:, None]


def squared_mahalanobis(filters: BoxFilters, xyxy_px: FloatArray, noise: MotionNoise) -> FloatArray:
    """(N, M) squared distances of boxes (M, 4) from each prediction, in its own standard deviations.

    Of a box that belongs to the track it is chi-square distributed with 4 degrees of freedom.
    """
    innovation = cxcywh(xyxy_px)[None, :, :] - filters.value[:, None, :]
    return np.asarray((innovation**2).sum(axis=2) / _innovation_variance(filters, noise)[:, None])


def carried(filters: BoxFilters, now_from_before: FloatArray) -> BoxFilters:
    """The filters in another frame's pixels: a similarity (2, 3) turns centres and rates, and scales sizes."""
    turn = now_from_before * [1.0, 1.0, 0.0]
    scale = _scale(turn)
    value, rate = moved(filters.value, now_from_before), moved(filters.rate, turn)
    return BoxFilters(value, rate, filters.P * scale**2, filters.height_px * scale)


def moved(box_cxcywh: FloatArray, now_from_before: FloatArray) -> FloatArray:
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


def _innovation_variance(filters: BoxFilters, noise: MotionNoise) -> FloatArray:
    return np.asarray(filters.P[:, _VAR] + (noise.measured * filters.height_px) ** 2)
