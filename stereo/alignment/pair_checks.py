"""Checks of rectified pairs from sparse features: row offset and swapped images.

    row offset = y_right - y_left, 0 in a rectified pair          disparity = x_left - x_right > 0 for all points

`check_pair`: the images are swapped if the rows agree and nearly all disparities are negative. With few matches,
different rows or disparities of both signs the order is unknown.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal

import cv2
import numpy as np
import numpy.typing as npt

from track_range.foundation.arrays import BoolArray, FloatArray, Image
from track_range.stereo.geometry.frames import grey

ViewOrder = Literal["correct", "swapped", "unknown"]

_N_FEATURES = 2000  # number of ORB features per image
_MAX_RATIO = 0.85  # largest ratio of the distances of the best and the second best match (Lowe 2004)

_ROW_TOLERANCE_PX = 2.0  # largest difference between the row offset of an inlier and the most frequent one
_CLEAR_DISPARITY_PX = 1.0  # minimum disparity with a meaningful sign: far points and misalignments have smaller ones
_MIN_MATCHES = 30  # minimum number of disparities with a meaningful sign
_MIN_FRACTION_OF_SIGN = 0.8  # minimum fraction of the disparities with equal sign
_MIN_FRACTION_IN_ROW = 0.5  # minimum fraction of matches in the same row; of chance matches about 1 % are


@dataclass(frozen=True, slots=True)
class PairCheck:
    """Row offset and order of one pair."""

    n_matches: int  # number of matches in the same row
    # their mean y_right - y_left (the median would be an integer, like the rows of features); NaN without matches
    row_offset_px: float
    negative_fraction: float  # fraction of them with a disparity below -1 px, 0..1; NaN without matches
    view_order: ViewOrder  # "unknown" with too few or contradictory matches

    @property
    def is_conclusive(self) -> bool:
        """Whether the order is known; only then the row offset is meaningful too."""
        return self.view_order != "unknown"

    @property
    def is_swapped(self) -> bool:
        """Whether left and right are certainly swapped."""
        return self.view_order == "swapped"


def check_pair(left: Image, right: Image) -> PairCheck:
    """Row offset and order of one rectified pair, (H, W) or (H, W, 3) uint8 each."""
    left_px, right_px = matched_points(orb_features(left), orb_features(right))
    if len(left_px) == 0:
        return PairCheck(0, float("nan"), float("nan"), "unknown")
    agreeing = are_in_row(left_px, right_px, tolerance_px=_ROW_TOLERANCE_PX)
    disparity_px = (left_px - right_px)[agreeing, 0]
    signed = disparity_px[np.abs(disparity_px) > _CLEAR_DISPARITY_PX]
    view_order: ViewOrder = "unknown"
    if len(signed) >= _MIN_MATCHES and agreeing.mean() >= _MIN_FRACTION_IN_ROW:
        fraction_negative = float((signed < 0).mean())
        if fraction_negative > _MIN_FRACTION_OF_SIGN:
            view_order = "swapped"
        elif fraction_negative < 1 - _MIN_FRACTION_OF_SIGN:
            view_order = "correct"
    return PairCheck(
        n_matches=int(agreeing.sum()),
        row_offset_px=float((right_px - left_px)[agreeing, 1].mean()),
        negative_fraction=float((disparity_px < -_CLEAR_DISPARITY_PX).mean()),
        view_order=view_order,
    )


def are_in_row(left_px: FloatArray, right_px: FloatArray, *, tolerance_px: float) -> BoolArray:
    """(N,) whether matched points (N, 2) have the most frequent row offset, within `tolerance_px`.

    It is the median in the band with the most values, which is not affected by wrong matches in random rows.
    """
    row_offset = right_px[:, 1] - left_px[:, 1]
    offsets = np.sort(row_offset)
    until = np.searchsorted(offsets, offsets + 2 * tolerance_px, side="right")
    start = int((until - np.arange(len(offsets))).argmax())
    return np.asarray(np.abs(row_offset - np.median(offsets[start : until[start]])) <= tolerance_px)


Features = tuple[FloatArray, npt.NDArray[np.uint8]]


def orb_features(image: Image) -> Features:
    """ORB features of one image: (N, 2) pixels and (N, 32) descriptors."""
    points, descriptors = cv2.ORB.create(nfeatures=_N_FEATURES).detectAndCompute(grey(image), None)
    xy_px = np.asarray(cv2.KeyPoint.convert(points), np.float64).reshape(-1, 2)
    return xy_px, np.asarray(descriptors, np.uint8) if len(points) else np.zeros((0, 32), np.uint8)


def matched_points(left: Features, right: Features) -> tuple[FloatArray, FloatArray]:
    """(N, 2) pixels of matched features in the left and the right image, by cross-check and ratio test."""
    (left_px, left_descriptors), (right_px, right_descriptors) = left, right
    if min(len(left_px), len(right_px)) < 2:
        return np.zeros((0, 2)), np.zeros((0, 2))
    matcher = cv2.BFMatcher(cv2.NORM_HAMMING)
    pairs = [
        (first.queryIdx, first.trainIdx)
        for first, second in matcher.knnMatch(left_descriptors, right_descriptors, k=2)
        if first.distance < _MAX_RATIO * second.distance
    ]
    chosen = np.array(pairs, np.int64).reshape(-1, 2)
    if len(chosen):  # the cross-check of these few takes a quarter of the time of that of all features
        back = [match.trainIdx for match in matcher.match(right_descriptors[chosen[:, 1]], left_descriptors)]
        chosen = chosen[np.array(back) == chosen[:, 0]]
    return left_px[chosen[:, 0]], right_px[chosen[:, 1]]
