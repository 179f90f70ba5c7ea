r"""GivenSpeed: a given speed of the camera beside the speed that the images show, moment by moment.

A given speed may be late, have another unit, or stay at zero; odometry may have another scale.
Their ratio and the delay belong to the drive (`SpeedRelation`): the given speed is read at all
likely delays, and its variance contains their spread. With the ratio removed, the difference D of
the two over the last moment, and its standard deviation S if both are right,

    P(given is wrong) = pi N(D; 0, S^2 + W^2) / ((1 - pi) N(D; 0, S^2) + pi N(D; 0, S^2 + W^2))

W is the size of mistakes. The speed is the mean over both cases, that of the images if the given
one is wrong, and its variance contains their difference: there is no threshold at which one
replaces the other. A ratio that the scale of odometry does not explain widens the variance only,
since either speed may be the cause.
"""

import math
from collections import deque
from dataclasses import replace

import numpy as np

from track_range.foundation.arrays import FloatArray
from track_range.foundation.errors import Note
from track_range.stereo.odometry.ego_motion import EgoMotion
from track_range.stereo.speed.ego_speed import EgoSpeed
from track_range.stereo.speed.speed_relation import LAGS_S, RelationFit, SpeedRelation

PRIOR = 0.1  # pi: probability of a mistake; receivers lag when a car brakes
LAG_SIGMA_S = 0.3  # of the delay of a speed without a stated one
_LATE_S = 0.7, 1.2  # mean and standard deviation of a delay that is a mistake
# W: a part for failures, and one for units; the same of the logarithm of a ratio
_MISTAKE_MPS, _MISTAKE_FRACTION, _MISTAKE_RATIO = 1.0, 0.3, 0.5
_WINDOW_S, _MEMORY_S = 0.5, 5.0  # differences of a moment; until they say nothing any more
_MIN_VALUES = 3
# standard deviations of the speed that images showed a moment ago, and the smallest one
_UNMEASURED_MPS, _LEAST_SIGMA_MPS = 0.5, 0.03
_INTERVAL_S = 0.5  # between two fits
_REST_MPS, _MOVING_MPS = 1.0, 3.0  # given speed at rest; speed in the images of one that is not
# in a note: least time of contradictions, smallest delay, and its probability
_MIN_REST_S, _NOTED_LAG_S, _P_NOTED = 1.0, 0.4, 0.9


