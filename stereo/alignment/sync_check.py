"""check_sync: do the two images of a pair belong to one instant, or does one camera lag by a frame?

    rows of matched points: y_right - y_left is one constant for a pair of one instant; once the cameras have moved on
    between the two images, near points have moved outwards (or, in a pitch, near and far ones up and down)

So left image i is matched with the right images i - 1, i and i + 1: that of its own instant keeps most points in row.
A static scene keeps its rows with all three, and leaves it unknown.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Literal

from track_range.foundation.arrays import Image
from track_range.stereo.alignment.swap_check import Features, is_in_row, matched_points

Sync = Literal["synchronised", "right lags", "left lags", "unknown"]

_ROW_TOLERANCE_PX = 1.5
_MIN_SHARE = 0.6
"""Share of the matches that must keep their rows with the image of the same instant."""

_MIN_LEAD = 0.1
"""By how much that share must exceed those of both other images."""

_MIN_MATCHES = 60


def check_sync(left: Image, rights: Sequence[Image]) -> Sync:
    """Which of three successive right images is of the left image's instant.

    Args:
        left: (H, W) or (H, W, 3) uint8, rectified; paired with the second of `rights`.
        rights: three right images of the same kind.

    Returns:
        "synchronised": the second; "right lags": the third, so that each right image comes a frame too late;
        "left lags": the first.
    """
    features = Features.of(left)
    shares = [_share_in_row(features, Features.of(right)) for right in rights]
    best = max(range(3), key=shares.__getitem__)
    lead = shares[best] - sorted(shares)[1]
    if shares[best] < _MIN_SHARE or lead < _MIN_LEAD:
        return "unknown"
    answers: tuple[Sync, ...] = ("left lags", "synchronised", "right lags")
    return answers[best]


def _share_in_row(left: Features, right: Features) -> float:
    """Share of the matches that keep their rows; 0 where too few match."""
    left_px, right_px = matched_points(left, right)
    if len(left_px) < _MIN_MATCHES:
        return 0.0
    return float(is_in_row(left_px, right_px, tolerance_px=_ROW_TOLERANCE_PX).mean())
