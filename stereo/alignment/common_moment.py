"""found_offset: by how much the clocks of the videos of a pair differ, from their images.

Points of a left image and of the right image of its moment lie in equal rows. A right image of
another moment shows most of them elsewhere, or not at all, if anything but the sky has moved
meanwhile:

    left image i  ->  agreement with each right image  ->  clear peak at right image j: offset = t_left i - t_right j

The offset counts where the peaks of several left images agree. Where the camera stands, no right
image agrees better than others, and nothing is known.
"""

import math
from collections.abc import Callable
from functools import cache
from statistics import mean, median, median_low
from typing import Literal, NamedTuple

import numpy as np

from track_range.foundation.arrays import FloatArray, Image
from track_range.stereo.alignment.pair_evidence import features, in_equal_rows

# left images that are compared, as fractions of the video, and the fewest whose peaks agree
_PLACES, _N_AGREEING = (0.05, 0.2, 0.35, 0.5, 0.65, 0.8, 0.95), 2
_STEP_S = 0.1  # between the right images that are compared first
_NEAR_S = 0.6  # around a peak, in which images of a slow drive agree as well
# smallest number of points at a peak, and their ratios to those beyond it, and to those that two
# successive left images share; the latter is 0.9 to 3.0 in recorded and simulated drives, and at
# most 0.35 at places that look alike
_MIN_POINTS, _LEAD, _MIN_FRACTION = 25, 1.8, 0.5
_MAX_CHANCE = 0.3  # largest ratio to the latter without a right image of the moment
_SPREAD_S = 0.25  # largest difference of offsets that agree, of slow drives


class TimedImages(NamedTuple):
    """Images of one video, with their times in its clock."""

    times_s: list[float]
    images: list[Image]


class ClockOffset(NamedTuple):
    """What images show of two clocks.

    found     times of the right video plus `value_s` are those of the left one
    apart     no right image shows the moment of a left image
    unknown   without motion, or with too few points
    """

    kind: Literal["found", "apart", "unknown"]
    value_s: float = math.nan
    points: float = 0.0  # mean number of points in equal rows, of the best right images
    # the same of the best ones of other moments; if nothing is found, of successive left images
    other_points: float = 0.0


class _Peak(NamedTuple):
    """The right image that agrees best with a left image."""

    offset_s: float
    points: int
    other_points: int  # largest number beyond the peak
    shared_points: int  # those of the left image and the next one

    @property
    def is_clear(self) -> bool:
        smallest = max(_LEAD * self.other_points, _MIN_FRACTION * self.shared_points)
        return self.points >= max(_MIN_POINTS, smallest)


def found_offset(left: TimedImages, right: TimedImages) -> ClockOffset:
    """The offset of the clocks of two videos, from small grey rectified images of each."""
    n = len(left.images)
    if min(n, len(right.images)) < 2:
        return ClockOffset("unknown")
    of_left = cache(lambda number: features(left.images[number]))
    of_right = cache(lambda number: features(right.images[number]))
    size_px = left.images[0].shape[1::-1]
    peaks = []
    for i in (round(place * (n - 2)) for place in _PLACES):
        shared = in_equal_rows(of_left(i), of_left(i + 1), size_px)
        points = cache(lambda j, i=i: in_equal_rows(of_left(i), of_right(j), size_px))
        peaks.append(_peak(left.times_s[i], np.array(right.times_s), points, shared))
    clear = [peak for peak in peaks if peak.is_clear]
    groups = (
        [one for one in clear if abs(one.offset_s - peak.offset_s) <= _SPREAD_S] for peak in clear
    )
    agreeing = max(groups, key=len, default=[])
    if len(agreeing) >= _N_AGREEING and len(agreeing) > len(clear) / 2:
        return ClockOffset(
            "found",
            value_s=median_low([peak.offset_s for peak in agreeing]),
            points=mean(peak.points for peak in agreeing),
            other_points=mean(peak.other_points for peak in agreeing),
        )
    best = median(peak.points for peak in peaks)
    successive = median(peak.shared_points for peak in peaks)
    is_apart = not clear and successive >= 2 * _MIN_POINTS and best < _MAX_CHANCE * successive
    return ClockOffset("apart" if is_apart else "unknown", points=best, other_points=successive)


def _peak(left_s: float, right_s: FloatArray, points: Callable[[int], int], shared: int) -> _Peak:
    """The peak of a left image at a time, of which right images (N,) show that many points."""
    step = max(1, round(_STEP_S / float(np.median(np.diff(right_s)))))
    tried = range(0, len(right_s), step)
    near = max(tried, key=points)
    best = max(range(max(0, near - step), min(len(right_s), near + step + 1)), key=points)
    others = (points(j) for j in tried if abs(right_s[j] - right_s[best]) > _NEAR_S)
    return _Peak(left_s - float(right_s[best]), points(best), max(others, default=0), shared)
