"""MeasuredDistances: distances of a frame with their noise; NoiseScale: the noise of each method, as its
filters see it.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np

from track_range.foundation.arrays import BoolArray, FloatArray
from track_range.ranging.measurement.ranges import Ranges

# of sigma; a method that declares less is filtered with this fraction
_MIN_INDEPENDENT_FRACTION = 0.1
# measurements: weight of the declared noise, and half-life of lambda
_PRIOR_SAMPLES, _MEMORY_SAMPLES = 30.0, 300.0
# smallest and largest lambda: a fifth to four times the declared standard deviation
_LIMITS = (0.2**2, 4.0**2)
_MAX_RATIO = 9.0  # largest nu^2 / S; innovations beyond 3 sigma are outliers


@dataclass(frozen=True, slots=True)
class MeasuredDistances:
    """Distances of N tracks by M methods in one frame, (M, 1, N) each; NaN = not measured."""

    distance_m: FloatArray  # z
    # variance of log z that is independent from frame to frame, with lambda
    independent: FloatArray
    systematic: FloatArray  # variance of log z that is constant over a track
    valid: BoolArray  # whether the track is measured

    @classmethod
    def of(
        cls, by_method: Mapping[str, Ranges], fractions: Mapping[str, float], factor: FloatArray
    ) -> MeasuredDistances:
        """The distances of those methods that have an independent fraction of the variance.

        `fractions` apply to `Ranges` without a systematic part per box; `factor` (M, 1) is lambda.
        """
        unmeasured = np.full(len(next(iter(by_method.values()))), np.nan)
        columns = [_columns(by_method.get(name), unmeasured) for name in fractions]
        distance_m, sigma_m, systematic_m = np.array(columns).swapaxes(0, 1)
        declared = np.array([[fraction] for fraction in fractions.values()])
        given = systematic_m / sigma_m
        least = _MIN_INDEPENDENT_FRACTION**2
        fraction = np.where(np.isnan(given), declared, np.maximum(1.0 - given * given, least))
        valid = (distance_m > 0) & (distance_m < np.inf) & (sigma_m > 0)
        distance_m = np.where(valid, distance_m, np.nan)
        relative = sigma_m / distance_m
        variance = relative * relative
        # If the noise is smaller than declared, the remainder of sigma counts as systematic.
        systematic = (1 - fraction * np.minimum(factor, 1.0)) * variance
        return cls(
            distance_m=distance_m[:, None],
            independent=(fraction * factor * variance)[:, None],
            systematic=systematic[:, None],
            valid=valid[:, None],
        )


def _columns(ranges: Ranges | None, unmeasured: FloatArray) -> tuple[FloatArray, ...]:
    """Distances, their sigmas and the systematic parts of these, (N,) each; NaN = none."""
    if ranges is None:
        return unmeasured, unmeasured, unmeasured
    systematic_m = ranges.sigma_systematic_m
    given_m = unmeasured if systematic_m is None else systematic_m
    return ranges.distance_m, ranges.sigma_m, given_m


class NoiseScale:
    """Factors lambda on the noise variances of M methods, estimated separately from the innovations
    of their filters.

        nu = z - z_predicted,   E nu^2 = S = P + lambda R   ->   lambda' = lambda * (mean of nu^2 / S with weights w)
        w = lambda R / S

    P is the variance of the prediction, R the variance of the noise that the method declares. The
    ratio nu^2 / S depends on R where R is a large part of S, and on the motion elsewhere, hence the
    weights w. The jitter of boxes differs between detectors, from half a pixel to two, and
    detectors do not report it; a single number for all tracks of a method converges fast.
    (Covariance matching, Mehra 1972.)
    """

    def __init__(self, n_methods: int = 1) -> None:
        """Start with factors of 1."""
        self.factor = np.ones((n_methods, 1))  # (M, 1) lambda
        self._ratios, self._weights = np.full((2, n_methods, 1), _PRIOR_SAMPLES)

    def learn(
        self, squared: FloatArray, predicted: FloatArray, *, noise: FloatArray, use: BoolArray
    ) -> None:
        """Update the factors with the innovations of one frame where `use`: nu^2, P and lambda R,
        (M, N) each.
        """
        S = predicted + noise
        w = np.where(use, noise / S, 0.0)
        ratio = np.where(use, squared / S, 0.0)
        sums = np.add.reduce(np.array([w * np.minimum(ratio, _MAX_RATIO), w, use]), axis=2)
        ratios, weights, n_used = sums[..., None]
        decay = 0.5 ** (n_used / _MEMORY_SAMPLES)
        self._ratios = self._ratios * decay + self.factor * ratios
        self._weights = self._weights * decay + weights
        least, largest = _LIMITS
        self.factor = np.minimum(np.maximum(self._ratios / self._weights, least), largest)
