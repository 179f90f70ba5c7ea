r"""ChangeFilter: how far some values moved since the start of a drive, from repeated measurements.

    state of each value     x: change since the first frame, b: value of the first frame,
                            c: error that lasts for about a second
    measured per frame      value = x + b + c + noise,  step = change of x in this frame + noise

Three motions compete in each frame, as in an interacting multiple model filter (Blom and Bar-Shalom
1988): a firm mount, a loose one, and a hit. The result is their mixture: a change that one frame
shows clearly counts at once, a slow one as soon as it is more likely than the noise, and until then
its possibility is part of the standard deviation.
"""

import math
from typing import NamedTuple

import numpy as np

from track_range.foundation.arrays import FloatArray

# random walks of a firm and of a loose mount, px per root of a second; size of a hit, px
_FIRM, _LOOSE, _HIT_PX = 0.005, 0.4, 5.0
# probability of each motion (column) in the frame after each motion (row)
_NEXT = np.array(
    [[1 - 1.1e-3, 1e-3, 1e-4], [0.01, 0.989, 1e-3], [0.7, 0.29, 0.01]],
)
_IS_HIT = np.array([False, False, True])  # which motion is a hit
_H = np.ones(3)  # a value is x + b + c
_LASTING_S = 1.0  # time constant of lasting errors
_MIN_STEP_SIGMAS = 4.0  # of a step that noise does not explain
_UNKNOWN = 1e12  # variance of a value that was not measured
_FIRST_SIGMA_PX = 3.0  # standard deviation of the value of the first frame


class Changes(NamedTuple):
    """Changes of K values since the start."""

    mean: FloatArray  # (K,)
    sigma: FloatArray  # (K,) standard deviations
    hit: FloatArray  # (K,) probability of a hit in the last frame


class ChangeFilter:
    """Filters K independent values in px, whose errors that last have the standard deviations (K,);
    the state belongs to the instance.
    """

    def __init__(self, lasting_sigma: FloatArray) -> None:
        # K values, 3 motions, state (x, b, c)
        n_values, self._lasting_variance = len(lasting_sigma), lasting_sigma[:, None] ** 2
        self._mean = np.zeros((n_values, 3, 3))
        self._covariance = np.zeros((n_values, 3, 3, 3))
        self._covariance[:, :, 1, 1] = _FIRST_SIGMA_PX**2
        self._covariance[:, :, 2, 2] = self._lasting_variance
        self._weight = np.tile([1.0, 0.0, 0.0], (n_values, 1))

    def advance(self, dt_s: float, step: FloatArray, step_sigma: FloatArray) -> None:
        """Go on to the next frame, in which the values changed by steps (K,) with their standard
        deviations; NaN = not measured.
        """
        predicted = self._mixed()
        variance = np.array([_FIRM**2 * dt_s, _LOOSE**2 * dt_s, _HIT_PX**2])[None, :]
        # The change in this frame, from its prior by the motion and from the step; small steps
        # follow from an error of the change, too, and only tell that there was no hit.
        has_step = np.isfinite(step)[:, None]
        known = np.where(has_step, step[:, None], 0.0)
        step_variance = np.where(has_step, step_sigma[:, None] ** 2, _UNKNOWN)
        is_small = known**2 < _MIN_STEP_SIGMAS**2 * step_variance
        is_told = has_step & (~is_small | _IS_HIT)
        noise = np.where(is_told, step_variance, _UNKNOWN)
        gain = variance / (variance + noise)
        self._mean[:, :, 0] += gain * known
        self._covariance[:, :, 0, 0] += gain * noise
        self._weight = predicted
        spread = np.where(is_told, variance + noise, _MIN_STEP_SIGMAS * step_variance)
        self._weigh(np.where(has_step, _log_normal(known, spread), 0.0))
        # the error that lasts
        kept = math.exp(-dt_s / _LASTING_S)
        self._mean[:, :, 2] *= kept
        self._covariance[:, :, 2] *= kept
        self._covariance[:, :, :, 2] *= kept
        self._covariance[:, :, 2, 2] += (1 - kept**2) * self._lasting_variance

    def measure(self, value: FloatArray, sigma: FloatArray) -> None:
        """Use values (K,) of the frame with their standard deviations; NaN = not measured."""
        has_value = np.isfinite(value)[:, None]
        noise = np.where(has_value, sigma[:, None] ** 2, _UNKNOWN)
        projected = self._covariance @ _H  # (K, 3, 3) P H'
        S = projected @ _H + noise
        innovation = np.where(has_value, value[:, None] - self._mean @ _H, 0.0)
        gain = projected / S[:, :, None]
        self._mean += gain * innovation[:, :, None]
        self._covariance -= gain[:, :, :, None] * projected[:, :, None, :]
        self._weigh(np.where(has_value, _log_normal(innovation, S), 0.0))

    def _weigh(self, log_likelihood: FloatArray) -> None:
        """Weigh the motions by the likelihoods (K, 3)."""
        log_weight = np.log(np.maximum(self._weight, 1e-300)) + log_likelihood
        weight = np.exp(log_weight - log_weight.max(axis=1, keepdims=True))
        self._weight = weight / weight.sum(axis=1, keepdims=True)

    @property
    def changes(self) -> Changes:
        """The changes so far."""
        mean = (self._weight * self._mean[:, :, 0]).sum(axis=1)
        spread = self._covariance[:, :, 0, 0] + (self._mean[:, :, 0] - mean[:, None]) ** 2
        sigma = np.sqrt((self._weight * spread).sum(axis=1))
        return Changes(mean, sigma, self._weight[:, 2])

    @property
    def expected(self) -> FloatArray:
        """(K,) values that the next frame is expected to show, without its lasting errors."""
        return np.asarray((self._weight * self._mean[:, :, :2].sum(axis=2)).sum(axis=1))

    def rebase(self, change: FloatArray) -> None:
        """Count the changes (K,) from then on as known and corrected elsewhere."""
        self._mean[:, :, 0] -= change[:, None]

    def _mixed(self) -> FloatArray:
        """Mix the states by the probabilities of the motions, which are returned: (K, 3)."""
        predicted = self._weight @ _NEXT
        joint = self._weight[:, None, :] * _NEXT.T  # (K, to, from)
        share = joint / np.maximum(predicted, 1e-300)[:, :, None]
        # means of the states, and of their squares
        square = self._covariance + _squared(self._mean)
        n_values = len(square)
        self._mean = share @ self._mean
        mean_square = (share @ square.reshape(n_values, 3, 9)).reshape(n_values, 3, 3, 3)
        self._covariance = mean_square - _squared(self._mean)
        return np.asarray(predicted)


def _squared(mean: FloatArray) -> FloatArray:
    """(K, 3, 3, 3) outer products of states (K, 3, 3) with themselves."""
    return np.asarray(mean[:, :, :, None] * mean[:, :, None, :])


def _log_normal(value: FloatArray, variance: FloatArray) -> FloatArray:
    return np.asarray(-0.5 * (value**2 / variance + np.log(2 * math.pi * variance)))
