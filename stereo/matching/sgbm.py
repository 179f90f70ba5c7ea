"""Sgbm: the disparity of every pixel by semi-global matching (Hirschmueller 2008, as in OpenCV), and a box's out of it.

OpenCV gives no disparity to the leftmost `n_disparities` columns, since not all candidates lie inside the right image
there. Here both images are widened to the left first, and only those pixels stay unknown whose match lies outside.
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping
from dataclasses import dataclass, fields
from typing import Any, Literal

import cv2
import numpy as np
import numpy.typing as npt

from track_range.foundation.arrays import FloatArray, Image
from track_range.foundation.robust_statistics import mad_sigma
from track_range.stereo.geometry.rig import StereoRig
from track_range.stereo.matching.patches import Patch, inner_halves

DisparityMap = npt.NDArray[np.float32]
Mode = Literal["3way", "sgbm", "hh", "hh4"]

_STEPS_PER_PX = 16
"""OpenCV's disparities are whole numbers of 1/16 px."""

_STEP_SIGMA_PX = 0.15
"""Error of a flat, textured patch's median: pixel locking, mostly (0.14 px on synthetic pairs)."""

_MAX_COST = 32767
"""OpenCV sums costs in 16 bits."""

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
    shape_share: float = 0.3

    def __post_init__(self) -> None:
        for name, is_right, wanted in _checks(self):
            if not is_right:
                raise ValueError(f"sgbm's {name} is {getattr(self, name)!r}: {wanted} wanted")

    @classmethod
    def for_rig(
        cls, rig: StereoRig, *, nearest_m: float = 3.0, chosen: Mapping[str, Any] | None = None
    ) -> SgbmSettings:
        """Settings that reach as near as `nearest_m` with a rectified rig, but for what the user has `chosen`.

        Raises:
            ValueError: an unknown name in `chosen`, or a value that cannot be.
        """
        disparity_px = min(rig.left.fx_px * rig.baseline_m / nearest_m, rig.left.width_px / 2)
        return cls.of({"n_disparities": max(16 * math.ceil(disparity_px / 16), 16), **(chosen or {})})

    @classmethod
    def of(cls, chosen: Mapping[str, Any]) -> SgbmSettings:
        """The defaults, but for what is `chosen` by name.

        Raises:
            ValueError: an unknown name, or a value that cannot be.
        """
        known = [field.name for field in fields(cls)]
        for name in chosen:
            if name not in known:
                raise ValueError(f"sgbm has no '{name}'; it has: {', '.join(known)}")
        return cls(**chosen)


