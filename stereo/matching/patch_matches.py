"""BoxMatcher: measures the disparities of boxes; PatchMatches: the result for each box, with
reasons of failures.
"""

from __future__ import annotations

from dataclasses import dataclass, fields
from enum import IntEnum
from typing import Protocol

import numpy as np

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


REASONS: dict[Outcome, str] = {  # descriptions of the outcomes for the user
    Outcome.MATCHED: "matched",
    Outcome.OUTSIDE: "outside the image, or not finite",
    Outcome.TOO_SMALL: "too small",
    Outcome.NOT_SEEN: "outside the right image",
    Outcome.NO_TEXTURE: "no texture, or saturated",
    Outcome.AMBIGUOUS: "ambiguous: several disparities match equally well, or several surfaces may "
    "be the object",
    Outcome.OUT_OF_RANGE: "disparity at the end of the search range",
    Outcome.NO_FIT: "no match in the right image",
}


@dataclass(frozen=True, slots=True)
class ExpectedDisparity:
    """Disparities of N boxes that are expected from the size of the object, by its class."""

    disparity_px: FloatArray  # (N,) expected disparity; NaN = unknown
    log_sigma: FloatArray  # (N,) standard deviation of its logarithm

    @classmethod
    def unknown(cls, n: int) -> ExpectedDisparity:
        """Unknown disparities of `n` boxes."""
        return cls(np.full(n, np.nan), np.full(n, np.nan))

    def select(self, rows: IntArray) -> ExpectedDisparity:
        """The boxes in rows (M,)."""
        return ExpectedDisparity(self.disparity_px[rows], self.log_sigma[rows])


@dataclass(frozen=True, slots=True)
class PatchMatches:
    """Disparities of N boxes."""

    disparity_px: FloatArray  # (N,) disparity at the centre of the box; NaN = not measured
    sigma_px: FloatArray  # (N,) its standard deviation, without the uncertainty of the alignment
    outcome: IntArray  # (N,) values of `Outcome`
    # (N,) number of surfaces that the box shows: the object, occluders, background; 0 = unknown
    n_surfaces: IntArray
    # (N,) probability that the measured surface is the object; NaN = unknown
    probability: FloatArray

    @classmethod
    def of(cls, disparity_px: FloatArray, sigma_px: FloatArray, outcome: IntArray) -> PatchMatches:
        """Matches of a matcher that does not distinguish surfaces."""
        n = len(outcome)
        return cls(disparity_px, sigma_px, outcome, np.zeros(n, np.int64), np.full(n, np.nan))

    def put(self, rows: IntArray, matches: PatchMatches) -> None:
        """Replace the results of the boxes in rows (M,), in place."""
        for field in fields(self):
            getattr(self, field.name)[rows] = getattr(matches, field.name)


class BoxMatcher(Protocol):
    """Measures the disparities of boxes, like `stereo.matching.patch_matcher.PatchMatcher`."""

    def match(
        self,
        left: Image,
        right: ImageView,
        xyxy_px: FloatArray,
        prior_px: FloatArray,
        by_size: ExpectedDisparity | None = None,
    ) -> PatchMatches:
        """Disparities of boxes in the left image, with the reasons of failures.

        Images are (H, W) grey or (H, W, 3) BGR uint8, boxes (N, 4); `prior_px` (N,) is the last
        disparity of the box's track, NaN = none; `by_size` are expected disparities from the sizes
        of the objects, None = unknown.
        """
        ...
