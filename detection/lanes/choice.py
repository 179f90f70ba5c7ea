"""Choice of the two lines of the ego lane among the straight lines proposed in an image.

    score(l, r) = support(l) + support(r) - cost * (sum of squared deviations in sigmas from a typical lane)
                                          - cost * (squared distance in sigmas from the tracked lane)

The deviations are those of lane width / camera height, horizon, vanishing point and lateral camera position.
"""

from __future__ import annotations

import numpy as np

from track_range.detection.lanes.markings import Proposals
from track_range.detection.lanes.model import HORIZON, HORIZON_SIGMA, WIDTH_SLOPE, WIDTH_SLOPE_LOG_SIGMA, LaneState
from track_range.foundation.arrays import FloatArray

_MIN_SUPPORT = 0.3
"""Smallest support of a line, relative to the line with the largest support in the image."""

_MAX_SIGMAS = 3.0
"""Largest deviation of a pair in each of the quantities of a typical lane, in sigmas."""

_OFFSET_SIGMA = 0.25
"""Standard deviation of the camera's lateral offset from the lane centre, in lane widths."""

_CENTRE_SIGMA = 0.15
"""Standard deviation of the vanishing point's x from the image centre, in image widths."""

_COST = 0.2
"""Cost of a deviation of one sigma, in units of support."""

_MIN_SCORE = 0.3
"""Smallest score of a pair: two lines of full support (2) may deviate by a total of 3 sigmas."""

_TRACKED_SIGMA = 0.12
"""Standard deviation of a line's x from the tracked lane, in lane widths."""

_MAX_DEPARTURE = 1.5
"""Largest squared distance from the tracked lane, in sigmas squared; the limit allows recovery from a wrong lane."""


def own_pair(proposed: Proposals, image_hw: tuple[int, int], tracked: LaneState | None) -> tuple[int, int] | None:
    """Indices of the proposals that are the left and the right line of the ego lane; None = there is no such pair.

    Args:
        proposed: straight lines in the image.
        image_hw: (height, width) of the image.
        tracked: predicted lane; None = no lane is tracked.
    """
    if len(proposed) < 2:
        return None
    sigmas = _deviations(proposed, image_hw)
    is_strong = proposed.support >= _MIN_SUPPORT
    is_possible = (sigmas < _MAX_SIGMAS).all(axis=0) & is_strong[:, None] & is_strong
    score = proposed.support[:, None] + proposed.support[None, :] - _COST * (sigmas**2).sum(axis=0)
    is_possible &= score >= _MIN_SCORE
    if tracked is not None:
        score = score - _COST * _departure(proposed, tracked)
    score = np.where(is_possible, score, -np.inf)
    left, right = np.unravel_index(int(score.argmax()), score.shape)
    return (int(left), int(right)) if np.isfinite(score[left, right]) else None


def _deviations(proposed: Proposals, image_hw: tuple[int, int]) -> FloatArray:
    """(4, K, K) deviations of each pair (left, right) from a typical lane, in sigmas; inf if it cannot be a lane."""
    height, width = image_hw
    slope_left, slope_right = proposed.slope[:, None], proposed.slope[None, :]
    opening = slope_right - slope_left
    is_lane = opening > 0.2
    opening = np.where(is_lane, opening, 1.0)
    horizon_px = (proposed.constant[:, None] - proposed.constant[None, :]) / opening
    vanishing_x_px = proposed.constant[:, None] + slope_left * horizon_px
    offset = (slope_left + slope_right) / 2 / opening
    sigmas = np.stack(
        [
            np.log(opening / WIDTH_SLOPE) / WIDTH_SLOPE_LOG_SIGMA,
            (horizon_px / height - HORIZON) / HORIZON_SIGMA,
            (vanishing_x_px / width - 0.5) / _CENTRE_SIGMA,
            offset / _OFFSET_SIGMA,
        ]
    )
    return np.where(is_lane, np.abs(sigmas), np.inf)


def _departure(proposed: Proposals, tracked: LaneState) -> FloatArray:
    """(K, K) squared distance in sigmas of each pair from the tracked lane, mean of a near and a middle row."""
    y_px = tracked.image_hw[0] * np.array([0.95, 0.75])
    x_px = proposed.constant[:, None] + proposed.slope[:, None] * y_px
    width_px = np.maximum(tracked.width_px(y_px), 1.0)
    left, right = (((x_px - tracked.x_px(y_px, side)) / width_px / _TRACKED_SIGMA) ** 2 for side in (-1.0, 1.0))
    both = (left.mean(axis=1)[:, None] + right.mean(axis=1)[None, :]) / 2
    return np.asarray(np.minimum(both, _MAX_DEPARTURE), np.float64)
