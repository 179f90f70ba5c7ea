"""Motion: constant-velocity Kalman filters of all boxes, as arrays, and the scale of their process
noise.

A box is cx, cy, w, h; each coordinate has a state x = [value px, rate px/s] and a measurement z of
the value.

    predict   x <- F x,  P <- F P F^T + Q         F = [[1, dt], [0, 1]],  H = [1, 0]
    update    y = z - H x,  S = H P H^T + R,  K = P H^T / S,  x <- x + K y,  P <- (I - K H) P
    gating    d^2 = sum of y^2 / S over the four coordinates, chi-square distributed with 4 degrees of freedom

    Q = s^2 q (d^2 [[dt, 0], [0, 0]] + a^2 [[dt^3/3, dt^2/2], [dt^2/2, dt]])        R = s^2 r^2

The rates of a person's w and h get a fifth of K y: detected heights of persons jitter by 5 to 10 %,
those of cars by 2 to 4 %.

The noise has no cross terms between coordinates, so the usual 8x8 filter separates into four exact
2x2 filters; the noise is equal for all four, so they share one covariance P and one gain K. s is
the height of the last detected box: near objects move more pixels (nwojke/deep_sort's scaling). d
and a are densities of continuous noise, so that 10 Hz and 30 Hz behave alike. q is the
process-noise scale of the stream, estimated online from the innovations:

A Kalman filter with the right noise has white innovations: they are uncorrelated between successive
frames (Mehra, 1970). If they correlate positively, the filter lags and its process noise is too
small; if negatively, it follows the detector's jitter. So the process-noise scale q follows the
mean correlation c of successive innovations,

    c = mean over the tracks of a . b / ((|a|^2 + |b|^2) / 2)      a, b: innovations of two successive frames
    q <- q exp(rate n c)                                           n tracks, at most ten; q in [lowest, highest]

The scale ends near the lowest value for static cameras (people walk at a steady pace) and at the
highest for driving ones: a fixed low scale would lose the tracks of a driving camera in each turn,
a fixed high one would follow jitter. Final scales are 0.06 on PETS09-S2L1, 0.7 on ADL-Rundle-6, 0.5
on ETH-Bahnhof, 1 on MOT17-05 and KITTI.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from track_range.foundation.arrays import BoolArray, FloatArray, IntArray, row_numbers

# of a predicted box: IoU needs a positive size
_SMALLEST_CXCYWH = np.array([-np.inf, -np.inf, 1.0, 1.0])

# fmt: off
# by which rows left, top, right, bottom are multiplied: faster than by column
_CXCYWH_OF_XYXY = np.array(
    [[0.5, 0.0, -1.0, 0.0],
     [0.0, 0.5, 0.0, -1.0],
     [0.5, 0.0, 1.0, 0.0],
     [0.0, 0.5, 0.0, 1.0]]
)
_XYXY_OF_CXCYWH = np.array(  # the inverse
    [[1.0, 0.0, 1.0, 0.0],
     [0.0, 1.0, 0.0, 1.0],
     [-0.5, 0.0, 0.5, 0.0],
     [0.0, -0.5, 0.0, 0.5]]
)
# fmt: on

# Weight of the filter in smoothed boxes: sizes jitter more, and filtered positions lag. Source: as
# of person_size_rate.
_SMOOTHING = np.array([1 / 3, 1 / 3, 1.0, 1.0])
# limit of innovations, in standard deviations, so that one wrong box does not dominate
_MAX_SIGMAS = 2.0
_MIN_POWER = 0.05  # lower limit of the denominator of c, in standard deviations squared
_MAX_TRACKS = 10  # upper limit of n, the number of tracks, in the update


@dataclass(frozen=True, slots=True, kw_only=True)
class MotionNoise:
    """Standard deviations in heights of the box, from nwojke/deep_sort, converted from frames at 30
    Hz to seconds.

    Values between half and twice these improve IDF1 by at most 0.1 on average over KITTI, MOT15 and
    MOT17.
    """

    measured: float = 0.05  # r, noise of a detected coordinate, heights
    drift: float = 0.27  # d, random walk of the value, heights per sqrt(s)
    acceleration: float = 1.0  # a, random walk of the rate, heights per s^1.5
    first_rate: float = 1.9  # standard deviation of the rate of a box detected once, heights per s
    # gain of the rates of a person's w and h / K_v (chosen on KITTI's and MOTChallenge's sequences)
    person_size_rate: float = 0.2


@dataclass(frozen=True, slots=True)
class BoxFilters:
    """Filters of N boxes at one time."""

    state: FloatArray  # (2, N, 4) x = cx, cy, w, h in px, and v, their rates in px/s
    P: FloatArray  # (3, N) covariances P_xx, P_xv and P_vv, equal for all four coordinates
    height_px: FloatArray  # (N,) s, height of the last detected box, the unit of the noise

    def __len__(self) -> int:
        return len(self.height_px)

    @property
    def x(self) -> FloatArray:
        """(N, 4) cx, cy, w, h in px."""
        return np.asarray(self.state[0])

    @property
    def v(self) -> FloatArray:
        """(N, 4) their rates in px/s."""
        return np.asarray(self.state[1])

    @property
    def xyxy_px(self) -> FloatArray:
        """(N, 4) boxes at the time of the state; no side is shorter than a pixel."""
        return np.asarray(np.maximum(self.x, _SMALLEST_CXCYWH).dot(_XYXY_OF_CXCYWH))

    @property
    def position_sigma(self) -> FloatArray:
        """(N,) standard deviation of a coordinate, in heights of the last detected box."""
        return np.asarray(np.sqrt(self.P[0]) / self.height_px)

    def select(self, rows: BoolArray | IntArray) -> BoxFilters:
        """The rows that a mask or an index array selects, in its order."""
        i = row_numbers(rows, len(self.height_px))
        return BoxFilters(self.state.take(i, axis=1), self.P.take(i, axis=1), self.height_px[i])

    def assign(self, rows: IntArray, filters: BoxFilters) -> None:
        """Replace the filters in rows (M,), in place."""
        self.state[:, rows], self.P[:, rows] = filters.state, filters.P
        self.height_px[rows] = filters.height_px

    def concatenate(self, other: BoxFilters) -> BoxFilters:
        """The filters of both states, `other`'s last."""
        return BoxFilters(
            np.concatenate([self.state, other.state], axis=1),
            np.concatenate([self.P, other.P], axis=1),
            np.concatenate([self.height_px, other.height_px]),
        )


