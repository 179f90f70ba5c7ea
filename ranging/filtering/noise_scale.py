"""NoiseScale: scale of each method's measurement noise, estimated from the innovations of its filter.

    nu = z - z_predicted,   E nu^2 = S = P + lambda R   ->   lambda' = lambda * (mean of nu^2 / S with weights w)
    w = lambda R / S

P is the variance of the prediction, R the variance of the noise that the method declares. The ratio nu^2 / S depends on
R where R is a large part of S, and on the motion elsewhere, hence the weights w. The jitter of boxes differs between
detectors, from half a pixel to two, and detectors do not report it; a single number for all tracks of a method
converges fast. (Covariance matching, Mehra 1972.)
"""

from __future__ import annotations

import numpy as np

from track_range.foundation.arrays import BoolArray, FloatArray

_PRIOR_SAMPLES = 30.0
"""Weight of the declared noise, as a number of measurements."""

_MEMORY_SAMPLES = 300.0
"""Half-life of the estimate, as a number of measurements."""

_LIMITS = (0.2**2, 4.0**2)
"""Smallest and largest lambda: between a fifth and four times the declared standard deviation."""

_MAX_RATIO = 9.0
"""Largest nu^2 / S; innovations beyond 3 sigma are outliers."""


class NoiseScale:
    """Factors lambda on the noise variances of M methods, estimated separately.

    Attributes:
        factor: (M, 1) lambda, initially 1.
    """

    def __init__(self, n_methods: int = 1) -> None:
        """Start with factors of 1."""
        self.factor = np.ones((n_methods, 1))
        self._ratios, self._weights = np.full((2, n_methods, 1), _PRIOR_SAMPLES)

    def learn(self, squared: FloatArray, predicted: FloatArray, *, noise: FloatArray, use: BoolArray) -> None:
        """Update the factors with the innovations of one frame.

        Args:
            squared: (M, N) squared innovations nu^2.
            predicted: (M, N) variance P of the predictions.
            noise: (M, N) variance lambda R of the noise.
            use: (M, N) whether to use the innovation.
        """
        S = predicted + noise
        w = np.where(use, noise / S, 0.0)
        ratio = np.where(use, squared / S, 0.0)
        decay = 0.5 ** (use.sum(axis=1, keepdims=True) / _MEMORY_SAMPLES)
        ratios = (w * np.minimum(ratio, _MAX_RATIO)).sum(axis=1, keepdims=True)
        self._ratios = self._ratios * decay + self.factor * ratios
        self._weights = self._weights * decay + w.sum(axis=1, keepdims=True)
        self.factor = (self._ratios / self._weights).clip(*_LIMITS)
