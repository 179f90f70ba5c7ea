r"""PassingOffsets: lateral offset at which a track will pass the camera, and whether it may hit the ego vehicle.

       v per second
    o ---.            From the lateral position x of the object and its rate v (`lateral_motion`): at the time to
    |     \           collision T the object passes the camera at the lateral offset
    |      \              o = x + v T,    var o = P_xx + 2 T P_xv + T^2 P_vv + (a T^2 / 2)^2
    +--[]---'         where a is the standard deviation of the lateral acceleration until then (steering, curves).
     camera  o        At constant bearing o = 0.

A track is on a collision course unless |o| exceeds the sum of half the box width, half the width of the ego vehicle and
one standard deviation.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from track_range.foundation.arrays import BoolArray, FloatArray
from track_range.ranging.filtering.lateral_motion import LateralMotion

EGO_HALF_WIDTH_M = 0.9
"""Half the width of the ego vehicle in m, of a typical passenger car."""

_LATERAL_ACCELERATION_MPS2 = 0.25
"""Standard deviation a of the lateral acceleration, tuned on simulated drives; a lane change reaches twice as much."""


@dataclass(frozen=True, slots=True)
class PassingOffsets:
    """Lateral offsets at which tracks will pass the camera, (N,) each; NaN = unknown.

    Attributes:
        lateral_offset_m: offset o of the object's centre at the time of collision, positive = right of the camera.
        sigma_m: its standard deviation.
        half_width_m: half the width of the object, from its current box.
        may_hit: False if the object will pass the ego vehicle; True also if that is unknown.
    """

    lateral_offset_m: FloatArray
    sigma_m: FloatArray
    half_width_m: FloatArray
    may_hit: BoolArray


def passing_offsets(motion: LateralMotion, ttc_s: FloatArray) -> PassingOffsets:
    """Offsets o of N tracks at their times to collision (N,); NaN = not closing, the offset is then NaN too."""
    state, T, a = motion.state, ttc_s, _LATERAL_ACCELERATION_MPS2
    offset_m = state.x + T * state.v
    variance = state.P_xx + T * (2 * state.P_xv + T * state.P_vv)
    sigma_m = np.sqrt(variance + (a * T**2 / 2) ** 2)
    passes = np.abs(offset_m) > EGO_HALF_WIDTH_M + motion.half_width_m + sigma_m  # False for NaN
    return PassingOffsets(offset_m, sigma_m, motion.half_width_m, ~passes)
