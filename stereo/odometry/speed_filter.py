r"""SpeedFilter: Kalman filter of the camera's speed, from the mean speeds between consecutive
frames.

    x = [V, a]'    V, a: speed and acceleration at the middle of the interval between two frames

A mean speed over dt is the speed dt / 2 ago, so the result is predicted by dt / 2. The sigma of a
measurement has an independent part, which averages out, and a systematic one, which is added at the
output.

A speed that no car reaches from the last one is that of something else: it is not used, the speed
is predicted, soon unknown, and starts again with a speed that is within reach.
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
# number of consecutive outliers within reach after which the filter starts again
_MAX_OUTLIERS = 3
# of a car that brakes fully on a dry road, and of a fast one that pulls away
_MAX_BRAKING_MPS2, _MAX_ACCELERATION_MPS2 = 10.0, 6.0
_USUAL_MPS2 = 3.0  # of a car whose speed is unknown: full braking is rare
_REACH_SIGMA = 3.0  # errors of two speeds that may lie between them besides an acceleration
_MAX_REACH_SPREAD2 = 4.0  # largest spread in them, and of a speed out of reach
_REST_MPS = 0.3  # largest speed of a camera that images show at rest


class SpeedFilter:
    """Filters the speeds of one stream; the state belongs to the instance."""

    def __init__(self) -> None:
        self._state: ConstantVelocity | None = None
        self._middle_s = self._measured_s = -math.inf
        # speed by the last measurement that was used, and its standard deviation; NaN = none
        self._known_mps = self._known_sigma_mps = math.nan
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
        if math.isfinite(speed_mps) and self._add(middle_s, speed_mps, sigma_mps):
            self._systematic_mps = systematic_mps
        if self._state is None or (
            self._n_measured < 2 and abs(self._state.x[0] * dt_s) > _LARGE_STEP_M
        ):
            return math.nan, math.nan
        now = self._state.predict(np.array([dt_s / 2]), q=_JERK_NOISE**2)
        self.noise_mps = math.sqrt(float(now.P_xx[0]))
        return float(now.x[0]), math.hypot(self.noise_mps, self._systematic_mps)

    @property
    def is_known(self) -> bool:
        """Whether the speed was known in the last frame."""
        return self._state is not None

    def reaches(self, middle_s: float, speed_mps: float, sigma_mps: float) -> bool:
        """Whether a car can have a speed at a time after the last one; True without a last one,
        False for NaN.
        """
        if math.isnan(self._known_mps):
            return math.isfinite(speed_mps)
        wide_mps = sigma_mps * math.sqrt(min(self._spread2, _MAX_REACH_SPREAD2))
        error_mps = _REACH_SIGMA * math.hypot(wide_mps, self._known_sigma_mps)
        is_slower = abs(speed_mps) < abs(self._known_mps)
        limit_mps2 = _MAX_BRAKING_MPS2 if is_slower else _MAX_ACCELERATION_MPS2
        span_s = middle_s - self._measured_s
        if span_s > _MAX_GAP_S:  # the images were wrong before, and may still be
            limit_mps2 = _USUAL_MPS2
        return abs(speed_mps - self._known_mps) <= limit_mps2 * span_s + error_mps

    def is_rest(self, speed: tuple[float, float], *, shows_rest: bool) -> bool:
        """Whether images of a camera at rest agree with a speed of `update`; False if unknown."""
        return shows_rest and abs(speed[0]) <= _REST_MPS + 2 * speed[1]

    def _add(self, middle_s: float, speed_mps: float, sigma_mps: float) -> bool:
        """Use a measurement unless it is an outlier; whether it was used."""
        is_in_reach = self.reaches(middle_s, speed_mps, sigma_mps)
        if self._state is None:
            if is_in_reach:
                self._start(middle_s, speed_mps, sigma_mps)
            return is_in_reach
        innovation = np.array([speed_mps]) - self._state.x
        excess = float((innovation[0] ** 2 - self._state.P_xx[0]) / sigma_mps**2)
        largest = _MAX_SPREAD2 if is_in_reach else _MAX_REACH_SPREAD2
        own = (1 - _SPREAD_GAIN) * self._spread2
        self._spread2 = max(1.0, own + _SPREAD_GAIN * min(excess, largest))
        wide_mps = sigma_mps * math.sqrt(self._spread2)
        limit_mps = _OUTLIER_SIGMA * math.sqrt(self._state.P_xx[0] + wide_mps**2)
        if is_in_reach and abs(innovation[0]) <= limit_mps:
            state = self._state.update(innovation, np.array([wide_mps**2]))
            self._go_on(state, middle_s, self._n_measured + 1)
            return True
        self._n_outliers += 1
        is_start = is_in_reach and self._n_outliers >= _MAX_OUTLIERS
        if is_start:
            self._start(middle_s, speed_mps, wide_mps)
        return is_start

    def _start(self, middle_s: float, speed_mps: float, sigma_mps: float) -> None:
        values = (speed_mps, 0.0, sigma_mps**2, 0.0, _INITIAL_ACCELERATION_MPS2**2)
        self._go_on(ConstantVelocity(*(np.array([value]) for value in values)), middle_s, 1)

    def _go_on(self, state: ConstantVelocity, middle_s: float, n_measured: int) -> None:
        """Go on with a state that contains a measurement."""
        self._state, self._measured_s = state, middle_s
        self._known_mps, self._known_sigma_mps = float(state.x[0]), math.sqrt(float(state.P_xx[0]))
        self._n_outliers, self._n_measured = 0, n_measured
