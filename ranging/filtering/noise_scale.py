"""Scale of each method's noise, learnt from how far its measurements are from their predictions.

    nu = z - z_predicted,   E nu^2 = S = P + lambda R   ->   lambda' = lambda weighted mean of nu^2 / S

P is the variance of the prediction, R the variance of the noise that the method declares. Where R is a large part of S
the ratio depends on R, elsewhere on the motion: that part is the weight. The boxes of one detector jump by half a
pixel, those of another by two, and no detector reports which; one number for all tracks of a method is soon known.
(Covariance matching, Mehra 1972.)
"""

from __future__ import annotations

import numpy as np

from track_range.foundation.arrays import BoolArray, FloatArray

_PRIOR_SAMPLES = 30.0
"""Weight of the declared noise, in measurements."""

_MEMORY_SAMPLES = 300.0
"""Half-life of what has been learnt, in measurements."""

_LIMITS = (0.2**2, 4.0**2)
"""Least and largest factor."""

_LARGEST = 9.0
"""Squared innovations beyond 3 sigma are outliers, not noise."""


class NoiseScale:
    """Factors lambda on the methods' noise variances, each learnt alone.

    Attributes:
        factor: (M, 1) lambda, 1 at first.
    """

    def __init__(self, n_methods: int = 1) -> None:
        """Start with factors of 1."""
        self.factor = np.ones((n_methods, 1))
        self._ratios, self._weights = np.full((2, n_methods, 1), _PRIOR_SAMPLES)

    def learn(self, squared: FloatArray, predicted: FloatArray, *, noise: FloatArray, use: BoolArray) -> None:
        """Update the factors with the innovations of one frame.

        Args:
            squared: (M, N) squared innovations.
            predicted: (M, N) variance of the predictions.
            noise: (M, N) declared variance of the noise, times `factor`.
            use: (M, N) which innovations count.
        """
        total = predicted + noise
        weight = np.where(use, noise / total, 0.0)
        ratio = np.where(use, squared / total, 0.0)
        fades = 0.5 ** (use.sum(axis=1, keepdims=True) / _MEMORY_SAMPLES)
        ratios = (weight * np.minimum(ratio, _LARGEST)).sum(axis=1, keepdims=True)
        self._ratios = self._ratios * fades + self.factor * ratios
        self._weights = self._weights * fades + weight.sum(axis=1, keepdims=True)
        self.factor = (self._ratios / self._weights).clip(*_LIMITS)
