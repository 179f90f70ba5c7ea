"""FilteredRanges: one method's distances after a filter over time, their rate and the time to collision."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from track_range.foundation.arrays import FloatArray
from track_range.ranging.ranges import Ranges

MIN_CLOSING_MPS = 0.3
"""Least closing speed that has a time to collision; below, it would be minutes of noise."""


@dataclass(frozen=True, slots=True)
class FilteredRanges:
    """Filtered ranges, their rate, and the time to collision from both.

    Attributes:
        ranges: distance and sigma, NaN = no recent measurement.
        rate_mps: (N,) change of distance per second, negative = closing; NaN while unknown.
        rate_sigma_mps: (N,) its standard deviation, and so that of the closing speed, `-rate_mps`.
        ttc_s: (N,) time to collision, distance / closing speed; NaN where it does not close, or the rate is unknown.
        ttc_sigma_s: (N,) its standard deviation, to first order.
    """

    ranges: Ranges
    rate_mps: FloatArray
    rate_sigma_mps: FloatArray
    ttc_s: FloatArray
    ttc_sigma_s: FloatArray


def time_to_collision(
    distance_m: FloatArray, rate_mps: FloatArray, *, variances: tuple[FloatArray, FloatArray, FloatArray]
) -> tuple[FloatArray, FloatArray]:
    """(...) seconds until the distance is 0 at this rate, and their sigma to first order; NaN where it does not close.

    Args:
        distance_m: (...) distance.
        rate_mps: (...) its rate, negative = closing.
        variances: (...) each, of the distance, its covariance with the rate, of the rate.
    """
    closes_mps = np.where(rate_mps < -MIN_CLOSING_MPS, -rate_mps, np.nan)
    ttc_s = distance_m / closes_mps
    of_distance, of_both, of_rate = variances
    relative = of_distance / distance_m**2 + 2 * of_both / (distance_m * closes_mps) + of_rate / closes_mps**2
    return ttc_s, ttc_s * np.sqrt(np.maximum(relative, 0.0))