class GivenSpeed:
    """Weighs the given speed of one drive against the measured one; the state belongs to the
    instance.
    """

    def __init__(self) -> None:
        self._samples, self._due_s = SpeedRelation(), -math.inf
        # logarithm of given over measured speed and its standard deviation, whatever the scales;
        # None = unknown
        self.shown_ratio: tuple[float, float] | None = None
        self._lag_weight = _lag_prior(LAG_SIGMA_S)  # (G,)
        self._has_table = False
        self._ratio = 0.0, 0.0  # logarithm of given over measured speed, and its variance
        self._differences: deque[tuple[float, float]] = deque()  # time, given - measured
        self._last_s = math.nan
        self._moving_s = self._rest_s = 0.0  # in motion, and in motion with a given speed at rest

    def update(
        self,
        time_s: float,
        given: EgoMotion,
        measured: EgoMotion,
        scale: tuple[float, float],
        *,
        table: EgoSpeed | None = None,
    ) -> EgoMotion:
        """The speed of a frame by both.

        `scale` is what the logarithm of their ratio, given over measured, should be, and its
        standard deviation; `table` has the given speed over the whole drive, None = it is known up
        to this frame.
        """
        step_s, self._last_s = time_s - self._last_s, time_s
        if math.isnan(given.speed_mps):
            return given if self.shown_ratio is None else self._by_images(measured)
        self._samples.add(time_s, given, measured)
        if time_s >= self._due_s or self.shown_ratio is None:
            self._due_s = time_s + _INTERVAL_S
            self._fit(scale, table)
        read = self._read(time_s, given, table)
        self._count_rest(step_s, given, measured)
        return self._with_scale(self._weighed(time_s, read, self._by_images(measured)), scale)

    def _by_images(self, measured: EgoMotion) -> EgoMotion:
        """The measured speed in the scale of the given one."""
        log_ratio, ratio_variance = self._ratio
        factor = math.exp(log_ratio)
        sigma_mps = math.hypot(
            measured.speed_sigma_mps, math.sqrt(ratio_variance) * measured.speed_mps
        )
        return EgoMotion(factor * measured.speed_mps, factor * sigma_mps)

    def _fit(self, scale: tuple[float, float], table: EgoSpeed | None) -> None:
        """Ratio and delay by all frames so far."""
        self._has_table = table is not None
        prior = _lag_prior(LAG_SIGMA_S if table is None else table.time_sigma_s or LAG_SIGMA_S)
        self._ratio, relation = (scale[0], scale[1] ** 2), self._samples.fit()
        if relation is None:
            return
        mean, covariance = relation.moments(relation.weights(prior))
        self.shown_ratio = float(mean[0]), math.sqrt(covariance[0, 0])
        self._lag_weight = relation.weights(prior * _ratio_prior(relation, scale))
        mean, covariance = relation.moments(self._lag_weight)
        self._ratio = float(mean[0]), float(covariance[0, 0])

    def _read(self, time_s: float, given: EgoMotion, table: EgoSpeed | None) -> EgoMotion:
        """The given speed with the spread over its likely delays."""
        if table is None:
            return given
        speeds_mps = table.near(time_s + LAGS_S)
        mean_mps = float(self._lag_weight @ speeds_mps)
        variance = float(self._lag_weight @ (speeds_mps - mean_mps) ** 2)
        sigma_mps = math.hypot(given.speed_sigma_mps, math.sqrt(variance))
        return replace(given, speed_mps=mean_mps, speed_sigma_mps=sigma_mps)

    def _weighed(self, time_s: float, read: EgoMotion, by_images: EgoMotion) -> EgoMotion:
        """The mean of both speeds of a moment, in the scale of the given one."""
        difference_mps = self._difference_mps(time_s, read, by_images)
        if difference_mps is None:
            return read
        other = self._other(read, by_images, difference_mps)
        both_mps = math.hypot(read.speed_sigma_mps, other.speed_sigma_mps)
        shown_mps = read.speed_mps - difference_mps
        mistake_mps = math.hypot(_MISTAKE_MPS, _MISTAKE_FRACTION * shown_mps)
        wrong = p_mistake(difference_mps, both_mps, mistake_mps)
        if self.shown_ratio is None and read.speed_mps >= _REST_MPS:
            # the scale of either may be wrong
            error_mps = math.sqrt(wrong / 2) * difference_mps
            return replace(read, speed_sigma_mps=math.hypot(read.speed_sigma_mps, error_mps))
        right = _both(read, other) if math.isfinite(by_images.speed_mps) else read
        return _mean(right, other, wrong)

    def _difference_mps(self, time_s: float, read: EgoMotion, by_images: EgoMotion) -> float | None:
        """Given minus measured speed in the last measured moment; None = too few values."""
        if math.isfinite(by_images.speed_mps):
            self._differences.append((time_s, read.speed_mps - by_images.speed_mps))
        while self._differences and self._differences[0][0] < time_s - _MEMORY_S:
            self._differences.popleft()
        if not self._differences:
            return None
        start_s = self._differences[-1][0] - _WINDOW_S
        of_moment = [value for at_s, value in self._differences if at_s >= start_s]
        return float(np.median(of_moment)) if len(of_moment) >= _MIN_VALUES else None

    def _other(self, read: EgoMotion, by_images: EgoMotion, difference_mps: float) -> EgoMotion:
        """The speed of the images; without one in this frame, as they showed it a moment ago."""
        speed_mps = read.speed_mps - difference_mps
        sigma_mps = math.hypot(_UNMEASURED_MPS, math.sqrt(self._ratio[1]) * speed_mps)
        if math.isfinite(by_images.speed_sigma_mps):
            sigma_mps = max(by_images.speed_sigma_mps, _LEAST_SIGMA_MPS)
        if math.isfinite(by_images.speed_mps):
            speed_mps = by_images.speed_mps
        return EgoMotion(speed_mps, sigma_mps)

    def _with_scale(self, motion: EgoMotion, scale: tuple[float, float]) -> EgoMotion:
        """The speed with an error that covers both scales, if they contradict each other."""
        log_ratio, variance = self._ratio[0] - scale[0], self._ratio[1]
        both = math.hypot(scale[1], math.sqrt(variance))
        # what the ratio adds to the prior of a mistake, which is of either speed
        added = p_mistake(log_ratio, both, _MISTAKE_RATIO) - p_mistake(0.0, both, _MISTAKE_RATIO)
        wrong = added / 2
        other_mps = motion.speed_mps * (1 - math.exp(-log_ratio))
        sigma_mps = math.hypot(motion.speed_sigma_mps, math.sqrt(wrong) * other_mps)
        return replace(motion, speed_sigma_mps=sigma_mps)

    def _count_rest(self, step_s: float, given: EgoMotion, measured: EgoMotion) -> None:
        if measured.speed_mps >= _MOVING_MPS and 0 < step_s <= _MEMORY_S:
            self._moving_s += step_s
            self._rest_s += step_s * (abs(given.speed_mps) < _REST_MPS)

    @property
    def lag_s(self) -> tuple[float, float]:
        """Delay of the given speed, and its standard deviation."""
        mean_s = float(self._lag_weight @ LAGS_S)
        return mean_s, math.sqrt(self._lag_weight @ (LAGS_S - mean_s) ** 2)

    @property
    def notes(self) -> tuple[str, ...]:
        """Messages for the user on a given speed that is late, or at rest while the images move."""
        notes = []
        lag_s, sigma_s = self.lag_s
        p_delayed = self._lag_weight[np.abs(LAGS_S) >= _NOTED_LAG_S].sum()
        if p_delayed >= _P_NOTED:
            side = "late" if lag_s > 0 else "early"
            effect = "it is read at this delay" if self._has_table else "the images correct it"
            notes.append(
                Note(
                    f"The given speed is {abs(lag_s):.1f} ± {sigma_s:.1f} s {side}, as the changes of "
                    f"the speed in the images show: {effect}; check the times of its source.",
                    "speed-delayed",
                    "warning",
                    "speed",
                )
            )
        if self._rest_s >= _MIN_REST_S:
            notes.append(
                Note(
                    f"The given speed is below {_REST_MPS:g} m/s during {self._rest_s:.1f} of the "
                    f"{self._moving_s:.1f} s in which the images show that the camera moves: the "
                    "speed of the images is used there; check the source of the speed.",
                    "speed-lost",
                    "warning",
                    "speed",
                )
            )
        return tuple(notes)


