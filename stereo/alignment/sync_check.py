"""check_step: do the two eyes of a pair belong to one instant, or is one a frame late? From features of a moving scene.

    rows of matched points: y_right - y_left is one constant for a pair of one instant; once the cameras have moved on
    between the two images, near points have moved outwards (or, in a pitch, near and far ones up and down)

So left image i is matched with the right images i - 1, i and i + 1: that of its own instant keeps most points in row.
A scene that stands still keeps its rows with all three, and says nothing.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Literal

from track_range.foundation.arrays import Image
from track_range.stereo.alignment.swap_check import Features, is_in_row, matched_points

Step = Literal["same", "right late", "right early", "unknown"]

_ROW_TOLERANCE_PX = 1.5
_MIN_SHARE = 0.6
"""Share of the matches that the right partner keeps in row."""

_MIN_LEAD = 0.1
"""By how much its share is above both others'."""

_MIN_MATCHES = 60


def check_step(left: Image, rights: Sequence[Image]) -> Step:
    """Whose instant the left image is of, that of the first, second or third of three right images in a row.

    "same": of the second, as it should be; "right late": of the third, so that each right image comes a frame too late;
    "right early": of the first. All images (H, W) or (H, W, 3) uint8, rectified.
    """
    features = Features.of(left)
    shares = [_share_in_row(features, Features.of(right)) for right in rights]
    best = max(range(3), key=shares.__getitem__)
    lead = shares[best] - sorted(shares)[1]
    if shares[best] < _MIN_SHARE or lead < _MIN_LEAD:
        return "unknown"
    answers: tuple[Step, ...] = ("right early", "same", "right late")
    return answers[best]


def _share_in_row(left: Features, right: Features) -> float:
    """Share of the matches that keep their rows; 0 where too few match to say."""
    left_px, right_px = matched_points(left, right)
    if len(left_px) < _MIN_MATCHES:
        return 0.0
    return float(is_in_row(left_px, right_px, tolerance_px=_ROW_TOLERANCE_PX).mean())
