"""How noisy methods really are from frame to frame, learnt from how far their measurements are from their predictions.

    nu = z - z_predicted,   E nu^2 = S = P + lambda R   ->   lambda' = lambda weighted mean of nu^2 / S

P is the prediction's variance, R what the method says of its own noise. Where R is a large part of S the ratio tells of
R, elsewhere of the motion: that part is the weight. The boxes of one detector jump by half a pixel, those of another by
two, and nobody tells which; one number for all tracks of a method is soon known. (Covariance matching, Mehra 1972.)
"""

from __future__ import annotations

import numpy as np

from track_range.foundation.arrays import BoolArray, FloatArray

_PRIOR_SAMPLES = 30.0
"""So many measurements count for the method's own word."""

_MEMORY_SAMPLES = 300.0
"""Older ones are forgotten."""

_LIMITS = (0.2**2, 4.0**2)
"""Nobody is taken to be surer, or less sure, than this share of what is said."""

_LARGEST = 9.0
"""Squared innovations beyond 3 sigma are outliers, not noise."""


class NoiseScale:
    """The factors on methods' variances, each learnt alone; 1 until measurements say otherwise.

    Attributes:
        factor: (M, 1).
    """

    def __init__(self, n_methods: int = 1) -> None:
        """Believe the methods."""
        self.factor = np.ones((n_methods, 1))
        self._ratios, self._weights = np.full((2, n_methods, 1), _PRIOR_SAMPLES)

    def learn(self, squared: FloatArray, predicted: FloatArray, *, noise: FloatArray, use: BoolArray) -> None:
        """Take in a frame: (M, N) squared innovations, the predictions' variances, the noise's (times `factor`)."""
        total = predicted + noise
        weight = np.where(use, noise / total, 0.0)
        ratio = np.where(use, squared / total, 0.0)
        fades = 0.5 ** (use.sum(axis=1, keepdims=True) / _MEMORY_SAMPLES)
        told = (weight * np.minimum(ratio, _LARGEST)).sum(axis=1, keepdims=True)
        self._ratios = self._ratios * fades + self.factor * told
        self._weights = self._weights * fades + weight.sum(axis=1, keepdims=True)
        self.factor = (self._ratios / self._weights).clip(*_LIMITS)
