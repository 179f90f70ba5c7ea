"""BoxMatcher: measures the disparities of boxes; PatchMatches: the result for each box, with reasons of failures."""

from __future__ import annotations

from dataclasses import dataclass
from enum import IntEnum
from typing import Protocol

from track_range.foundation.arrays import FloatArray, Image, IntArray
from track_range.stereo.geometry.frames import ImageView


class Outcome(IntEnum):
    """Result of matching a box: MATCHED, or the reason why it has no disparity."""

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
    Outcome.NOT_SEEN: "outside the right image",
    Outcome.NO_TEXTURE: "no texture, or saturated",
    Outcome.AMBIGUOUS: "ambiguous: several disparities match equally well",
    Outcome.OUT_OF_RANGE: "disparity at the end of the search range",
    Outcome.NO_FIT: "no match in the right image",
}
"""Descriptions of the outcomes for the user."""


@dataclass(frozen=True, slots=True)
class PatchMatches:
    """Disparities of N boxes.

    Attributes:
        disparity_px: (N,) disparity at the centre of the box; NaN = not measured.
        sigma_px: (N,) its standard deviation, without the uncertainty of the alignment.
        outcome: (N,) values of `Outcome`.
    """

    disparity_px: FloatArray
    sigma_px: FloatArray
    outcome: IntArray

    def put(self, rows: IntArray, matches: PatchMatches) -> None:
        """Replace the results of the boxes in rows (M,), in place."""
        self.disparity_px[rows], self.sigma_px[rows] = matches.disparity_px, matches.sigma_px
        self.outcome[rows] = matches.outcome


class BoxMatcher(Protocol):
    """Measures the disparities of boxes, like `stereo.matching.patch_matcher.PatchMatcher`."""

    def match(self, left: Image, right: ImageView, xyxy_px: FloatArray, prior_px: FloatArray) -> PatchMatches:
        """Disparities of boxes (N, 4), with priors (N,); NaN = search the full range."""
        ...
