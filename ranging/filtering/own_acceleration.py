"""The lag of filtered rates behind accelerations that last (`TargetStates`)."""

import numpy as np

from track_range.foundation.arrays import FloatArray
from track_range.foundation.constant_velocity import ConstantVelocity

# tau, from changes of speed of moving vehicles on 13 of KITTI's sequences: their mean square grows
# by factors of 3.3, 3.0 and 2.7 from 0.5 over 1 and 2 to 4 s, that of a random walk by 2
MANOEUVRE_S = 1.5
_MAX_LAG_S = 0.6  # of a motion that is corrected


def without_lag(
    motion: ConstantVelocity, missed_mps2: FloatArray, variance: FloatArray
) -> ConstantVelocity:
    """Filtered distances and rates, corrected for their lag behind an acceleration of which the
    filter follows all but `missed_mps2`, with its variance.

    In the steady state, a filter of constant speed is behind by e_v = a T and e_x = a T^2 / 2 with
    T = P_xx / P_xv; one that follows a part of a is behind by the rest.
    """
    T = motion.P_xx / np.maximum(motion.P_xv, 1e-9)
    T = np.minimum(np.maximum(T, 0.0), _MAX_LAG_S)
    T2, lag_mps = T * T, missed_mps2 * T
    variance_mps = variance * T2
    return ConstantVelocity(
        motion.x + lag_mps * T / 2,
        motion.v + lag_mps,
        motion.P_xx + variance_mps * T2 / 4,
        motion.P_xv + variance_mps * T / 2,
        motion.P_vv + variance_mps,
    )
