r"""LaneState: two parallel lines on a flat road as five parameters with their covariance, and their
prediction.

    t = (y - y0) / H        centre line  m(t) = a + b t + c t^2        width  w(t) = d + s t        x = m -+ w / 2

H is the image height. Both lines have the same curvature, and on a flat road the spacing between
them is linear in the row: w = 0 at the horizon, and s / H = lane width / camera height for any
focal length (2.1 for 3.5 m seen from 1.65 m). The process noise is large for the centre line
(steering) and the horizon (pitching), and small for s.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from track_range.detection.lanes.lines import LaneLine
from track_range.foundation.arrays import FloatArray

# typical lane width / camera height: cars 2.1 to 2.5, trucks 1.4
WIDTH_SLOPE, WIDTH_SLOPE_LOG_SIGMA = 2.3, 0.35
HORIZON, HORIZON_SIGMA = 0.48, 0.12  # typical row for a forward-looking camera, in image heights
_REFERENCE_ROW = 0.75  # y0, in image heights
# of a, b, c in image heights; d, s: from the width
_PRIOR_SIGMA = np.array([0.3, 0.6, np.nan, np.nan, 0.5])
# of a, b, d, s, c, image heights per root second
_RANDOM_WALK = np.array([0.15, 0.25, 0.03, 0.04, 0.2])


@dataclass(frozen=True, slots=True)
class LaneState:
    """Estimate of the ego lane in images of (height, width) `image_hw`."""

    mean: FloatArray  # (5,) a, b, d, s, c in pixels
    covariance: FloatArray  # (5, 5)
    image_hw: tuple[int, int]

    @classmethod
    def from_straight_lines(
        cls, left: tuple[float, float], right: tuple[float, float], image_hw: tuple[int, int]
    ) -> LaneState:
        """A wide prior centred on two lines, given as (constant, slope) of x = constant + slope
        y.
        """
        height = image_hw[0]
        x_left = left[0] + left[1] * _REFERENCE_ROW * height
        x_right = right[0] + right[1] * _REFERENCE_ROW * height
        slopes = np.array([left[1], right[1]]) * height
        mean = np.array(
            [(x_left + x_right) / 2, slopes.mean(), x_right - x_left, slopes[1] - slopes[0], 0.0]
        )
        sigma = _PRIOR_SIGMA * height
        slope_sigma = WIDTH_SLOPE_LOG_SIGMA * abs(mean[3])
        sigma[2:4] = (
            np.hypot(slope_sigma * (_REFERENCE_ROW - HORIZON), mean[3] * HORIZON_SIGMA),
            slope_sigma,
        )
        return cls(mean, np.diag(sigma**2), image_hw)

    def after(self, step_s: float) -> LaneState:
        """The state predicted `step_s` ahead."""
        noise = np.diag((_RANDOM_WALK * self.image_hw[0]) ** 2 * step_s)
        return LaneState(self.mean, self.covariance + noise, self.image_hw)

    @property
    def horizon_px(self) -> float:
        """Row in which the lines meet."""
        return float(self.image_hw[0] * (_REFERENCE_ROW - self.mean[2] / self.mean[3]))

    @property
    def vanishing_x_px(self) -> float:
        """X of the tangent to the centre line at y0, in the row in which the lines meet."""
        return float(self.mean[0] - self.mean[1] * self.mean[2] / self.mean[3])

    def width_px(self, y_px: FloatArray) -> FloatArray:
        """Distance w between the lines in the given rows; negative above the horizon."""
        return np.asarray(self.mean[2] + self.mean[3] * (y_px / self.image_hw[0] - _REFERENCE_ROW))

    def rows(self, y_px: FloatArray, side: float) -> FloatArray:
        """(N, 5) derivatives of x with respect to the state in the given rows (N,); side -1 = left,
        +1 = right.
        """
        t = y_px / self.image_hw[0] - _REFERENCE_ROW
        rows = np.empty((len(t), 5))
        rows[:, 0], rows[:, 1], rows[:, 4] = 1.0, t, t * t
        rows[:, 2:4] = side / 2 * rows[:, :2]
        return rows

    def x_px(self, y_px: FloatArray, side: float) -> FloatArray:
        """(N,) x of a line in the given rows (N,); side -1 = left, +1 = right."""
        a, b, d, s, c = self.mean.tolist()
        half = side / 2
        t = y_px / self.image_hw[0] - _REFERENCE_ROW
        return np.asarray((a + half * d) + t * ((b + half * s) + c * t))

    def line(self, side: float, *, y_top_px: float, y_bottom_px: float) -> LaneLine:
        """One of the lines as a polynomial of y; side -1 = left, +1 = right."""
        height, shift = self.image_hw[0], _REFERENCE_ROW
        # 1, t and t^2 in powers of y
        of_t = np.array(
            [
                [1.0, -shift, shift**2],
                [0.0, 1 / height, -2 * shift / height],
                [0.0, 0.0, 1 / height**2],
            ]
        )
        of_state = np.array([[1.0, 0, side / 2, 0, 0], [0, 1.0, 0, side / 2, 0], [0, 0, 0, 0, 1.0]])
        transform = of_t @ of_state
        return LaneLine(
            transform @ self.mean, transform @ self.covariance @ transform.T, y_top_px, y_bottom_px
        )