def initiate(xyxy_px: FloatArray, noise: MotionNoise) -> BoxFilters:
    """Filters of boxes (N, 4) detected for the first time: rate 0 with the standard deviation
    `first_rate`.
    """
    box = cxcywh(xyxy_px)
    s = box[:, 3].copy()
    P = np.array([(noise.measured * s) ** 2, np.zeros_like(s), (noise.first_rate * s) ** 2])
    return BoxFilters(np.array([box, np.zeros_like(box)]), P, s)


def predict(
    filters: BoxFilters, dt_s: float, noise: MotionNoise, *, noise_scale: float = 1.0
) -> BoxFilters:
    """The filters `dt_s` >= 0 seconds later; `noise_scale` is q, a factor of the process noise's
    variance.
    """
    f, dt = filters, dt_s
    drift, acceleration = noise.drift**2, noise.acceleration**2
    state = f.state.copy()
    state[0] += dt * state[1]
    variance = noise_scale * f.height_px**2
    # of P_xx, P_xv and P_vv: F P F^T is linear in them
    step = np.array([[1.0, 2 * dt, dt**2], [0.0, 1.0, dt], [0.0, 0.0, 1.0]])
    Q = np.array(
        [[drift * dt + acceleration * dt**3 / 3], [acceleration * dt**2 / 2], [acceleration * dt]]
    )
    return BoxFilters(state, step.dot(f.P) + Q * variance, f.height_px)


def update(
    filters: BoxFilters, xyxy_px: FloatArray, noise: MotionNoise, is_person: BoolArray
) -> tuple[BoxFilters, FloatArray]:
    """The filters updated with their detected boxes (N, 4), and innovations in standard deviations,
    y / sqrt(S).

    `is_person` (N,) marks the boxes of persons, whose sizes change slowly.
    """
    f, z = filters, cxcywh(xyxy_px)
    y = z - f.x
    S = f.P[0] + (noise.measured * f.height_px) ** 2
    K = f.P[:2] / S
    change = K[:, :, None] * y
    change[1, is_person, 2:] *= noise.person_size_rate
    P = f.P.copy()
    P[:2] -= K[0] * f.P[:2]
    P[2] -= K[1] * f.P[1]
    return BoxFilters(f.state + change, P, z[:, 3]), y / np.sqrt(S)[:, None]


