"""EgoTrend: speed, acceleration and yaw rate of the ego vehicle, from which its path follows."""

from __future__ import annotations

import math

import numpy as np

from track_range.foundation.constant_velocity import ConstantVelocity
from track_range.ranging.warning.warnings import WarningSettings

MAX_GAP_S = 1.0  # longest time without a value in s; after it the filters restart
JERK_NOISE = 2.0  # process noise: random walk of accelerations in m/s^2 per square root of a second
INITIAL_ACCELERATION_MPS2 = 1.0  # standard deviation of the acceleration at the start
_EGO_SPEED_SIGMA_MPS = 0.1  # standard deviation of a value of the ego speed, m/s
_INITIAL_YAW_RAD_S2 = 0.03  # standard deviation of the change of the yaw rate at the start, rad/s^2
_BENDS_S = 5.0  # time constant of the mean square of the lateral acceleration, s
_INITIAL_LATERAL_MPS2 = 0.5  # root mean square of the lateral acceleration at the start of a drive, m/s^2
_TYPICAL_SPEED_MPS = 12.0  # speed assumed for the curvature if the yaw rate is known but not the speed, m/s
_MIN_SPEED_MPS = 2.0  # smallest speed for the curvature, m/s


class EgoTrend:
    """Speed, acceleration and yaw rate of the ego vehicle."""

    def __init__(self, settings: WarningSettings) -> None:
        self._settings = settings
        # 0 = unknown; yaw_noise: growth of the variance of w' per second
        self.speed_mps = self.acceleration_mps2 = self.yaw_noise = 0.0
        self.path_mps = _TYPICAL_SPEED_MPS  # speed for the shape of the path, never 0
        self.has_speed = self.has_yaw = False
        self._speed: ConstantVelocity | None = None
        self.yaw = _state(0.0, 0.0, 0.0)  # yaw rate w and its change w', rad/s and rad/s^2
        self._lateral_mps2 = _INITIAL_LATERAL_MPS2
        self._time_s = -math.inf

    def update(self, time_s: float, speed_mps: float, yaw_rad_s: float) -> None:
        """Update with the values of a frame; NaN = unknown."""
        dt = time_s - self._time_s
        self._time_s = time_s

        # Speed.
        was_known, self.has_speed = self.has_speed, math.isfinite(speed_mps)
        R = _EGO_SPEED_SIGMA_MPS**2
        if not self.has_speed:
            self._speed = None
        elif self._speed is None or not was_known or dt > MAX_GAP_S:
            self._speed = _state(speed_mps, R, INITIAL_ACCELERATION_MPS2**2)
        else:
            predicted = self._speed.predict(dt, q=JERK_NOISE**2)
            self._speed = predicted.update(speed_mps - predicted.x, R)
        self.acceleration_mps2 = 0.0 if self._speed is None else float(self._speed.v)
        self.speed_mps = speed_mps if self.has_speed else 0.0
        self.path_mps = V = max(speed_mps, _MIN_SPEED_MPS) if self.has_speed else _TYPICAL_SPEED_MPS

        # Yaw rate.
        settings = self._settings
        was_known, self.has_yaw = self.has_yaw, math.isfinite(yaw_rad_s)
        self.yaw_noise = ((settings.lateral_jerk_noise + settings.winding_noise * self._lateral_mps2) / V) ** 2
        R = settings.yaw_sigma_rad_s**2
        if not self.has_yaw:
            self.yaw = _state(0.0, (settings.unknown_lateral_mps2 / V) ** 2, 0.0)
        elif not was_known or dt > MAX_GAP_S:
            self.yaw = _state(yaw_rad_s, R, _INITIAL_YAW_RAD_S2**2)
        else:
            predicted = self.yaw.predict(dt, q=self.yaw_noise)
            self.yaw = predicted.update(yaw_rad_s - predicted.x, R)
            decay = math.exp(-dt / _BENDS_S)
            square = decay * self._lateral_mps2**2 + (1 - decay) * float(self.yaw.x * V) ** 2
            self._lateral_mps2 = math.sqrt(square)


def _state(x: float, P_xx: float, P_vv: float) -> ConstantVelocity:
    """The state of a value without a rate."""
    return ConstantVelocity(*(np.array(value) for value in (x, 0.0, P_xx, 0.0, P_vv)))
