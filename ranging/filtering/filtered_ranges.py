"""FilteredRanges: filtered distances of one method, with their rate and the time to collision."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from track_range.foundation.arrays import FloatArray
from track_range.foundation.constant_velocity import ConstantVelocity
from track_range.ranging.ranges import Ranges

MIN_CLOSING_MPS = 0.3
"""Smallest closing speed in m/s for which a time to collision is reported; below, the time is mostly noise."""


@dataclass(frozen=True, slots=True)
class FilteredRanges:
    """Filtered distances of one method, with their rate and the time to collision.

    Attributes:
        ranges: distance and sigma, NaN = no recent measurement.
        rate_mps: (N,) change of distance per second, negative = closing; NaN = unknown.
        rate_sigma_mps: (N,) standard deviation of the rate, and of the closing speed `-rate_mps`.
        ttc_s: (N,) time to collision, distance / closing speed; NaN = not closing, or the rate is unknown.
        ttc_sigma_s: (N,) standard deviation of `ttc_s`, to first order.
        state: distance and rate in m and m/s, (N,) each, with the covariance of their independent errors; also where
            the rate is too uncertain to be reported.
    """

    ranges: Ranges
    rate_mps: FloatArray
    rate_sigma_mps: FloatArray
    ttc_s: FloatArray
    ttc_sigma_s: FloatArray
    state: ConstantVelocity


def time_to_collision(
    distance_m: FloatArray, rate_mps: FloatArray, *, variances: tuple[FloatArray, FloatArray, FloatArray]
) -> tuple[FloatArray, FloatArray]:
    """Time to collision T = d / -v in s and its standard deviation, (...) each; NaN = not closing.

        (sigma_T / T)^2 = P_dd / d^2 - 2 P_dv / (d v) + P_vv / v^2        to first order

    Args:
        distance_m: (...) distance d.
        rate_mps: (...) rate v, negative = closing.
        variances: P_dd, P_dv, P_vv, (...) each.
    """
    closing_mps = np.where(rate_mps < -MIN_CLOSING_MPS, -rate_mps, np.nan)
    ttc_s = distance_m / closing_mps
    P_dd, P_dv, P_vv = variances
    relative = P_dd / distance_m**2 + 2 * P_dv / (distance_m * closing_mps) + P_vv / closing_mps**2
    return ttc_s, ttc_s * np.sqrt(np.maximum(relative, 0.0))
