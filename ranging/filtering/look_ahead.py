r"""Motion with the measurements of later frames: a filter forwards and one backwards in time, combined.

The backward filter sees the frames in reverse order with the negative of times and speeds, so that its rate is -v. For
a Markov model the states of both at the same time, x_f and x_b, have independent errors given the state (Fraser and
Potter, IEEE TAC 1969):

    P^-1 = P_f^-1 + P_b^-1        x = P (P_f^-1 x_f + P_b^-1 x_b)

Both contain the measurement of that time, which counts twice: little, against all others.
"""

from __future__ import annotations

import numpy as np

from track_range.foundation.arrays import FloatArray
from track_range.foundation.constant_velocity import ConstantVelocity


def combined(forward: ConstantVelocity, backward: ConstantVelocity) -> ConstantVelocity:
    """State of (N,) tracks from the states forwards and backwards in time; one of them where the other is unknown."""
    backward = ConstantVelocity(backward.x, -backward.v, backward.P_xx, -backward.P_xv, backward.P_vv)
    f_information, f_vector = _information(forward)
    b_information, b_vector = _information(backward)
    information = f_information + b_information
    is_known = np.isfinite(forward.x) | np.isfinite(backward.x)
    P = np.linalg.inv(np.where(is_known[:, None, None], information, np.eye(2)))
    P[~is_known] = np.nan
    x, v = (P @ (f_vector + b_vector)[..., None])[..., 0].T
    return ConstantVelocity(x, v, P[:, 0, 0], P[:, 0, 1], P[:, 1, 1])


def _information(state: ConstantVelocity) -> tuple[FloatArray, FloatArray]:
    """P^-1 (N, 2, 2) and P^-1 x (N, 2); 0 where the state is unknown."""
    x, v, P_xx, P_xv, P_vv = state.columns
    is_known = np.isfinite(x)
    P = np.where(is_known, [[P_xx, P_xv], [P_xv, P_vv]], np.eye(2)[..., None]).transpose(2, 0, 1)
    information = np.linalg.inv(P) * is_known[:, None, None]
    vector = information @ np.nan_to_num([x, v]).T[..., None]
    return information, vector[..., 0]