def _checks(found: SgbmSettings) -> list[tuple[str, bool, str]]:
    """Name, whether its value can be, and what is wanted, of each setting."""

    def whole(name: str, low: float, high: float = math.inf) -> bool:
        value = getattr(found, name)
        return type(value) is int and low <= value <= high

    def share(name: str, low: float, high: float) -> bool:
        value = getattr(found, name)
        return type(value) in (int, float) and low <= value <= high

    n = found.n_disparities
    small = found.small_step_penalty if type(found.small_step_penalty) is int else 0
    window_px = found.block_size**2 if type(found.block_size) is int else 1
    large = (small + 1, _MAX_COST // max(window_px, 1))
    return [
        ("min_disparity", whole("min_disparity", -512, 1024), "a whole number -512 .. 1024"),
        ("n_disparities", whole("n_disparities", 16, 1024) and n % 16 == 0, "a multiple of 16 up to 1024"),
        ("block_size", whole("block_size", 1, 21) and found.block_size % 2 == 1, "an odd number up to 21"),
        ("mode", found.mode in list(_OPENCV_MODE), "one of " + ", ".join(_OPENCV_MODE)),
        ("small_step_penalty", whole("small_step_penalty", 1), "a whole number from 1"),
        (
            "large_step_penalty",
            whole("large_step_penalty", *large),
            f"more than the small one, and at most {_MAX_COST} / block_size^2,",
        ),
        ("uniqueness_pct", whole("uniqueness_pct", 0, 99), "a whole number 0 .. 99"),
        ("max_left_right_px", whole("max_left_right_px", -1, 1024), "a whole number -1 .. 1024"),
        ("speckle_px2", whole("speckle_px2", 0, 10**9), "a whole number 0 .. 1e9"),
        ("speckle_range_px", whole("speckle_range_px", 0, 1024), "a whole number 0 .. 1024"),
        ("pre_filter_cap", whole("pre_filter_cap", 1, 127), "a whole number 1 .. 127"),
        ("min_valid_share", share("min_valid_share", 0.0, 1.0), "a share 0 .. 1"),
        ("shape_share", share("shape_share", 0.0, math.inf), "a number from 0"),
    ]


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
            right: the same size, grey or colour.

        Raises:
            ValueError: the images differ in size.
        """
        if left.shape[:2] != right.shape[:2]:
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
    for i, patch in enumerate(_patches(disparity, xyxy_px)):
        if patch is not None:
            median_px[i], sigma_px[i] = _median_and_sigma(_inside(disparity, patch), keep)
    return median_px, sigma_px


def centre_disparity(
    disparity: DisparityMap | FloatArray, xyxy_px: FloatArray, *, settings: SgbmSettings | None = None
) -> tuple[FloatArray, FloatArray]:
    """Disparity of the pixel in the middle of each box (N, 4), as Guo's binocular paper takes it, and sigma, (N,) each.

    NaN where that pixel is unknown or outside. Sigma is the inner half's, whose scatter tells how much depends on the
    pixel that is hit; a lone known pixel has no other sigma than a flat patch's.
    """
    keep = settings or SgbmSettings()
    centre_px, sigma_px = np.full(len(xyxy_px), np.nan), np.full(len(xyxy_px), np.nan)
    with np.errstate(invalid="ignore", over="ignore"):  # boxes that are not finite end outside
        middles_px = np.nan_to_num((xyxy_px[:, :2] + xyxy_px[:, 2:]) / 2, nan=-1.0)
    middles = np.rint(np.clip(middles_px, -1.0, max(disparity.shape))).astype(np.int64).tolist()
    for i, patch in enumerate(_patches(disparity, xyxy_px)):
        x, y = middles[i]
        is_inside = 0 <= y < disparity.shape[0] and 0 <= x < disparity.shape[1]
        if patch is not None and is_inside and np.isfinite(disparity[y, x]):
            sigma = _median_and_sigma(_inside(disparity, patch), keep)[1]
            centre_px[i], sigma_px[i] = disparity[y, x], _STEP_SIGMA_PX if math.isnan(sigma) else sigma
    return centre_px, sigma_px


def disparity_picture(disparity: DisparityMap | FloatArray, *, largest_px: float | None = None) -> Image:
    """(H, W, 3) uint8 BGR: near is red, far is blue, unknown black.

    Args:
        disparity: (H, W), NaN = unknown.
        largest_px: shown as the nearest; None = the 99th percentile of what is known.
    """
    known = np.isfinite(disparity)
    if largest_px is None:
        largest_px = float(np.percentile(disparity[known], 99)) if known.any() else 1.0
    level = np.clip(np.where(known, disparity, 0.0) / max(largest_px, 1e-6), 0.0, 1.0)
    picture = np.asarray(cv2.applyColorMap((255 * level).astype(np.uint8), cv2.COLORMAP_TURBO), np.uint8)
    return np.where(known[:, :, None], picture, np.uint8(0))


def _patches(disparity: DisparityMap | FloatArray, xyxy_px: FloatArray) -> Iterator[Patch | None]:
    return inner_halves(xyxy_px, (disparity.shape[0], disparity.shape[1]), margin_px=0, min_side_px=1)


def _inside(disparity: DisparityMap | FloatArray, patch: Patch) -> DisparityMap | FloatArray:
    return disparity[patch.top : patch.bottom + 1, patch.left : patch.right + 1]


def _median_and_sigma(inside: DisparityMap | FloatArray, keep: SgbmSettings) -> tuple[float, float]:
    known = inside[np.isfinite(inside)].astype(np.float64)
    if len(known) < max(keep.min_valid_share * inside.size, 1):
        return math.nan, math.nan
    return float(np.median(known)), math.hypot(_STEP_SIGMA_PX, keep.shape_share * mad_sigma(known))


def _widened(image: Image, n_added: int) -> Image:
    """The image in grey with `n_added` columns more on the left."""
    grey = cv2.cvtColor(image, cv2.COLOR_BGR2GRAY) if image.ndim == 3 else image
    return np.asarray(cv2.copyMakeBorder(grey, 0, 0, n_added, 0, cv2.BORDER_REPLICATE), np.uint8)
