"""Confidence measures of the median of dense disparities in a box, as alternatives to its standard deviation.

    spread       median absolute deviation of the disparities in the inner half, relative to their median
    invalid      fraction of pixels in the inner half without a disparity: rejected by OpenCV's uniqueness, left-right
                 check or speckle filter
    disagreeing  fraction of pixels in the inner half without a disparity or more than `NEAR` away from the median
    left_right   fraction of pixels in the inner half without a disparity, or whose disparity differs by more than
                 `MAX_DIFFERENCE_PX` from the disparity of the matched pixel in the right image

All are uncertainties: larger = less certain. (Poggi et al., "On the confidence of stereo matching in a deep-learning
era", PAMI 2022, compares measures of single pixels.) Margins of costs are not among them, since OpenCV does not return
its costs.
"""

from collections.abc import Iterable, Iterator

import numpy as np

from track_range.foundation.arrays import BoolArray, FloatArray, Image
from track_range.foundation.robust_statistics import mad_sigma
from track_range.stereo.evaluation.kitti_2015 import StereoPair
from track_range.stereo.geometry.frames import whole_image
from track_range.stereo.matching.sgbm import DisparityMap, Sgbm, SgbmSettings, inner_halves

MEASURES = ("spread", "invalid", "disagreeing", "left_right")  # names of the measures
# Measure with the smallest area under the curve of failures, chosen on 628 objects of the 80
# unrelated images of the benchmark `occlusion` with seeds 0-19: sigma 10.6, spread 7.0, invalid
# 4.0, disagreeing 3.9, left_right 3.6 %.
BEST_MEASURE = "left_right"
NEAR = 0.03  # largest relative difference from the median of a pixel that agrees with it
# largest difference of disparity to that of the right image: the limit of OpenCV's own check
MAX_DIFFERENCE_PX = 1.0
DENSE_MATCHER = "sgbm-hh"  # name of the matcher of which the measures are


class ConfidenceRecorder:
    """Computes the measures of `DENSE_MATCHER` for the boxes of pairs that pass through
    `recorded`.
    """

    def __init__(self) -> None:
        self._parts: dict[str, list[FloatArray]] = {measure: [np.zeros(0)] for measure in MEASURES}

    def recorded(self, pairs: Iterable[StereoPair]) -> Iterator[StereoPair]:
        """The same pairs; the measures of a pair are computed after its use."""
        for pair in pairs:
            yield pair
            settings = SgbmSettings.for_rig(pair.rig, chosen={"mode": "hh"})
            measures = confidence_measures(
                pair.left, whole_image(pair.right), pair.xyxy_px, settings
            )
            for measure, values in measures.items():
                self._parts[measure].append(values)

    @property
    def measures(self) -> dict[str, FloatArray]:
        """(N,) values of each measure for the boxes of all pairs so far."""
        return {measure: np.concatenate(parts) for measure, parts in self._parts.items()}


def confidence_measures(
    left: Image, right: Image, xyxy_px: FloatArray, settings: SgbmSettings
) -> dict[str, FloatArray]:
    """(N,) values of each measure for boxes (N, 4); NaN where no pixel of the inner half has a
    disparity.
    """
    sgbm = Sgbm(settings)
    disparity = sgbm.dense_disparity(left, right)
    mirrored = sgbm.dense_disparity(
        np.ascontiguousarray(right[:, ::-1]), np.ascontiguousarray(left[:, ::-1])
    )
    is_consistent = consistent_pixels(disparity, mirrored[:, ::-1])
    values = {measure: np.full(len(xyxy_px), np.nan) for measure in MEASURES}
    for i, patch in enumerate(inner_halves(xyxy_px, disparity.shape)):
        if patch is None:
            continue
        inside = disparity[patch.window]
        known = inside[np.isfinite(inside)].astype(np.float64)
        if not len(known):
            continue
        median_px = float(np.median(known))
        is_near = np.abs(known - median_px) <= NEAR * median_px
        values["spread"][i] = mad_sigma(known) / median_px
        values["invalid"][i] = 1 - len(known) / inside.size
        values["disagreeing"][i] = 1 - is_near.sum() / inside.size
        values["left_right"][i] = 1 - is_consistent[patch.window].mean()
    return values


def consistent_pixels(left_px: DisparityMap, right_px: DisparityMap) -> BoolArray:
    """(H, W) left pixels whose disparity agrees with the matched pixel of the right image; NaN =
    unknown.
    """
    width = left_px.shape[1]
    matched = np.rint(np.arange(width) - np.nan_to_num(left_px, nan=0.0)).astype(np.int64)
    other_px = np.take_along_axis(right_px, np.clip(matched, 0, width - 1), axis=1)
    return np.asarray((matched >= 0) & (np.abs(left_px - other_px) <= MAX_DIFFERENCE_PX))
