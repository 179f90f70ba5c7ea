"""Motion: one constant-velocity Kalman filter per coordinate of every box, all of them as arrays.

A box is cx, cy, w, h; each coordinate has a state x = [value px, rate px/s]. The noise has no cross terms between
coordinates, so that the usual 8x8 filter falls apart into four exact 2x2 ones (about 15 times faster as arrays).

    F = [[1, dt], [0, 1]]   Q = s^2 (d^2 [[dt, 0], [0, 0]] + a^2 [[dt^3/3, dt^2/2], [dt^2/2, dt]])   R = s^2 r^2

s is the height of the box last seen: near objects move more pixels (nwojke/deep_sort's scaling). d and a are densities
of continuous noise, so two steps of dt/2 give what one step of dt gives, and 10 Hz and 30 Hz behave alike.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from detection.boxes import xyxy_from_cxcywh
from detection.detections import BoolArray, FloatArray, IntArray

_MIN_SIZE_PX = 1.0  # a box predicted to shrink stops here: IoU wants a positive size


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
    """The motion of N boxes at one instant; never written to.

    Attributes:
        x: (N, 4, 2) value and rate of cx, cy, w, h; px and px/s.
        P: (N, 4, 2, 2) their covariances.
        height_px: (N,) height of the box last measured, the unit of the noise.
    """

    x: FloatArray
    P: FloatArray
    height_px: FloatArray

    def __len__(self) -> int:
        return len(self.height_px)

    @property
    def xyxy_px(self) -> FloatArray:
        """(N, 4) boxes now; no side is shorter than a pixel."""
        size = np.maximum(self.x[:, 2:, 0], _MIN_SIZE_PX)
        return xyxy_from_cxcywh(np.concatenate([self.x[:, :2, 0], size], axis=1))

    def select(self, keep: BoolArray | IntArray) -> BoxFilters:
        """The rows that a mask or an index array names, in its order."""
        return BoxFilters(self.x[keep], self.P[keep], self.height_px[keep])

    def joined(self, other: BoxFilters) -> BoxFilters:
        """These rows, then the other's."""
        return BoxFilters(
            np.concatenate([self.x, other.x]),
            np.concatenate([self.P, other.P]),
            np.concatenate([self.height_px, other.height_px]),
        )


def begun(xyxy_px: FloatArray, noise: MotionNoise) -> BoxFilters:
    """Filters of boxes (N, 4) seen for the first time: rate 0, not known."""
    z = _cxcywh(xyxy_px)
    x = np.stack([z, np.zeros_like(z)], axis=2)
    height_px = z[:, 3]
    P = np.zeros((len(z), 4, 2, 2))
    P[:, :, 0, 0] = ((noise.measured * height_px) ** 2)[:, None]
    P[:, :, 1, 1] = ((noise.first_rate * height_px) ** 2)[:, None]
    return BoxFilters(x, P, height_px)


def predicted(filters: BoxFilters, dt_s: float, noise: MotionNoise) -> BoxFilters:
    """The filters `dt_s` >= 0 seconds later."""
    x = filters.x.copy()
    x[:, :, 0] += dt_s * filters.x[:, :, 1]
    s2 = (filters.height_px**2)[:, None]
    drift, acceleration = noise.drift**2, noise.acceleration**2
    var_rate = filters.P[:, :, 1, 1]
    P = filters.P.copy()
    P[:, :, 0, 0] += dt_s * (2 * filters.P[:, :, 0, 1] + dt_s * var_rate)
    P[:, :, 0, 0] += s2 * (drift * dt_s + acceleration * dt_s**3 / 3)
    P[:, :, 0, 1] += dt_s * var_rate + s2 * acceleration * dt_s**2 / 2
    P[:, :, 1, 0] = P[:, :, 0, 1]
    P[:, :, 1, 1] += s2 * acceleration * dt_s
    return BoxFilters(x, P, filters.height_px)


def updated(filters: BoxFilters, xyxy_px: FloatArray, noise: MotionNoise) -> BoxFilters:
    """The filters after each has seen its box, (N, 4) in their order."""
    z = _cxcywh(xyxy_px)
    S = filters.P[:, :, 0, 0] + ((noise.measured * filters.height_px) ** 2)[:, None]
    gain = filters.P[:, :, :, 0] / S[:, :, None]
    x = filters.x + gain * (z - filters.x[:, :, 0])[:, :, None]
    P = filters.P - gain[:, :, :, None] * filters.P[:, :, 0, None, :]
    return BoxFilters(x, P, z[:, 3])


def squared_mahalanobis(filters: BoxFilters, xyxy_px: FloatArray, noise: MotionNoise) -> FloatArray:
    """(N, M) squared distances of boxes (M, 4) from each prediction, in its own standard deviations.

    Of a box that belongs to the track it is chi-square distributed with 4 degrees of freedom.
    """
    z = _cxcywh(xyxy_px)
    S = filters.P[:, :, 0, 0] + ((noise.measured * filters.height_px) ** 2)[:, None]
    innovation = z[None, :, :] - filters.x[:, None, :, 0]
    return np.asarray((innovation**2 / S[:, None, :]).sum(axis=2))


def _cxcywh(xyxy_px: FloatArray) -> FloatArray:
    size = xyxy_px[:, 2:] - xyxy_px[:, :2]
    return np.concatenate([xyxy_px[:, :2] + size / 2, size], axis=1)
