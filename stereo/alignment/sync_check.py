"""measured_lag: by how much the right image of a rectified pair is late, from the vertical motion of its points.

    f = y_left - y_before    motion of a point from an earlier left image to the left image
    v = y_right - y_left     its row offset: 0 in simultaneous images; in a late right image, the point has moved less:
                             v = a + b x + c y + d x y - lag f,  lag in times between the left images

All that moves up or down counts: the expansion of the image in forward motion, pitch, and other road users. The other
terms describe a rig that does not fit the images. Without vertical motion, the lag is unknown.
"""

import math
from functools import partial
from typing import NamedTuple

import cv2
import numpy as np

from track_range.foundation.arrays import FloatArray, Image
from track_range.foundation.robust_statistics import MAD_TO_SIGMA, median_of
from track_range.foundation.sparse_flow import (
    BackgroundFlow,
    masked_cells,
    ranked_corners,
    tracked_corners,
)
from track_range.stereo.geometry.frames import ImageView

# largest number of points, and their quality relative to the best one
_N_CORNERS, _MIN_QUALITY = 100, 0.02
# of Lucas-Kanade in the small images, also for disparities, which are not known
_WINDOW_PX, _N_LEVELS = 9, 4
# largest distance between a point and where it is found again from the right image
_MAX_RETURN_PX = 0.5
_MIN_POINTS = 25  # smallest number of points that agree
# Smallest vertical motion beyond the terms of the rig, small pixels, and relative to the scatter of
# the rows: the noise of the left image is in both f and v, so that without motion the lag would
# seem to be 0.5.
_MIN_MOTION_PX, _MIN_RATIO = 0.15, 2.0
_MAX_SIGMA = 0.1  # largest standard deviation of a known lag, in times between the left images
# Of the fit: lags with which it starts; scatter of the rows of points, at least, and with their
# motion, which is not constant; Tukey's constant and the number of rounds.
_LAGS = np.linspace(-6, 6, 25)[:, None]
_MIN_SCATTER_PX, _SCALE_PX, _SCALE = 0.05, 0.2, 0.15
_TUKEY, _N_ROUNDS = 4.685, 4


class Lag(NamedTuple):
    """Delay of a right image in intervals between the two left images; negative = early."""

    value: float
    sigma: float
    n_points: int  # number of points that agree
    is_known: bool  # whether they are enough, and agree well


def measured_lag(before: ImageView, left: ImageView, right: ImageView) -> Lag | None:
    """The lag of a rectified right image behind the left image; None = no vertical motion.

    `before` is a left image of a short time before (or after: the sign changes). One measurement
    takes 2 or 3 ms.
    """
    small_left = small_view(left)
    corners = ranked_corners(small_left, masked_cells(np.zeros((0, 4)), small_left.shape, 0))
    points = corners.points[: corners.n_good(_N_CORNERS, _MIN_QUALITY)]
    track = partial(tracked_corners, window_px=_WINDOW_PX, n_levels=_N_LEVELS)
    in_before, is_tracked = track(small_left, small_view(before), points)
    points, in_before = points[is_tracked], in_before[is_tracked]
    if len(points) < _MIN_POINTS:
        return None
    x, y = (points.astype(np.float64) - np.array(small_left.shape[::-1]) / 2).T / small_left.shape[
        1
    ]
    rig = np.stack([np.ones(len(x)), x, y, x * y], axis=1)
    moved_px = (points[:, 1] - in_before[:, 1]).astype(np.float64)
    flat = np.ones(len(x))
    # that of most points, so that a few do not decide
    motion_px = _fitted(rig, moved_px, flat, flat).scatter
    if motion_px < _MIN_MOTION_PX:
        return None
    small_right = _exposed_as(small_view(right), small_left)
    in_right, is_right = track(small_left, small_right, points)
    back, is_back = track(small_right, small_left, in_right, n_levels=1, start=points)
    is_used = is_right & is_back & (np.abs(back - points).max(axis=1) < _MAX_RETURN_PX)
    if is_used.sum() < _MIN_POINTS:
        return Lag(math.nan, math.inf, 0, is_known=False)
    rig, moved_px = rig[is_used], moved_px[is_used]
    row_offset_px = (in_right[is_used, 1] - points[is_used, 1]).astype(np.float64)
    basis = np.linalg.qr(rig)[0]
    # (K, N) for each lag, then what the terms of the rig do not explain
    error_px = row_offset_px + _LAGS * moved_px
    error_px -= error_px @ basis @ basis.T
    scale = _SCALE_PX + _SCALE * np.abs(moved_px - basis @ (moved_px @ basis))
    best = int(np.log1p((error_px / scale) ** 2).sum(axis=1).argmin())
    scale /= float(median_of(scale))
    fit = _fitted(
        np.column_stack([rig, -moved_px]), row_offset_px, _weights(error_px[best] / scale)[0], scale
    )
    sigma = fit.scatter * math.sqrt(fit.covariance[-1, -1])
    is_known = (
        fit.n_points >= _MIN_POINTS
        and sigma <= _MAX_SIGMA
        and motion_px >= _MIN_RATIO * fit.scatter
    )
    return Lag(float(fit.coefficients[-1]), sigma, fit.n_points, is_known)


def small_view(view: ImageView) -> Image:
    """Every second pixel, or fewer, of a view in grey or green."""
    step = 1 << BackgroundFlow().n_halvings((view.shape[0], view.shape[1]))
    pixels = view[step // 2 :: step, step // 2 :: step]
    return np.ascontiguousarray(pixels if pixels.ndim == 2 else pixels[:, :, 1])


def _exposed_as(image: Image, other: Image) -> Image:
    """An image with the mean and contrast of another image, which Lucas-Kanade needs."""
    (mean, sigma), (other_mean, other_sigma) = (
        [float(y[0, 0]) for y in cv2.meanStdDev(x)] for x in (image, other)
    )
    gain = other_sigma / max(sigma, 1.0)
    return np.asarray(cv2.addWeighted(image, gain, image, 0.0, other_mean - gain * mean), np.uint8)


class _Fit(NamedTuple):
    coefficients: FloatArray  # (T,)
    covariance: FloatArray  # (T, T) relative to the squared scatter
    scatter: float
    n_points: int


def _fitted(terms: FloatArray, values: FloatArray, weight: FloatArray, scale: FloatArray) -> _Fit:
    """Values (N,) with relative scatter (N,) as a sum of terms (N, T), by weighted least squares
    (Tukey).
    """
    for _ in range(_N_ROUNDS):
        weighted = terms * (weight / scale**2)[:, None]
        covariance = np.asarray(
            np.linalg.inv(weighted.T @ terms + 1e-9 * np.eye(terms.shape[1])), np.float64
        )
        coefficients = covariance @ (weighted.T @ values)
        weight, scatter = _weights((values - terms @ coefficients) / scale)
    return _Fit(coefficients, covariance, scatter, int((weight > 0).sum()))


def _weights(residual: FloatArray) -> tuple[FloatArray, float]:
    """(N,) Tukey weights of the residuals (N,), and the robust standard deviation of the
    residuals.
    """
    scatter = max(MAD_TO_SIGMA * float(median_of(np.abs(residual))), _MIN_SCATTER_PX)
    return np.clip(1 - (residual / (_TUKEY * scatter)) ** 2, 0, None) ** 2, scatter
