r"""LaneLines: the two lines of the ego lane, and the `LaneFinder` protocol.

vanishing   .         Each line is x(y) = c0 + c1 y + c2 y^2 in pixels. On a flat road, the distance w(y) of the two
point      / \        lines grows linearly from the row of the vanishing point downwards.
    left  /   \  right
         /  w  \
"""

import math
from dataclasses import dataclass
from typing import Protocol, TypeVar

import numpy as np

from track_range.foundation.arrays import FloatArray, Image, check_shape

_Real = TypeVar("_Real", float, FloatArray)
NO_BOXES: FloatArray = np.zeros((0, 4))


@dataclass(frozen=True, slots=True)
class LaneLine:
    """One painted line (or kerb) in an image."""

    coefficients: FloatArray  # (3,) c0, c1, c2 of x_px as a polynomial of y_px
    covariance: FloatArray  # (3, 3) covariance of the coefficients
    y_top_px: float  # highest row in which the line was seen
    y_bottom_px: float  # lowest row in which the line was seen

    def __post_init__(self) -> None:
        check_shape("coefficients", self.coefficients, (3,))
        check_shape("covariance", self.covariance, (3, 3))
        if not self.y_top_px <= self.y_bottom_px:
            raise ValueError(
                f"expected y_top_px <= y_bottom_px, got {self.y_top_px} and {self.y_bottom_px}"
            )

    def x_px(self, y_px: FloatArray) -> FloatArray:
        """X of the line in the given rows."""
        c = self.coefficients
        return np.asarray(c[0] + y_px * (c[1] + y_px * c[2]))

    def sigma_px(self, y_px: FloatArray) -> FloatArray:
        """Standard deviation of x in the given rows, in the shape of `y_px`."""
        return np.asarray(np.sqrt(np.maximum(_variance_px2(self.covariance, y_px), 0.0)))


@dataclass(frozen=True, slots=True)
class LaneLines:
    """The left and the right line of the ego lane in one image; None = not seen."""

    left: LaneLine | None = None
    right: LaneLine | None = None

    def horizon_px(self) -> tuple[float, float] | None:
        """Row of the vanishing point and its sigma, sigma_w / (dw/dy) with the distance w of the
        lines, if any.
        """
        point = self.vanishing_point_px()
        if point is None or self.left is None or self.right is None:
            return None
        y_px = point[1]
        _, slope, curvature = (self.right.coefficients - self.left.coefficients).tolist()
        variance_px2 = _variance_px2(self.left.covariance + self.right.covariance, y_px)
        return y_px, math.sqrt(max(variance_px2, 0.0)) / (slope + 2.0 * y_px * curvature)

    def vanishing_point_px(self) -> tuple[float, float] | None:
        """(x, y) where the two lines meet, on the horizon of a flat road; None if they do not meet.

        For curved lines, which have the same curvature, it is where their distance becomes 0.
        """
        if self.left is None or self.right is None:
            return None
        constant, slope, curvature = (self.right.coefficients - self.left.coefficients).tolist()
        if abs(curvature) > 1e-9 or slope <= 0.0:
            return None
        y_px = -constant / slope
        c0, c1, c2 = self.left.coefficients.tolist()
        return c0 + y_px * (c1 + y_px * c2), y_px


class LaneFinder(Protocol):
    """Detector of the ego lane's lines in the images of one video; may track them over time."""

    notes: tuple[str, ...]  # notes for the user

    def find(self, image: Image, time_s: float, boxes_px: FloatArray = NO_BOXES) -> LaneLines:
        """The lines in `image`, (H, W, 3) uint8 BGR, taken at `time_s`, which increases from call
        to call; `boxes_px` (M, 4) are objects (x1, y1, x2, y2), on which there are no lines.
        """


def _variance_px2(covariance: FloatArray, y_px: _Real) -> _Real:
    """Variance of x in the given rows, from the (3, 3) covariance of the coefficients."""
    (c00, c01, c02), (_, c11, c12), (_, _, c22) = covariance.tolist()
    variance: _Real = c00 + y_px * (
        2 * c01 + y_px * (2 * c02 + c11 + y_px * (2 * c12 + y_px * c22))
    )
    return variance


def points(line: LaneLine, *, n: int = 24) -> FloatArray:
    """(n, 2) pixels along a line between the rows in which it was seen, for drawing."""
    y_px = np.linspace(line.y_top_px, line.y_bottom_px, n)
    return np.stack([line.x_px(y_px), y_px], axis=1)
