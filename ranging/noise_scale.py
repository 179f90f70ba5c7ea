"""How noisy a method really is from frame to frame, learnt from how far its measurements are from their predictions.

    nu = z - z_predicted,   E nu^2 = S = P + lambda R   ->   lambda' = lambda weighted mean of nu^2 / S

P is the prediction's variance, R what the method says of its own noise. Where R is a large part of S the ratio tells of
R, elsewhere of the motion: that part is the weight. The boxes of one detector jump by half a pixel, those of another by
two, and nobody tells which; one number for all tracks of a method is soon known. (Covariance matching, Mehra 1972.)
"""

from __future__ import annotations

from detection.detections import BoolArray, FloatArray

_PRIOR_SAMPLES = 30.0
"""So many measurements count for the method's own word."""

_MEMORY_SAMPLES = 300.0
"""Older ones are forgotten."""

_LIMITS = (0.2**2, 4.0**2)
"""Nobody is taken to be surer, or less sure, than this share of what is said."""

_LARGEST = 9.0
"""Squared innovations beyond 3 sigma are outliers, not noise."""


class NoiseScale:
    """The factor on a method's variance; 1 until measurements say otherwise."""

    def __init__(self) -> None:
        """Believe the method."""
        self.factor = 1.0
        self._ratios = self._weights = _PRIOR_SAMPLES

    def learn(self, squared: FloatArray, predicted: FloatArray, *, noise: FloatArray, use: BoolArray) -> None:
        """Take in a frame: (N,) squared innovations, the predictions' variances, the noise's (times `factor`)."""
        if not use.any():
            return
        total = predicted[use] + noise[use]
        weight = noise[use] / total
        ratio = (squared[use] / total).clip(max=_LARGEST)
        fades = 0.5 ** (float(use.sum()) / _MEMORY_SAMPLES)
        self._ratios = self._ratios * fades + self.factor * float((weight * ratio).sum())
        self._weights = self._weights * fades + float(weight.sum())
        self.factor = min(max(self._ratios / self._weights, _LIMITS[0]), _LIMITS[1])
