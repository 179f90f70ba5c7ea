r"""Rates of objects under two hypotheses: the object is static, or moves along the axis of the camera at any speed.

Many road users are parked, stand, or cross the road, so that their rate is the known one of static objects:

    v_0 = -V + w b d      V: speed of the camera, w: its yaw rate, positive = to the right, b: bearing x / z

The errors of the filter's d and v are its P and the systematic error of d, with the relative variance s, which scales
v as well:

    C = P + s [d v]' [d v]

Under the hypothesis S the object is static: v_0 is a measurement of v with the variance s_0^2. Under M its own speed
has the standard deviation s_u. The probability p of S follows from the likelihoods of v_0 - v, and the result has the
mean and the covariance of both (Gaussian sum; Alspach and Sorenson, IEEE TAC 1972). d does not change.
"""

from __future__ import annotations

import numpy as np

from track_range.foundation.arrays import FloatArray
from track_range.foundation.constant_velocity import ConstantVelocity

_PRIOR = 0.25  # probability of S; less than the 39 % of objects at 40-80 m on KITTI, for roads without parked ones
_STATIC_SIGMA_MPS, _STATIC_SIGMA = 0.5, 0.03  # s_0: steps of people, and a fraction of V
_MAX_LOG = 100.0  # of a ratio of likelihoods, against overflow


def with_static_hypothesis(
    state: ConstantVelocity,
    systematic: FloatArray,
    static_mps: FloatArray,
    *,
    ego_sigma_mps: float,
    own_sigma_mps: float,
) -> ConstantVelocity:
    """Distances and rates with the covariances C, after both hypotheses.

    Args:
        state: distances and rates with the covariances P.
        systematic: relative variances s of the systematic errors of d.
        static_mps: rates v_0 of static objects; NaN = unknown, the rates are then those of the filter.
        ego_sigma_mps: standard deviation of V, which adds to s_0.
        own_sigma_mps: s_u.
    """
    d, v = state.x, state.v
    C_dd, C_dv, C_vv = state.P_xx + systematic * d * d, state.P_xv + systematic * d * v, state.P_vv + systematic * v * v
    nu, R = static_mps - v, _STATIC_SIGMA_MPS**2 + (_STATIC_SIGMA * static_mps) ** 2 + ego_sigma_mps**2
    S, S_moving = C_vv + R, C_vv + np.maximum(own_sigma_mps**2, R)
    log_ratio = (np.log(S_moving / S) - nu * nu * (1 / S - 1 / S_moving)) / 2
    p = np.nan_to_num(1 / (1 + (1 - _PRIOR) / _PRIOR * np.exp(np.minimum(-log_ratio, _MAX_LOG))))
    K = np.nan_to_num(C_vv / S)
    step = np.nan_to_num(K * nu)
    return ConstantVelocity(
        x=d, v=v + p * step, P_xx=C_dd, P_xv=(1 - p * K) * C_dv, P_vv=(1 - p * K) * C_vv + p * (1 - p) * step * step
    )
