"""CameraHeight: height of the camera above the road from a known speed, such as telemetry or
stereo.

The motion of the road in the images gives the speed in units of the camera height
(`GroundOdometry`), so

    H = H0 V / V0        V0: speed measured with an assumed height H0, V: known speed

H is the median over the frames so far; its uncertainty is the spread over the root of the number of
independent frames, and an error that all frames share: the speed's, and the slope of the road.
"""

import math

import numpy as np

from track_range.foundation.robust_statistics import MAD_TO_SIGMA
from track_range.stereo.odometry.ego_motion import EgoMotion

_MIN_MPS = 3.0  # speed below which the ratio of two speeds is not precise
_CORRELATED_S = 1.0  # time over which errors of the speeds are correlated
_SHARED_SIGMA = 0.02  # relative error of the motion of the road that all frames share
_MIN_S = 1.0  # seconds of measurements before the first height
_MAX_RATIOS = 600  # largest number of stored ratios: the last ones


class CameraHeight:
    """Estimator of the camera height from speeds measured with `assumed_m`; the state belongs to
    the instance.

    `shared_sigma` is the relative error that all frames share.
    """

    def __init__(self, assumed_m: float, *, shared_sigma: float = _SHARED_SIGMA) -> None:
        self._assumed_m, self._shared_sigma = assumed_m, shared_sigma
        self._log_ratios: list[float] = []
        self._measured_s = 0.0
        self._last_s = math.nan

    def update(self, time_s: float, known: EgoMotion, road: EgoMotion) -> None:
        """Add a frame with a known speed, and the speed of the motion of the road with the assumed
        height.
        """
        step_s, self._last_s = time_s - self._last_s, time_s
        is_known = known.speed_mps >= _MIN_MPS and road.speed_mps >= _MIN_MPS  # False for NaN
        if is_known and 0 < step_s <= _CORRELATED_S:
            self._measured_s += step_s
            self._log_ratios = [
                *self._log_ratios[1 - _MAX_RATIOS :],
                math.log(known.speed_mps / road.speed_mps),
            ]

    @property
    def height_m(self) -> tuple[float, float] | None:
        """Height and its standard deviation in metres; None = unknown."""
        if self._measured_s < _MIN_S:
            return None
        log_ratios = np.array(self._log_ratios)
        median = float(np.median(log_ratios))
        spread = MAD_TO_SIGMA * float(np.median(np.abs(log_ratios - median)))
        sigma = math.hypot(
            1.25 * spread / math.sqrt(self._measured_s / _CORRELATED_S), self._shared_sigma
        )
        height_m = self._assumed_m * math.exp(median)
        return height_m, sigma * height_m
