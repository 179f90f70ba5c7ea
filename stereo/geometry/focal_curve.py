"""FocalCurve: what is known of a focal length, as a likelihood of any shape."""

import math
from dataclasses import dataclass
from typing import Self

import numpy as np

from track_range.foundation.arrays import FloatArray
from track_range.stereo.geometry.focal_guess import FocalGuess, focal_of_field, usual_width_px

# largest and smallest field of view of a curve, across an image of 16:9
FIELDS_DEG = 150.0, 20.0
# probabilities below the bounds of the intervals of one and two standard deviations, and the median
_QUANTILES = (0.0228, 0.1587, 0.5, 0.8413, 0.9772)


@dataclass(frozen=True, slots=True)
class FocalCurve:
    """The likelihood of a focal length."""

    log_focal: FloatArray  # (G,) ascending logarithms of the focal length in px, evenly spaced
    log_likelihood: FloatArray  # (G,) up to a constant

    @classmethod
    def of_guess(cls, guess: FocalGuess, log_focal: FloatArray) -> Self:
        """A focal length with a standard deviation."""
        deviation = (log_focal - math.log(guess.focal_px)) / guess.sigma
        return cls(log_focal, np.asarray(-0.5 * deviation**2))

    @property
    def density(self) -> FloatArray:
        """(G,) probability of each point, as if nothing else were known."""
        density = np.exp(self.log_likelihood - self.log_likelihood.max())
        return np.asarray(density / density.sum())

    @property
    def estimate(self) -> tuple[float, float]:
        """Median in px, and relative standard deviation: that of the intervals of 68 and 95 %, the
        larger one. The second moment would be that of rare mistakes.
        """
        density = self.density
        below = np.cumsum(density) - density / 2
        quantiles = np.interp(_QUANTILES, below, self.log_focal)
        low_95, low_68, middle, high_68, high_95 = quantiles.tolist()
        return math.exp(middle), max((high_68 - low_68) / 2, (high_95 - low_95) / 4)

    def at(self, log_focal: FloatArray) -> Self:
        """The curve at other points (G,); outside of its own it falls as its ends do."""
        known, curve = self.log_focal, self.log_likelihood
        values = np.interp(log_focal, known, curve)
        first, last = np.diff(curve)[[0, -1]] / np.diff(known)[[0, -1]]
        values += max(float(first), 0.0) * np.minimum(log_focal - known[0], 0.0)
        values += min(float(last), 0.0) * np.maximum(log_focal - known[-1], 0.0)
        return type(self)(log_focal, np.asarray(values))

    def parts(self, n: int) -> FloatArray:
        """(3, <= n) probability, mean and standard deviation of the logarithm in parts of the
        curve, which are narrow where it is high; moments of the whole are kept.
        """
        p, x = self.density, self.log_focal
        height = np.cumsum(np.sqrt(p))
        part = np.minimum(np.floor(n * height / height[-1]), n - 1).astype(np.int64)
        total = np.bincount(part, p, n)
        has_points = total > 0
        mean, square = (
            np.bincount(part, p * x**power, n)[has_points] / total[has_points] for power in (1, 2)
        )
        width = (x[1] - x[0]) ** 2 / 12  # of a point
        sigma = np.sqrt(np.maximum(square - mean**2, 0.0) + width)
        return np.array([total[has_points], mean, sigma])


def log_focal_grid(size_px: tuple[int, int], n: int) -> FloatArray:
    """(n,) logarithms of focal lengths in px of images of `size_px` (width, height), evenly
    spaced.
    """
    width_px = usual_width_px(size_px)
    low, high = (math.log(focal_of_field(field_deg, width_px)) for field_deg in FIELDS_DEG)
    return np.linspace(low, high, n)
