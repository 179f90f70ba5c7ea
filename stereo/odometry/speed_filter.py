r"""SpeedFilter: Kalman filter of the camera's speed, from the mean speeds between consecutive
frames.

    x = [V, a]'    V, a: speed and acceleration at the middle of the interval between two frames

Drivers accelerate and brake for about a time T, by about s (Singer, 1970): with e = exp(-dt / T),

    predict    V' = V + T (1 - e) a     a' = e a     P' = F P F' + Q
               Q = s^2 [[T^2 (2 dt / T - 3 + 4 e - e^2), T (1 - e)^2], [., 1 - e^2]]

A mean speed over dt is the speed dt / 2 ago, so the result is predicted by dt / 2. The sigma of a
measurement has an independent part, which averages out, and a systematic one, which is added at the
output. Of measurements with another systematic sigma, of another source, the difference is an error
of the larger one against the other.

An innovation that is no motion of a car is that of something else: the speed is predicted, soon
unknown, and its sigma grows until the filter expects such a speed. A first speed that more
measurements contradict than agree with was wrong itself, and the filter starts again.
"""

import math
from collections import deque
from typing import NamedTuple

from track_range.stereo.odometry.ego_motion import PREDICTED_NOISE

# T, and s with which a predicted speed is as uncertain as anywhere else; three s are hard braking.
# KITTI's drivers have 0.8 m/s^2 and 2 s, but do not brake fully.
_ACCELERATION_S = 0.5
_ACCELERATION_MPS2 = PREDICTED_NOISE / math.sqrt(2 * _ACCELERATION_S)
_INITIAL_ACCELERATION_MPS2 = 3.0  # standard deviation of the acceleration at the start
# Longest time without a measurement for which a speed is predicted: filters of distances and
# warnings go on with it. It is unknown after it.
MAX_PREDICTED_S = 1.0
# innovations beyond this number of standard deviations are not of the car, and after one, or after
# an unknown speed, when something else may show
_OUTLIER_SIGMA, _OTHER_SIGMA = 3.0, 2.0
_BRAKING_MPS2, _ONSET_S = 10.0, 0.1  # full braking on a dry road, and the time in which it begins
# distance between two frames from which a first speed is not used until a second one agrees
_LARGE_STEP_M = 4.0
# weight of one measurement in the spread of the measurements, largest spread of one, and that of an
# outlier
_SPREAD_GAIN, _MAX_SPREAD2, _OUTLIER_SPREAD2 = 0.15, 400.0, 4.0
_N_SURE = 3  # number of measurements that agree after which a speed is not given up for others
_REST_MPS = 0.3  # largest speed of a camera that images show at rest


class _State(NamedTuple):
    """Speed V and acceleration a at a time, and their covariance P; plain numbers, since arrays of
    two take twenty times as long.
    """

    time_s: float
    speed_mps: float
    acceleration_mps2: float
    P_VV: float
    P_Va: float
    P_aa: float

    def predicted(self, time_s: float) -> "_State":
        """The state at a later time: F = [[1, T (1 - e)], [0, e]]."""
        s2, T = _ACCELERATION_MPS2**2, _ACCELERATION_S
        dt_s = time_s - self.time_s
        e = math.exp(-dt_s / T)
        b = T * (1 - e)
        Q_VV, Q_Va, Q_aa = T**2 * (2 * dt_s / T - 3 + 4 * e - e**2), T * (1 - e) ** 2, 1 - e**2
        return _State(
            time_s,
            self.speed_mps + b * self.acceleration_mps2,
            e * self.acceleration_mps2,
            self.P_VV + 2 * b * self.P_Va + b**2 * self.P_aa + s2 * Q_VV,
            e * (self.P_Va + b * self.P_aa) + s2 * Q_Va,
            e**2 * self.P_aa + s2 * Q_aa,
        )

    def updated(self, speed_mps: float, variance: float) -> "_State":
        """The state after a measurement of the speed."""
        gain_V, gain_a = self.P_VV / (self.P_VV + variance), self.P_Va / (self.P_VV + variance)
        innovation_mps = speed_mps - self.speed_mps
        return _State(
            self.time_s,
            self.speed_mps + gain_V * innovation_mps,
            self.acceleration_mps2 + gain_a * innovation_mps,
            self.P_VV - gain_V * self.P_VV,
            self.P_Va - gain_V * self.P_Va,
            self.P_aa - gain_a * self.P_Va,
        )

    @property
    def sigma_mps(self) -> float:
        """Standard deviation of the speed."""
        return math.sqrt(self.P_VV)


