"""check_sync: whether the images of a rectified pair are simultaneous, from sparse features.

The row offset is constant in simultaneous images; if the cameras move between the two images, near points
move outwards (or, when pitching, all points up or down). So left image i is matched with the right images i - 1, i and
i + 1: the simultaneous one has the most matches in the same row. In a static scene all three do: unknown.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Literal

from track_range.foundation.arrays import Image
from track_range.stereo.alignment.pair_checks import are_in_row, matched_points, orb_features

Sync = Literal["synchronised", "right lags", "left lags", "unknown"]

_SYNC_ROW_TOLERANCE_PX = 1.5
_MIN_SYNC_FRACTION = 0.6  # minimum fraction of matches in the same row with the simultaneous image
_MIN_SYNC_LEAD = 0.1  # minimum difference between that fraction and those of both other images
_MIN_SYNC_MATCHES = 60


def check_sync(left: Image, rights: Sequence[Image]) -> Sync:
    """Whether a rectified left image is simultaneous with the second of three successive right images.

    "right lags": it is with the third, so that right images are one frame late; "left lags": with the first.
    """
    features, fractions = orb_features(left), []
    for right in rights:
        left_px, right_px = matched_points(features, orb_features(right))
        has_matches = len(left_px) >= _MIN_SYNC_MATCHES
        in_row = are_in_row(left_px, right_px, tolerance_px=_SYNC_ROW_TOLERANCE_PX).mean() if has_matches else 0.0
        fractions.append(float(in_row))
    best = max(range(3), key=fractions.__getitem__)
    if fractions[best] < _MIN_SYNC_FRACTION or fractions[best] - sorted(fractions)[1] < _MIN_SYNC_LEAD:
        return "unknown"
    results: tuple[Sync, ...] = ("left lags", "synchronised", "right lags")
    return results[best]