def _both(given: EgoMotion, other: EgoMotion) -> EgoMotion:
    """The mean of two speeds that are both right, by their information."""
    given_variance, other_variance = given.speed_sigma_mps**2, other.speed_sigma_mps**2
    gain = given_variance / (given_variance + other_variance)
    speed_mps = given.speed_mps + gain * (other.speed_mps - given.speed_mps)
    sigma_mps = math.sqrt((1 - gain) * given_variance)
    return replace(given, speed_mps=speed_mps, speed_sigma_mps=sigma_mps)


def _mean(right: EgoMotion, other: EgoMotion, wrong: float) -> EgoMotion:
    """The mixture of the speed if the given one is right, and the other with the probability
    `wrong`.
    """
    difference_mps = other.speed_mps - right.speed_mps
    within = (1 - wrong) * right.speed_sigma_mps**2 + wrong * other.speed_sigma_mps**2
    variance = within + wrong * (1 - wrong) * difference_mps**2
    speed_mps = right.speed_mps + wrong * difference_mps
    return replace(right, speed_mps=speed_mps, speed_sigma_mps=math.sqrt(variance))


def p_mistake(difference: float, sigma: float, mistake_sigma: float) -> float:
    """Probability that a difference is a mistake, of a size `mistake_sigma`, and not an error of
    `sigma`.
    """
    sigma = max(sigma, 1e-6)
    wide = math.hypot(sigma, mistake_sigma)
    log_odds = 0.5 * difference**2 * (1 / sigma**2 - 1 / wide**2)
    log_odds += math.log(sigma / wide) + math.log(PRIOR / (1 - PRIOR))
    return 1 / (1 + math.exp(-min(log_odds, 50.0)))


def _lag_prior(sigma_s: float) -> FloatArray:
    """(G,) probabilities of the delays `LAGS_S`: usual ones with a standard deviation, or a
    mistake.
    """
    usual, late = _normal(LAGS_S, 0.0, sigma_s), _normal(LAGS_S, *_LATE_S)
    prior = (1 - PRIOR) * usual / usual.sum() + PRIOR * late / late.sum()
    return np.asarray(prior)


def _ratio_prior(relation: RelationFit, scale: tuple[float, float]) -> FloatArray:
    """(G,) density of the ratio of each delay: scales that are right, or a mistake."""
    sigma = np.sqrt(relation.log_ratio_variance + scale[1] ** 2)
    right = _normal(relation.log_ratio, scale[0], sigma)
    return (1 - PRIOR) * right + PRIOR * _normal(relation.log_ratio, scale[0], _MISTAKE_RATIO)


def _normal(x: FloatArray, mean: float, sigma: FloatArray | float) -> FloatArray:
    return np.asarray(np.exp(-0.5 * ((x - mean) / sigma) ** 2) / sigma)
