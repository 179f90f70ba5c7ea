"""Sgbm: the disparity of every pixel by semi-global matching (Hirschmueller 2008, as in OpenCV), and a box's median.

OpenCV gives no disparity to the leftmost `n_disparities` columns, since not all candidates lie inside the right image
there. Here both images are widened to the left first, and only those pixels stay unknown whose match lies outside.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Literal

import cv2
import numpy as np
import numpy.typing as npt

from stereo.alignment import UNCORRECTED_SIGMA_PX
from stereo.frames import Image
from stereo.patches import inner_halves
from stereo.rig import StereoRig

FloatArray = npt.NDArray[np.float64]
DisparityMap = npt.NDArray[np.float32]
Mode = Literal["3way", "sgbm", "hh", "hh4"]

_STEPS_PER_PX = 16
"""OpenCV's disparities are whole numbers of 1/16 px."""

_OPENCV_MODE: dict[Mode, int] = {
    "3way": cv2.STEREO_SGBM_MODE_SGBM_3WAY,
    "sgbm": cv2.STEREO_SGBM_MODE_SGBM,
    "hh": cv2.STEREO_SGBM_MODE_HH,
    "hh4": cv2.STEREO_SGBM_MODE_HH4,
}


@dataclass(frozen=True, slots=True, kw_only=True)
class SgbmSettings:
    """What is searched, and how smooth the answer must be.

    Attributes:
        min_disparity: smallest disparity, px.
        n_disparities: how many from there on; a multiple of 16. 128 reach 3 m with KITTI's rig.
        block_size: side of the window that is compared, px, odd; 3 .. 7 are usual.
        mode: directions that are smoothed along: "3way" 3 (fastest, threaded), "sgbm" 5, "hh4" 4, "hh" 8 (most memory).
        small_step_penalty: P1 per pixel of the window, for neighbours one disparity apart.
        large_step_penalty: P2 per pixel of the window, for larger steps.
        uniqueness_pct: by how much the best cost must beat the next one.
        max_left_right_px: largest disagreement between matching left to right and right to left; -1 = not checked.
        speckle_px2: patches smaller than this are dropped.
        speckle_range_px: disparity step that separates two patches.
        pre_filter_cap: where the x-derivative that is compared is cut off.
        min_valid_share: share of a box's inner half that must be known for a median.
        alignment_sigma_px: what the eyes' alignment leaves, added to every sigma.
        shape_share: share of the scatter inside the inner half that goes into sigma; as the patch matcher's.
    """

    min_disparity: int = 0
    n_disparities: int = 128
    block_size: int = 5
    mode: Mode = "3way"
    small_step_penalty: int = 8
    large_step_penalty: int = 32
    uniqueness_pct: int = 10
    max_left_right_px: int = 1
    speckle_px2: int = 100
    speckle_range_px: int = 2
    pre_filter_cap: int = 63
    min_valid_share: float = 0.2
    alignment_sigma_px: float = UNCORRECTED_SIGMA_PX
    shape_share: float = 0.3

    @classmethod
    def for_rig(cls, rig: StereoRig, *, nearest_m: float = 3.0) -> SgbmSettings:
        """Settings that reach as near as `nearest_m` with a rectified rig."""
        disparity_px = min(rig.left.fx_px * rig.baseline_m / nearest_m, rig.left.width_px / 2)
        return cls(n_disparities=max(16 * math.ceil(disparity_px / 16), 16))


class Sgbm:
    """Dense disparity; an instance serves one thread."""

    def __init__(self, settings: SgbmSettings | None = None) -> None:
        keep = self._settings = settings or SgbmSettings()
        self._matcher = cv2.StereoSGBM.create(
            minDisparity=keep.min_disparity,
            numDisparities=keep.n_disparities,
            blockSize=keep.block_size,
            P1=keep.small_step_penalty * keep.block_size**2,
            P2=keep.large_step_penalty * keep.block_size**2,
            disp12MaxDiff=keep.max_left_right_px,
            preFilterCap=keep.pre_filter_cap,
            uniquenessRatio=keep.uniqueness_pct,
            speckleWindowSize=keep.speckle_px2,
            speckleRange=keep.speckle_range_px,
            mode=_OPENCV_MODE[keep.mode],
        )

    def dense_disparity(self, left: Image, right: Image) -> DisparityMap:
        """(H, W) float32 disparity x_left - x_right of each left pixel, NaN where unknown.

        Args:
            left: (H, W) grey or (H, W, 3) BGR, rectified.
            right: the same size.

        Raises:
            ValueError: the images differ in size.
        """
        if left.shape != right.shape:
            raise ValueError(f"left and right: equal shapes wanted, {left.shape} and {right.shape} got")
        n_added = max(self._settings.min_disparity + self._settings.n_disparities, 0)
        steps = self._matcher.compute(_widened(left, n_added), _widened(right, n_added))[:, n_added:]
        disparity = steps.astype(np.float32) / _STEPS_PER_PX
        column = np.arange(left.shape[1], dtype=np.float32)
        # OpenCV marks what it rejects with less than the minimum; it answers the minimum itself where all is flat.
        unknown = (disparity <= self._settings.min_disparity) | (disparity > column)
        return np.where(unknown, np.float32(np.nan), disparity)


def inner_half_median(
    disparity: DisparityMap | FloatArray, xyxy_px: FloatArray, *, settings: SgbmSettings | None = None
) -> tuple[FloatArray, FloatArray]:
    """Median disparity and its standard deviation, (N,) pixels each, of the inner half of each box (N, 4).

    NaN where too little of it is known, and for boxes outside the image, smaller than 2 px or not finite.
    """
    keep = settings or SgbmSettings()
    median_px, sigma_px = np.full(len(xyxy_px), np.nan), np.full(len(xyxy_px), np.nan)
    image_hw = (disparity.shape[0], disparity.shape[1])
    for i, patch in enumerate(inner_halves(xyxy_px, image_hw, margin_px=0, min_side_px=1)):
        if patch is not None:
            inside = disparity[patch.top : patch.bottom + 1, patch.left : patch.right + 1]
            median_px[i], sigma_px[i] = _median_and_sigma(inside, keep)
    return median_px, sigma_px


def _median_and_sigma(inside: DisparityMap | FloatArray, keep: SgbmSettings) -> tuple[float, float]:
    known = inside[np.isfinite(inside)].astype(np.float64)
    if len(known) < max(keep.min_valid_share * inside.size, 1):
        return math.nan, math.nan
    median = float(np.median(known))
    scatter = 1.4826 * float(np.median(np.abs(known - median)))
    return median, math.hypot(keep.alignment_sigma_px, keep.shape_share * scatter)


def _widened(image: Image, n_added: int) -> Image:
    """The image in grey with `n_added` columns more on the left."""
    grey = cv2.cvtColor(image, cv2.COLOR_BGR2GRAY) if image.ndim == 3 else image
    return np.asarray(cv2.copyMakeBorder(grey, 0, 0, n_added, 0, cv2.BORDER_REPLICATE), np.uint8)