class SpeedFilter:
    """Filters the speeds of one stream; the state belongs to the instance."""

    def __init__(self) -> None:
        self._state: _State | None = None
        self._measured_s = -math.inf  # middle of the last measurement that was used
        # measurements since the start that agree; outliers since the last one of these
        self._n_agreed = self._n_outliers = 0
        # the last two of them: middle, speed and sigma
        self._latest: deque[tuple[float, float, float]] = deque()
        self._systematic_mps = math.nan  # error of the speed that is the same in all frames
        # ratio of the variance of the measurements to the expected one, at least 1
        self._spread2 = 1.0
        # the part of the last standard deviation that is new in each frame
        self.noise_mps = 0.0
        self.is_measured = False  # whether a measurement of the last frame was used

    def update(
        self, time_s: float, dt_s: float, speed_mps: float, sigma_mps: float, systematic_mps: float
    ) -> tuple[float, float]:
        """Speed at `time_s` and its standard deviation, NaN = unknown.

        `speed_mps` is the mean speed over `dt_s`, NaN = not measured; `sigma_mps` its independent
        standard deviation, `systematic_mps` is the sigma of an error that is the same in all
        frames.
        """
        middle_s = time_s - dt_s / 2
        if self._state is not None:
            self._state = self._state.predicted(max(middle_s, self._state.time_s))
        self.is_measured = math.isfinite(speed_mps) and self._add(
            middle_s, speed_mps, sigma_mps, systematic_mps
        )
        if self.is_measured:
            self._measured_s = middle_s
        return self.at(time_s, dt_s)

    def at(self, time_s: float, dt_s: float) -> tuple[float, float]:
        """Speed at `time_s` and its standard deviation by the measurements so far, NaN = unknown;
        the last frame was `dt_s` before.
        """
        middle_s = time_s - dt_s / 2
        if self._state is None or middle_s - self._measured_s > MAX_PREDICTED_S:
            return math.nan, math.nan
        if self._n_agreed < 2 and abs(self._state.speed_mps * dt_s) > _LARGE_STEP_M:
            return math.nan, math.nan
        now = self._state.predicted(time_s)
        self.noise_mps = now.sigma_mps
        return now.speed_mps, math.hypot(self.noise_mps, self._systematic_mps)

    def expects(
        self, middle_s: float, speed_mps: float, sigma_mps: float, systematic_mps: float
    ) -> bool:
        """Whether a speed at a time is one of the same car; True without an earlier one, False for
        NaN.
        """
        if self._state is None:
            return math.isfinite(speed_mps)
        state = self._state.predicted(max(middle_s, self._state.time_s))
        since_s = middle_s - self._measured_s
        is_followed = self._n_outliers == 0 and since_s <= MAX_PREDICTED_S
        n_sigma = _OUTLIER_SIGMA if is_followed else _OTHER_SIGMA
        # a driver may have started to brake at the last measurement
        braked_mps = _BRAKING_MPS2 * min(since_s, _ONSET_S)
        other_mps = math.sqrt(abs(systematic_mps**2 - self._systematic_mps**2))
        limit_mps = n_sigma * math.hypot(state.sigma_mps, sigma_mps, other_mps) + braked_mps
        return abs(speed_mps - state.speed_mps) <= limit_mps

    def is_rest(self, speed: tuple[float, float], *, shows_rest: bool) -> bool:
        """Whether images of a camera at rest agree with a speed of `update`; False if unknown."""
        return shows_rest and abs(speed[0]) <= _REST_MPS + 2 * speed[1]

    def _add(
        self, middle_s: float, speed_mps: float, sigma_mps: float, systematic_mps: float
    ) -> bool:
        """Use a measurement unless it is an outlier; whether it was used."""
        if self._state is None:
            self._start(middle_s, speed_mps, sigma_mps, systematic_mps)
            return True
        wide_mps = sigma_mps * math.sqrt(self._spread2)
        is_expected = self.expects(middle_s, speed_mps, wide_mps, systematic_mps)
        spread2 = _OUTLIER_SPREAD2
        if is_expected:
            spread2 = min(self._spread2_of(middle_s, speed_mps, sigma_mps), _MAX_SPREAD2)
        self._spread2 = max(1.0, (1 - _SPREAD_GAIN) * self._spread2 + _SPREAD_GAIN * spread2)
        wide_mps = sigma_mps * math.sqrt(self._spread2)
        if is_expected:
            self._update(self._state, speed_mps, wide_mps, systematic_mps)
            self._latest.append((middle_s, speed_mps, sigma_mps))
            self._n_agreed, self._n_outliers = self._n_agreed + 1, 0
            return True
        self._n_outliers += 1
        was_wrong = self._n_agreed < min(self._n_outliers, _N_SURE)
        if was_wrong:
            self._start(middle_s, speed_mps, wide_mps, systematic_mps)
        return was_wrong

    def _start(
        self, middle_s: float, speed_mps: float, sigma_mps: float, systematic_mps: float
    ) -> None:
        self._state = _State(
            middle_s, speed_mps, 0.0, sigma_mps**2, 0.0, _INITIAL_ACCELERATION_MPS2**2
        )
        self._systematic_mps = systematic_mps
        self._latest = deque([(middle_s, speed_mps, sigma_mps)], 2)
        self._n_agreed, self._n_outliers = 1, 0

    def _update(
        self, state: _State, speed_mps: float, sigma_mps: float, systematic_mps: float
    ) -> None:
        """Update the state, whose systematic error becomes that of the measurements."""
        other2 = systematic_mps**2 - self._systematic_mps**2
        wider = state._replace(P_VV=state.P_VV + max(-other2, 0.0))
        variance = sigma_mps**2 + max(other2, 0.0)
        gain = wider.P_VV / (wider.P_VV + variance)
        own_mps = min(self._systematic_mps, systematic_mps)
        self._systematic_mps = own_mps + gain * (systematic_mps - own_mps)
        self._state = wider.updated(speed_mps, variance)

    def _spread2_of(self, middle_s: float, speed_mps: float, sigma_mps: float) -> float:
        """Ratio of the variance of the measurements to the expected one, by the distance of the
        last one from the line through its neighbours, which a steady acceleration does not move;
        0 = unknown.
        """
        if len(self._latest) < 2:
            return 0.0
        (first_s, first_mps, first_sigma), (last_s, last_mps, last_sigma) = self._latest
        weight = (last_s - first_s) / max(middle_s - first_s, 1e-6)
        between_mps = (1 - weight) * first_mps + weight * speed_mps
        sigma = math.hypot(last_sigma, (1 - weight) * first_sigma, weight * sigma_mps)
        return ((last_mps - between_mps) / sigma) ** 2
