"""Errors that the distances of objects have in common: a scale, and an offset of the disparities.

    r_i = s + log(1 + o w_i) + e_i   r_i: log of the distance by stereo over that by size, object i
                                     s: common scale, o: true minus measured disparity
                                     w_i: inverse disparity in 1/px, e_i: own error of the object

A fraction of the objects are outliers. Near and far objects separate s and o.
"""

import math
from typing import Any, NamedTuple

import numpy as np
import numpy.typing as npt

from track_range.foundation.arrays import FloatArray

AnyFloats = npt.NDArray[np.floating[Any]]

# fraction of objects with a mismatch or a wrong class, and their sigma
_OUTLIER, _OUTLIER_SIGMA = 0.1, 1.0
_MIN_OBJECT_SIGMA = 0.06  # of an object: its frames do not average out
_STEP = 0.02
_LOG = np.arange(-3.2, 3.2 + _STEP / 2, _STEP)  # (G,) grid of the scale
_OFFSET_STEP_PX, _MAX_OFFSET_PX = 0.5, 12.0
# (O,) grid of the offset, and the standard deviation of the prior that bounds it, which is wider
# than what is known of any pair
_OFFSETS_PX = np.arange(-_MAX_OFFSET_PX, _MAX_OFFSET_PX + 1e-9, _OFFSET_STEP_PX)
OFFSET_SIGMA_PX = 6.0
_MAX_OBJECTS = 60  # with the least variance, for two errors; more do not change the estimate
_LEAST_LIKELIHOOD = 1e-30  # of an object, within single precision
_MIN_RATIO = 0.05  # smallest ratio of the true and the measured disparity


class CommonErrors(NamedTuple):
    """Scale and offset in px, which are jointly normal."""

    mean: FloatArray  # (2,)
    information: FloatArray  # (2, 2) inverse of their covariance

    def equations(self) -> list[tuple[float, float, float]]:
        """Independent equations, as coefficients of scale and offset, and a value with the standard
        deviation 1.
        """
        eigenvalues, vectors = np.linalg.eigh(self.information)
        rows = np.sqrt(eigenvalues)[:, None] * vectors.T
        return [(float(row[0]), float(row[1]), float(row @ self.mean)) for row in rows]


def common_scale(value: FloatArray, variance: FloatArray) -> tuple[float, float]:
    """Mean and standard deviation of the common part of the objects (K,)."""
    log_p = _log_likelihood(value[:, None] - _LOG, variance[:, None]).sum(axis=0)
    weight = _normalised(log_p)
    mean = float(weight @ _LOG)
    return mean, math.sqrt(float(weight @ (_LOG - mean) ** 2) + _STEP**2 / 12)


def common_errors(
    value: FloatArray,
    variance: FloatArray,
    inverse_px: FloatArray,
    *,
    shared_variance: float = 0.0,
) -> CommonErrors:
    """Scale and offset of the objects: (K,) ratios, variances, and inverse disparities;
    `shared_variance` is that of a further error of the scale.
    """
    best = np.argsort(variance)[:_MAX_OBJECTS]
    value, variance, inverse_px = value[best], variance[best], inverse_px[best]
    moved = np.log(np.maximum(1.0 + _OFFSETS_PX * inverse_px[:, None], _MIN_RATIO))  # (K, O)
    log_p = -0.5 * np.tile((_OFFSETS_PX / OFFSET_SIGMA_PX) ** 2, (len(_LOG), 1))  # (G, O)
    # with single precision, which takes a third of the time: errors of 1e-6 in the result
    at_offsets = (value[:, None] - moved).astype(np.float32)
    scales = _LOG[:, None].astype(np.float32)
    for at_offset, own in zip(at_offsets, variance.tolist(), strict=True):
        log_p += _log_likelihood(at_offset - scales, own)
    weight = _normalised(log_p)
    mean = np.array([weight.sum(axis=1) @ _LOG, weight.sum(axis=0) @ _OFFSETS_PX])
    scale, offset = _LOG[:, None] - mean[0], _OFFSETS_PX - mean[1]
    covariance = np.array(
        [
            [(weight * scale**2).sum(), (weight * scale * offset).sum()],
            [(weight * scale * offset).sum(), (weight * offset**2).sum()],
        ]
    ) + np.diag([_STEP**2 / 12 + shared_variance, _OFFSET_STEP_PX**2 / 12])
    return CommonErrors(mean, np.linalg.inv(covariance))


def _log_likelihood(difference: AnyFloats, variance: FloatArray | float) -> AnyFloats:
    """The logarithm for each difference, in its precision."""
    own_variance = variance + _MIN_OBJECT_SIGMA**2
    squared = -0.5 * difference * difference
    near = np.exp(squared / own_variance) * ((1 - _OUTLIER) / own_variance**0.5)
    far = np.exp(squared / _OUTLIER_SIGMA**2) * (_OUTLIER / _OUTLIER_SIGMA)
    return np.log(np.maximum(near + far, _LEAST_LIKELIHOOD))


def _normalised(log_p: FloatArray) -> FloatArray:
    weight = np.exp(log_p - log_p.max())
    return np.asarray(weight / weight.sum())
