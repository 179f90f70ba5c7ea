"""check_sync: whether the two images of a pair are simultaneous, or one camera lags by a frame.

    y_right - y_left of matched points is constant in simultaneous images; if the cameras move between the two images,
    near points move outwards (or, when pitching, all points up or down)

So left image i is matched with the right images i - 1, i and i + 1: the simultaneous one has the most matches in the
same row. In a static scene all three do, and the result is unknown.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Literal

from track_range.foundation.arrays import Image
from track_range.stereo.alignment.swap_check import Features, is_in_row, matched_points

Sync = Literal["synchronised", "right lags", "left lags", "unknown"]

_ROW_TOLERANCE_PX = 1.5  # largest difference between the row offset of an inlier and the most frequent one
_MIN_FRACTION = 0.6  # minimum fraction of matches in the same row with the simultaneous image
_MIN_LEAD = 0.1  # minimum difference between that fraction and those of both other images
_MIN_MATCHES = 60  # minimum number of matches


def check_sync(left: Image, rights: Sequence[Image]) -> Sync:
    """Whether the left image is simultaneous with the second of three successive right images, or one camera lags.

    Args:
        left: (H, W) or (H, W, 3) uint8, rectified; paired with the second of `rights`.
        rights: three right images of the same kind.

    Returns:
        "synchronised": the second; "right lags": the third, so that right images are one frame late; "left lags": the
        first; "unknown".
    """
    features, fractions = Features.of(left), []
    for right in rights:
        left_px, right_px = matched_points(features, Features.of(right))
        if len(left_px) < _MIN_MATCHES:
            fractions.append(0.0)
        else:
            fractions.append(float(is_in_row(left_px, right_px, tolerance_px=_ROW_TOLERANCE_PX).mean()))
    best = max(range(3), key=fractions.__getitem__)
    lead = fractions[best] - sorted(fractions)[1]
    if fractions[best] < _MIN_FRACTION or lead < _MIN_LEAD:
        return "unknown"
    results: tuple[Sync, ...] = ("left lags", "synchronised", "right lags")
    return results[best]
