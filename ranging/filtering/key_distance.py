r"""Growth of objects in the images since a key frame, as a measurement of the filters of distances.

The ratio of an object's size now and in its key frame gives the ratio of its distances, without a
focal length or a size:

    log s = log r - log d      r: distance in the key frame

In metres, with the states x = [d v a r]' of `TargetStates`, it is a measurement of c r - d:

    nu = d (log s - log r/d)   H = [-1 0 0 c], c = d / r   R = d^2 sigma^2
"""

from typing import NamedTuple

import numpy as np

from track_range.foundation.arrays import BoolArray, FloatArray
from track_range.ranging.filtering.target_states import TargetStates
from track_range.ranging.measurement.growth import Growth


class GrowthInnovation(NamedTuple):
    """Innovations of the growths of N tracks in the filters of M methods and G models, (M, G, N)
    each.
    """

    valid: BoolArray  # False = no growth, or no key frame
    nu: FloatArray  # m; 0 = not valid
    R: FloatArray  # m^2
    P_zz: FloatArray  # H P H'; the variance of nu is P_zz + R
    c: FloatArray  # d / r; 0 = not valid


def innovation(states: TargetStates, growth: Growth, *, valid: BoolArray) -> GrowthInnovation:
    """Innovations of the growth of those `valid` filters that have a key frame."""
    d, r, P = states.d, states.r, states.P
    # NaN without a key frame, and if a model predicts the object behind the camera
    ratio = np.where(r * d > 0.0, r / d, np.nan)
    nu = d * (growth.log_ratio - np.log(ratio))
    valid = valid & np.isfinite(nu)
    c = np.where(valid, d / r, 0.0)
    P_zz = c * (c * P[3, 3] - 2.0 * P[0, 3]) + P[0, 0]
    sigma_m = d * growth.sigma
    return GrowthInnovation(
        valid=valid,
        nu=np.where(valid, nu, 0.0),
        R=sigma_m * sigma_m,
        P_zz=np.maximum(P_zz, 0.0),
        c=c,
    )


def correct_by_growth(
    states: TargetStates, growth: GrowthInnovation, *, outlier_sigma: float
) -> None:
    """Correct the states by valid growths.

    Measurements beyond `outlier_sigma` standard deviations are down-weighted. Where the covariance
    would not be positive, since distances far apart are not linear, the key frame is given up
    instead.
    """
    limit = outlier_sigma * np.sqrt(growth.P_zz + growth.R)
    excess = np.maximum(1.0, np.abs(growth.nu) / limit)
    weight = np.where(growth.valid, 1.0 / (growth.P_zz + growth.R * excess * excess), 0.0)
    before = states.table.copy()
    states.correct_by_difference(growth.c, growth.nu, weight)
    is_lost = growth.valid & ~_is_positive(states.P)
    if is_lost.any():
        np.copyto(states.table, before, where=is_lost)
        states.forget_key(is_lost)


def _is_positive(P: FloatArray) -> BoolArray:
    """Whether the variances of d, v and r (..., M, G, N) are positive, and d and v not more than
    fully correlated.
    """
    P_dd, P_vv, P_rr = P[0, 0], P[1, 1], P[3, 3]
    is_impossible = (np.minimum(np.minimum(P_dd, P_vv), P_rr) <= 0) | (
        P_dd * P_vv < P[0, 1] * P[0, 1]
    )
    return np.asarray(~is_impossible)