def smoothed(x: FloatArray, xyxy_px: FloatArray) -> FloatArray:
    """(N, 4) boxes between the detected boxes (N, 4) and the states cx, cy, w, h (N, 4) of the
    updated filters: less jitter, but some lag in position.
    """
    change = _SMOOTHING * (x - cxcywh(xyxy_px))
    return np.asarray(xyxy_px + change.dot(_XYXY_OF_CXCYWH))


def gating_distance(filters: BoxFilters, xyxy_px: FloatArray, noise: MotionNoise) -> FloatArray:
    """(N, M) squared Mahalanobis distances d^2 of boxes (M, 4) from each prediction."""
    y = cxcywh(xyxy_px)[None, :, :] - filters.x[:, None, :]
    S = filters.P[0] + (noise.measured * filters.height_px) ** 2
    return np.asarray((y**2).sum(axis=2) / S[:, None])


def compensate_camera_motion(filters: BoxFilters, now_from_before: FloatArray) -> BoxFilters:
    """The filters in pixels of the current frame: a similarity (2, 3) moves centres, rotates rates
    and scales sizes.
    """
    matrix, shift_px = _of_boxes(now_from_before)
    scale = float(matrix[2, 2])
    state = filters.state.dot(matrix)
    state[0] += shift_px
    return BoxFilters(state, filters.P * scale**2, filters.height_px * scale)


def transformed(xyxy_px: FloatArray, now_from_before: FloatArray) -> FloatArray:
    """Boxes (..., 4) whose centres and sizes a similarity (2, 3) transforms from the previous frame
    to this one.
    """
    matrix, shift_px = _of_boxes(now_from_before)
    of_edges = _CXCYWH_OF_XYXY.dot(matrix).dot(_XYXY_OF_CXCYWH)
    return np.asarray(xyxy_px.dot(of_edges) + shift_px.dot(_XYXY_OF_CXCYWH))


def _of_boxes(now_from_before: FloatArray) -> tuple[FloatArray, FloatArray]:
    """(4, 4) matrix and (4,) shift that a similarity (2, 3) is for rows cx, cy, w, h."""
    (a, b, x_px), (c, d, y_px) = now_from_before.tolist()
    scale = math.sqrt(abs(a * d - b * c))
    matrix = [[a, c, 0.0, 0.0], [b, d, 0.0, 0.0], [0.0, 0.0, scale, 0.0], [0.0, 0.0, 0.0, scale]]
    return np.array(matrix), np.array([x_px, y_px, 0.0, 0.0])


def cxcywh(xyxy_px: FloatArray) -> FloatArray:
    """(..., 4) cx, cy, w, h of boxes (..., 4)."""
    return np.asarray(xyxy_px.dot(_CXCYWH_OF_XYXY))


@dataclass(frozen=True, slots=True, kw_only=True)
class ProcessNoiseSettings:
    """Settings of the estimation of the scale."""

    rate: float = 0.03  # learning rate per track and frame; 0 = a fixed scale
    # lowest, highest: limits of the scale, which starts at the highest
    lowest: float = 0.01
    highest: float = 1.0
    min_hits: int = 4  # number of detections after which a track's innovations are used


class ProcessNoiseScale:
    """The scale of one stream."""

    def __init__(self, settings: ProcessNoiseSettings) -> None:
        self._settings = settings
        self.value = settings.highest  # q, the factor of the process noise's variance

    def update(self, before: FloatArray, now: FloatArray) -> None:
        """Update the scale from innovations of two successive frames, (N, D) each, in standard
        deviations.
        """
        if not len(now):
            return
        ab = np.concatenate([before, now], axis=1)
        np.minimum(np.maximum(ab, -_MAX_SIGMAS, out=ab), _MAX_SIGMAS, out=ab)
        a, b = ab[:, : before.shape[1]], ab[:, before.shape[1] :]
        power = np.maximum(np.vecdot(ab, ab) / 2, _MIN_POWER)
        c = float(np.vecdot(a, b).dot(1.0 / power)) / len(now)
        settings, n = self._settings, min(len(now), _MAX_TRACKS)
        q = self.value * math.exp(settings.rate * n * c)
        self.value = min(max(q, settings.lowest), settings.highest)
