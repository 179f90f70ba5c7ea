r"""SpeedRelation: ratio and delay of a given speed against the speed that the images show.

    v(t) = e^s m(t - tau) + noise        v: given, m: measured; s: log ratio, tau: how late v is

For each tau of a grid, s is a weighted least-squares fit; residuals beyond 3 sigma count less.
Before the first measurement, m is its first value with an uncertainty that grows with the time, so
that all tau are compared on all samples. Errors are correlated over a second. A delay shows only
while the speed changes; otherwise all are equally likely.
"""

from collections import deque
from dataclasses import dataclass

import numpy as np

from track_range.foundation.arrays import FloatArray
from track_range.stereo.odometry.ego_motion import EgoMotion

LAGS_S: FloatArray = np.arange(-1.5, 3.01, 0.1)  # (G,) given speeds are rather late than early
_CORRELATED_S = 1.0  # time over which errors of both speeds are correlated
_SPAN_S, _STEP_S = 30.0, 0.095  # latest samples that are used, and the time between two of them
_UNKNOWN_MPS2 = 1.0  # usual acceleration before the first measurement
_NOISE_FRACTION = 0.02  # of both speeds, by roads that are not plane and slopes of axes
_MIN_MPS = 1.0  # smallest speeds that are compared: a receiver at rest may show anything
_MIN_S, _MAX_STEP_S, _MIN_SAMPLES = 0.75, 0.2, 3  # time of all samples, and largest one of each
_OUTLIER_SIGMA, _N_ROUNDS = 3.0, 3
_MIN_VARIANCE = 1e-6


@dataclass(frozen=True, slots=True)
class RelationFit:
    """The relation by delay, (G,) each: without priors of ratio and delay."""

    log_likelihood: FloatArray  # of the delays `LAGS_S`
    log_ratio: FloatArray  # s, given over measured
    log_ratio_variance: FloatArray

    def weights(self, prior: FloatArray) -> FloatArray:
        """(G,) probabilities of the delays with a prior (G,), which need not be normalised."""
        weight = prior * np.exp(self.log_likelihood - self.log_likelihood.max())
        return np.asarray(weight / weight.sum())

    def moments(self, weight: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Mean (2,) and covariance (2, 2) of s and tau with these probabilities (G,)."""
        mean = np.array([weight @ self.log_ratio, weight @ LAGS_S])
        deviation = np.array([self.log_ratio, LAGS_S]) - mean[:, None]
        covariance = (weight * deviation) @ deviation.T
        covariance[0, 0] += weight @ self.log_ratio_variance
        covariance[1, 1] += (LAGS_S[1] - LAGS_S[0]) ** 2 / 12
        return mean, np.asarray(covariance)


class SpeedRelation:
    """Compares the speeds of one drive; the state belongs to the instance."""

    def __init__(self) -> None:
        # time, given and measured speed, their variance
        self._samples: deque[tuple[float, float, float, float]] = deque()

    def add(self, time_s: float, given: EgoMotion, measured: EgoMotion) -> None:
        """Add a frame; frames with an unknown speed, or one near rest, say nothing."""
        is_early = bool(self._samples) and time_s - self._samples[-1][0] < _STEP_S
        # False for NaN
        is_moving = given.speed_mps >= _MIN_MPS and measured.speed_mps >= _MIN_MPS
        if is_early or not is_moving:
            return
        sigmas_mps = (
            given.speed_sigma_mps,
            measured.speed_sigma_mps,
            _NOISE_FRACTION * given.speed_mps,
        )
        variance = float(np.nansum(np.square(sigmas_mps)))
        self._samples.append((time_s, given.speed_mps, measured.speed_mps, variance))
        while self._samples[0][0] < time_s - _SPAN_S:
            self._samples.popleft()

    def fit(self) -> RelationFit | None:
        """The relation by all samples; None = too few."""
        if len(self._samples) < _MIN_SAMPLES:
            return None
        t, given, measured, known_variance = np.array(self._samples).T
        step_s = np.minimum(np.gradient(t), _MAX_STEP_S)
        if step_s.sum() < _MIN_S:
            return None
        at_s = t - LAGS_S[:, None]
        m = np.interp(at_s, t, measured)
        outside_s = np.maximum(t[0] - at_s, 0.0) + np.maximum(at_s - t[-1], 0.0)
        variance = known_variance + (_UNKNOWN_MPS2 * outside_s) ** 2
        share = step_s / _CORRELATED_S
        weight = share / variance
        for _ in range(_N_ROUNDS):
            information = (weight * m**2).sum(axis=1)
            ratio = np.maximum((weight * given * m).sum(axis=1) / information, 1e-3)
            chi2 = (given - ratio[:, None] * m) ** 2 / variance
            weight = share / variance / (1 + chi2 / _OUTLIER_SIGMA**2)
        cost = _OUTLIER_SIGMA**2 * np.log1p(chi2 / _OUTLIER_SIGMA**2) + np.log(variance)
        log_ratio_variance = 1 / np.maximum(information * ratio**2, _MIN_VARIANCE)
        log_likelihood = -0.5 * (share * cost).sum(axis=1) + 0.5 * np.log(log_ratio_variance)
        return RelationFit(log_likelihood, np.log(ratio), log_ratio_variance)
