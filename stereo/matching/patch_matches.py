"""BoxMatcher: finds the disparities of boxes; PatchMatches: what it found for each, or why it found nothing."""

from __future__ import annotations

from dataclasses import dataclass
from enum import IntEnum
from typing import Protocol

from track_range.foundation.arrays import FloatArray, Image, IntArray
from track_range.stereo.geometry.frames import ImageView


class Outcome(IntEnum):
    """Why a box has no disparity."""

    MATCHED = 0
    OUTSIDE = 1
    TOO_SMALL = 2
    NOT_SEEN = 3
    NO_TEXTURE = 4
    AMBIGUOUS = 5
    OUT_OF_RANGE = 6
    NO_FIT = 7


REASONS: dict[Outcome, str] = {
    Outcome.MATCHED: "matched",
    Outcome.OUTSIDE: "outside the image, or not finite",
    Outcome.TOO_SMALL: "too small",
    Outcome.NOT_SEEN: "hardly seen by the right eye",
    Outcome.NO_TEXTURE: "no texture, or saturated",
    Outcome.AMBIGUOUS: "two disparities fit equally well",
    Outcome.OUT_OF_RANGE: "at the end of the range that is searched",
    Outcome.NO_FIT: "nothing in the right image looks like it",
}
"""For the user."""


@dataclass(frozen=True, slots=True)
class PatchMatches:
    """What was found for N boxes.

    Attributes:
        disparity_px: (N,) at the middle of the box; NaN = not measured.
        sigma_px: (N,) its standard deviation, without what the eyes' alignment adds.
        outcome: (N,) an `Outcome` each.
    """

    disparity_px: FloatArray
    sigma_px: FloatArray
    outcome: IntArray

    def put(self, where: IntArray, found: PatchMatches) -> None:
        """Write what was found for the boxes at these indices."""
        self.disparity_px[where], self.sigma_px[where] = found.disparity_px, found.sigma_px
        self.outcome[where] = found.outcome


class BoxMatcher(Protocol):
    """Finds the disparities of single boxes, as `stereo.matching.patch_matcher.PatchMatcher` does."""

    def match(self, left: Image, right: ImageView, xyxy_px: FloatArray, prior_px: FloatArray) -> PatchMatches:
        """Disparities of boxes (N, 4), and why some have none; prior_px (N,) NaN = search the full range."""
        ...
