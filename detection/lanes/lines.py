r"""LaneLines: the own lane's two lines, each x_px as a polynomial of y_px, and the protocol of who finds them.

vanishing   .         x(y) = c0 + c1 y + c2 y^2, left and right of the lane that the camera drives in; on a flat road
point      / \        their distance w(y) grows linearly from the row of the vanishing point down.
    left  /   \  right
         /  w  \
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Protocol

import numpy as np

from track_range.foundation.arrays import FloatArray, Image, check_shape


@dataclass(frozen=True, slots=True)
class LaneLine:
    """One painted line (or kerb) in an image.

    Attributes:
        coefficients: (3,) of x_px as a polynomial of y_px, the constant first.
        covariance: (3, 3) of the coefficients; what is not seen, nearer or farther, becomes less sure by it.
        y_top_px: the highest row in which the line was seen.
        y_bottom_px: the lowest one.
    """

    coefficients: FloatArray
    covariance: FloatArray
    y_top_px: float
    y_bottom_px: float

    def __post_init__(self) -> None:
        check_shape("coefficients", self.coefficients, (3,))
        check_shape("covariance", self.covariance, (3, 3))
        if not self.y_top_px <= self.y_bottom_px:
            raise ValueError(
                f"a line seen from row {self.y_top_px} down to {self.y_bottom_px}: top above bottom wanted"
            )

    def x_px(self, y_px: FloatArray) -> FloatArray:
        """Where the line is in the given rows, of the same shape."""
        c = self.coefficients
        return np.asarray(c[0] + y_px * (c[1] + y_px * c[2]))

    def slope(self, y_px: FloatArray) -> FloatArray:
        """dx/dy in the given rows."""
        return np.asarray(self.coefficients[1] + 2.0 * y_px * self.coefficients[2])

    def sigma_px(self, y_px: FloatArray) -> FloatArray:
        """Standard deviation of x in the given rows; it grows outside those in which the line was seen."""
        powers = np.stack([np.ones_like(y_px), y_px, y_px**2], axis=-1)
        variance = np.einsum("...i,ij,...j->...", powers, self.covariance, powers)
        return np.asarray(np.sqrt(np.maximum(variance, 0.0)))


@dataclass(frozen=True, slots=True)
class LaneLines:
    """The own lane's two lines in one image; None = not seen."""

    left: LaneLine | None = None
    right: LaneLine | None = None

    def horizon_px(self) -> tuple[float, float] | None:
        """Row of the vanishing point, and its standard deviation; None as there.

        The lines meet where their distance, known to sigma, is 0: as much of a row as it grows by in one is unsure.
        """
        point = self.vanishing_point_px()
        if point is None or self.left is None or self.right is None:
            return None
        y_px = np.array(point[1])
        opening = float(self.right.slope(y_px) - self.left.slope(y_px))
        sigma_px = float(np.hypot(self.left.sigma_px(y_px), self.right.sigma_px(y_px)))
        return point[1], sigma_px / opening

    def vanishing_point_px(self) -> tuple[float, float] | None:
        """(x, y) in which the two lines meet, the horizon's row on a flat road; None where they do not, far ahead.

        Of curved lines: where the straight parts of their equal bends meet.
        """
        if self.left is None or self.right is None:
            return None
        constant, slope, bend = self.right.coefficients - self.left.coefficients
        if abs(bend) > 1e-9 or slope <= 0.0:
            return None
        y_px = -constant / slope
        return float(self.left.x_px(np.array(y_px))), float(y_px)


class LaneFinder(Protocol):
    """Finds the own lane's lines in the images of one video; may remember what it saw."""

    notes: tuple[str, ...]

    def find(self, image: Image, time_s: float) -> LaneLines:
        """The lines in `image`, (H, W, 3) uint8 BGR, taken at `time_s`; times of one finder increase."""
        ...


def points(line: LaneLine, *, n: int = 24) -> FloatArray:
    """(n, 2) pixels along a line, from its highest row seen to its lowest, to draw it by."""
    y_px = np.linspace(line.y_top_px, line.y_bottom_px, n)
    return np.stack([line.x_px(y_px), y_px], axis=1)
