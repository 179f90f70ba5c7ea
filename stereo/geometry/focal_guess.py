"""FocalGuess: the focal length of a camera without a calibration, with its uncertainty."""

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

# across an image of 16:9, assumed; most road cameras have 50 (telephones, research vehicles) to 110
DEFAULT_FIELD_DEG = 75.0
# relative, of the focal length: 50 degrees is a factor of 1.6, 110 one of 0.54
DEFAULT_FIELD_SIGMA = 0.3


@dataclass(frozen=True, slots=True)
class FocalGuess:
    """A focal length from one source."""

    focal_px: float  # focal length in px of the images
    sigma: float  # relative standard deviation
    source: str  # where it comes from, as it continues "focal length from ..."

    @property
    def text(self) -> str:
        """The focal length, how well it is known, and from what, as the start of a sentence."""
        return (
            f"Focal length {self.focal_px:,.0f} ± {self.sigma * self.focal_px:,.0f} px "
            f"({100 * self.sigma:.1f} %), from {self.source}"
        )


def usual_width_px(size_px: tuple[int, int]) -> int:
    """Width of the image of 16:9 with the diagonal of an image of `size_px` (width, height).

    The diagonal is that of the lens, whose sides depend on how the camera was turned and its images
    were cropped.
    """
    return round(math.hypot(*size_px) * 16 / math.hypot(16, 9))


def default_guess(size_px: tuple[int, int]) -> FocalGuess:
    """Prior of the focal length of an unknown road camera with images of `size_px` (width,
    height).
    """
    return FocalGuess(
        focal_of_field(DEFAULT_FIELD_DEG, usual_width_px(size_px)),
        DEFAULT_FIELD_SIGMA,
        f"the usual field of view of road cameras, {DEFAULT_FIELD_DEG:.0f} degrees",
    )


def best_guess(guesses: Sequence[FocalGuess]) -> FocalGuess:
    """The mean of independent guesses of the focal length, weighted by their precision."""
    precision = np.array([guess.sigma**-2 for guess in guesses])
    log_f = float(precision @ np.log([guess.focal_px for guess in guesses]) / precision.sum())
    source = " and ".join(guess.source for guess in guesses)
    return FocalGuess(math.exp(log_f), float(precision.sum() ** -0.5), source)


def focal_of_field(field_deg: float, side_px: float) -> float:
    """Focal length in px of a field of view across a side of the image."""
    return side_px / 2 / math.tan(math.radians(field_deg) / 2)
