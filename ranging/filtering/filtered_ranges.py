"""FilteredRanges: filtered distances of one method with rate and time to collision."""

from dataclasses import dataclass, replace

import numpy as np

from track_range.foundation.arrays import FloatArray
from track_range.foundation.constant_velocity import ConstantVelocity
from track_range.ranging.measurement.ranges import Ranges

# smallest closing speed with a time to collision; below, the time is mostly noise
MIN_CLOSING_MPS = 0.3


@dataclass(frozen=True, slots=True)
class FilteredRanges:
    """Filtered distances of one method, with their rate and the time to collision."""

    ranges: Ranges  # distance and sigma, NaN = no recent measurement
    rate_mps: FloatArray  # (N,) change of distance per second, negative = closing; NaN = unknown
    # (N,) standard deviation of the rate, and of the closing speed `-rate_mps`
    rate_sigma_mps: FloatArray
    # (N,) time to collision, distance / closing speed; NaN = not closing, or the rate is unknown
    ttc_s: FloatArray
    ttc_sigma_s: FloatArray  # (N,) standard deviation of `ttc_s`, to first order
    # distance and rate, (N,) each, also where the rate is too uncertain to be reported
    state: ConstantVelocity
    own_mps2: FloatArray  # (N,) acceleration over ground that the rate follows; 0 = none
    # (N,) probability that the object does not move along the axis; None = unknown
    static: FloatArray | None = None

    def scaled(self, factor: float) -> "FilteredRanges":
        """Distances and rates times a factor; times to collision stay."""
        if factor == 1.0:
            return self
        return replace(
            self,
            ranges=self.ranges.scaled(factor),
            rate_mps=factor * self.rate_mps,
            rate_sigma_mps=factor * self.rate_sigma_mps,
            state=self.state.scaled(factor),
            own_mps2=factor * self.own_mps2,
        )


def time_to_collision(
    distance_m: FloatArray,
    rate_mps: FloatArray,
    *,
    variances: tuple[FloatArray, FloatArray, FloatArray],
) -> tuple[FloatArray, FloatArray]:
    """Time to collision T = d / -v in s and its standard deviation, (...) each; NaN = not closing.

    (sigma_T / T)^2 = P_dd / d^2 - 2 P_dv / (d v) + P_vv / v^2        to first order; `variances` are P_dd, P_dv, P_vv
    """
    closing_mps = np.where(rate_mps < -MIN_CLOSING_MPS, -rate_mps, np.nan)
    ttc_s = distance_m / closing_mps
    P_dd, P_dv, P_vv = variances
    relative = P_dd / distance_m**2 + 2 * P_dv / (distance_m * closing_mps) + P_vv / closing_mps**2
    return ttc_s, ttc_s * np.sqrt(np.maximum(relative, 0.0))
