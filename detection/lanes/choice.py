"""Which two of the straight lines that may be painted on a road bound the own lane.

Every pair is scored: what it explains, less what speaks against it (a lane seen from a strange height, a horizon far
from the usual, a camera far from the lane's middle), and less its distance from the lane that was followed so far.
"""

from __future__ import annotations

import numpy as np

from track_range.detection.lanes.markings import Proposals
from track_range.detection.lanes.model import HORIZON, HORIZON_SIGMA, WIDTH_SLOPE, WIDTH_SLOPE_LOG_SIGMA, LaneState
from track_range.foundation.arrays import FloatArray

_MIN_SUPPORT = 0.3  # of the strongest line in the image
_MAX_SIGMAS = 3.0
_OFFSET_SIGMA = 0.25  # of the camera from the lane's middle, in lane widths
_CENTRE_SIGMA = 0.15  # of the vanishing point from the image's middle, in image widths
_COST = 0.2  # of one sigma squared, in units of support
_MIN_SCORE = 0.3  # of a pair to be believed: two strong lines (2) may be 3 sigmas from a usual lane, all told
_FOLLOWED_SIGMA = 0.12  # lane widths
_MAX_DEPARTURE = 1.5  # sigma^2 that any jump costs at most: a lane that was wrong is left when a better one is seen


def own_pair(proposed: Proposals, image_hw: tuple[int, int], followed: LaneState | None) -> tuple[int, int] | None:
    """Rows of the proposals that are the own lane's left and right line; None = no two can be."""
    if len(proposed) < 2:
        return None
    sigmas = _against(proposed, image_hw)
    strong = proposed.support >= _MIN_SUPPORT
    possible = (sigmas < _MAX_SIGMAS).all(axis=0) & strong[:, None] & strong
    score = proposed.support[:, None] + proposed.support[None, :] - _COST * (sigmas**2).sum(axis=0)
    possible &= score >= _MIN_SCORE
    if followed is not None:
        score = score - _COST * _departure(proposed, followed)
    score = np.where(possible, score, -np.inf)
    left, right = np.unravel_index(int(score.argmax()), score.shape)
    return (int(left), int(right)) if np.isfinite(score[left, right]) else None


def _against(proposed: Proposals, image_hw: tuple[int, int]) -> FloatArray:
    """(4, K, K) sigmas by which each pair (left, right) is unusual; inf where it is no lane at all."""
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


def _departure(proposed: Proposals, followed: LaneState) -> FloatArray:
    """(K, K) squared sigmas by which each pair is off the lane followed, in a near row and a middle one."""
    y_px = followed.image_hw[0] * np.array([0.95, 0.75])
    x_px = proposed.constant[:, None] + proposed.slope[:, None] * y_px
    width_px = np.maximum(followed.width_px(y_px), 1.0)
    left, right = (((x_px - followed.x_px(y_px, side)) / width_px / _FOLLOWED_SIGMA) ** 2 for side in (-1.0, 1.0))
    both = (left.mean(axis=1)[:, None] + right.mean(axis=1)[None, :]) / 2
    return np.asarray(np.minimum(both, _MAX_DEPARTURE), np.float64)
