r"""SpeedFilter: Kalman filter of the camera's speed, from the mean speeds between consecutive
frames.

    x = [V, a]'    V, a: speed and acceleration at the middle of the interval between two frames

A mean speed over dt is the speed dt / 2 ago, so the result is predicted by dt / 2. The sigma of a
measurement has an independent part, which averages out, and a systematic one, which is added at the
output.
"""

import math

import numpy as np

from track_range.foundation.constant_velocity import ConstantVelocity

# random walk of the acceleration, m/s^2 per root of a second: a car brakes fully within 0.5 s
_JERK_NOISE = 5.0
_INITIAL_ACCELERATION_MPS2 = 3.0  # standard deviation of the acceleration at the start
_MAX_GAP_S = 0.35  # longest time in seconds without a measurement; the speed is unknown after it
_OUTLIER_SIGMA = 4.0  # innovations beyond this number of standard deviations are ignored
# distance between two frames from which a first speed is not used until a second one agrees
_LARGE_STEP_M = 4.0
# weight of one measurement in the spread of the measurements, and largest spread of one
_SPREAD_GAIN, _MAX_SPREAD2 = 0.15, 400.0
_MAX_OUTLIERS = 3  # number of consecutive outliers after which the filter starts again


class SpeedFilter:
    """Filters the speeds of one stream; the state belongs to the instance."""

    def __init__(self) -> None:
        self._state: ConstantVelocity | None = None
        self._middle_s = self._measured_s = -math.inf
        # consecutive outliers; measurements since the start that agree
        self._n_outliers = self._n_measured = 0
        self._systematic_mps = math.nan
        # ratio of the variance of the measurements to the expected one, at least 1
        self._spread2 = 1.0
        # the part of the last standard deviation that is new in each frame
        self.noise_mps = 0.0

    def update(
        self, time_s: float, dt_s: float, speed_mps: float, sigma_mps: float, systematic_mps: float
    ) -> tuple[float, float]:
        """Speed at `time_s` and its standard deviation, NaN = unknown.

        `speed_mps` is the mean speed over `dt_s`, NaN = not measured; `sigma_mps` its independent
        standard deviation, `systematic_mps` is the sigma of an error that is the same in all
        frames.
        """
        middle_s = time_s - dt_s / 2
        if middle_s - self._measured_s > _MAX_GAP_S:
            self._state = None
        if self._state is not None:
            self._state = self._state.predict(
                np.array([middle_s - self._middle_s]), q=_JERK_NOISE**2
            )
        self._middle_s = middle_s
        if math.isfinite(speed_mps):
            self._measure(middle_s, speed_mps, sigma_mps)
            self._systematic_mps = systematic_mps
        if self._state is None or (
            self._n_measured < 2 and abs(self._state.x[0] * dt_s) > _LARGE_STEP_M
        ):
            return math.nan, math.nan
        now = self._state.predict(np.array([dt_s / 2]), q=_JERK_NOISE**2)
        self.noise_mps = math.sqrt(float(now.P_xx[0]))
        return float(now.x[0]), math.hypot(self.noise_mps, self._systematic_mps)

    def _measure(self, middle_s: float, speed_mps: float, sigma_mps: float) -> None:
        if self._state is not None:
            innovation = np.array([speed_mps]) - self._state.x
            excess = (innovation[0] ** 2 - self._state.P_xx[0]) / sigma_mps**2
            own = (1 - _SPREAD_GAIN) * self._spread2
            self._spread2 = max(1.0, own + _SPREAD_GAIN * min(float(excess), _MAX_SPREAD2))
            sigma_mps *= math.sqrt(self._spread2)
            limit_mps = _OUTLIER_SIGMA * np.sqrt(self._state.P_xx + sigma_mps**2)
            is_outlier = bool(np.abs(innovation)[0] > limit_mps[0])
            self._n_outliers = self._n_outliers + 1 if is_outlier else 0
            if not is_outlier:
                variance = np.array([sigma_mps**2])
                self._state = self._state.update(innovation, variance, valid=np.ones(1, np.bool_))
                self._measured_s, self._n_measured = middle_s, self._n_measured + 1
            if self._n_outliers < _MAX_OUTLIERS:
                return
        values = (speed_mps, 0.0, sigma_mps**2, 0.0, _INITIAL_ACCELERATION_MPS2**2)
        self._state = ConstantVelocity(*(np.array([value]) for value in values))
        self._measured_s, self._n_outliers, self._n_measured = middle_s, 0, 1
