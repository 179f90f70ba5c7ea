"""Sgbm: the disparity of every pixel by OpenCV's semi-global matching (Hirschmueller 2008), and of
boxes.

OpenCV gives no disparities in the leftmost `n_disparities` columns, because not all candidates are
inside the right image. Here both images are padded on the left first, and only pixels with a match
outside the right image stay NaN.
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping
from dataclasses import dataclass, fields
from typing import Any, Literal, NamedTuple

import cv2
import numpy as np
import numpy.typing as npt

from track_range.foundation.arrays import FloatArray, Image
from track_range.foundation.robust_statistics import mad_sigma
from track_range.stereo.geometry.frames import grey
from track_range.stereo.geometry.rig import StereoRig

DisparityMap = npt.NDArray[np.float32]
Mode = Literal["3way", "sgbm", "hh", "hh4"]
_STEPS_PER_PX = 16  # disparity steps per pixel: OpenCV's disparities are multiples of 1/16 px
# of the median of a flat, textured patch: mostly pixel locking (0.14 px on synthetic pairs)
_MEDIAN_SIGMA_PX = 0.15
_FRACTION_CUT = 0.25  # fraction of the box's width (height) that is cut off on each side
_MAX_COST = 32767  # largest cost: OpenCV sums costs in 16 bits

# Other names of settings in configuration files, and the fields of `SgbmSettings`, which have
# OpenCV's names.
_ALIASES = {
    "uniqueness_pct": "uniqueness_ratio",
    "max_left_right_px": "disp12_max_diff",
    "speckle_px2": "speckle_window_size",
    "speckle_range_px": "speckle_range",
}

_OPENCV_MODE: dict[Mode, int] = {
    "3way": cv2.STEREO_SGBM_MODE_SGBM_3WAY,
    "sgbm": cv2.STEREO_SGBM_MODE_SGBM,
    "hh": cv2.STEREO_SGBM_MODE_HH,
    "hh4": cv2.STEREO_SGBM_MODE_HH4,
}


@dataclass(frozen=True, slots=True, kw_only=True)
class SgbmSettings:
    """Parameters of OpenCV's StereoSGBM, and of reading boxes from its result."""

    min_disparity: int = 0  # smallest disparity, px
    # number of disparities, a multiple of 16; 128 reach 3 m with KITTI's rig (numDisparities)
    n_disparities: int = 128
    block_size: int = 5  # side of the compared window, px, odd; usually 3 .. 7
    # number of aggregation directions: "3way" 3 (fastest, threaded), "sgbm" 5, "hh4" 4, "hh" 8
    # (most memory)
    mode: Mode = "3way"
    # P1 per pixel of the window, for neighbours that differ by one disparity
    small_step_penalty: int = 8
    large_step_penalty: int = 32  # P2 per pixel of the window, for larger steps
    uniqueness_ratio: int = 10  # minimum margin between the best and the second best cost, per cent
    # largest difference between left-to-right and right-to-left matching, px; -1 = not checked
    disp12_max_diff: int = 1
    speckle_window_size: int = 100  # regions with fewer pixels are removed
    speckle_range: int = 2  # largest disparity difference within a region, px
    pre_filter_cap: int = 63  # limit at which the compared x-derivative is truncated
    min_valid_share: float = 0.2  # minimum fraction of a box's middle with known pixels
    # fraction of the scatter of the box's disparities that contributes to sigma
    shape_share: float = 0.6

    def __post_init__(self) -> None:
        for name, is_valid, expected in _checks(self):
            if not is_valid:
                raise ValueError(
                    f"sgbm: expected {name} to be {expected}, got {getattr(self, name)!r}"
                )

    @classmethod
    def for_rig(
        cls, rig: StereoRig, *, nearest_m: float = 3.0, chosen: Mapping[str, Any] | None = None
    ) -> SgbmSettings:
        """See `of`; by default for distances from `nearest_m` with a rectified rig."""
        disparity_px = min(rig.left.fx_px * rig.baseline_m / nearest_m, rig.left.width_px / 2)
        return cls.of(
            {"n_disparities": max(16 * math.ceil(disparity_px / 16), 16), **(chosen or {})}
        )

    @classmethod
    def of(cls, chosen: Mapping[str, Any]) -> SgbmSettings:
        """The defaults, updated with `chosen` values by name.

        Raises ValueError if `chosen` has an unknown name or a wrong value.
        """
        known = [field.name for field in fields(cls)]
        for name in chosen:
            if name not in known and name not in _ALIASES:
                raise ValueError(
                    f"sgbm: unknown setting '{name}'; expected one of {', '.join(known)}"
                )
        return cls(**{_ALIASES.get(name, name): value for name, value in chosen.items()})


def _checks(settings: SgbmSettings) -> list[tuple[str, bool, str]]:
    """Name of each setting, whether its value is valid, and the expected values."""

    def whole(name: str, low: float, high: float = math.inf) -> bool:
        value = getattr(settings, name)
        return type(value) is int and low <= value <= high

    def fraction(name: str, low: float, high: float) -> bool:
        value = getattr(settings, name)
        return type(value) in (int, float) and low <= value <= high

    n, block_size = settings.n_disparities, settings.block_size
    small = settings.small_step_penalty if type(settings.small_step_penalty) is int else 0
    large = (small + 1, _MAX_COST // max(block_size**2 if type(block_size) is int else 1, 1))
    large_text = f"more than small_step_penalty, and at most {_MAX_COST} / block_size^2"
    return [
        ("min_disparity", whole("min_disparity", -512, 1024), "an integer from -512 to 1024"),
        (
            "n_disparities",
            whole("n_disparities", 16, 1024) and n % 16 == 0,
            "a multiple of 16 up to 1024",
        ),
        (
            "block_size",
            whole("block_size", 1, 21) and block_size % 2 == 1,
            "an odd number up to 21",
        ),
        ("mode", settings.mode in list(_OPENCV_MODE), "one of " + ", ".join(_OPENCV_MODE)),
        ("small_step_penalty", whole("small_step_penalty", 1), "an integer of 1 or more"),
        ("large_step_penalty", whole("large_step_penalty", *large), large_text),
        ("uniqueness_ratio", whole("uniqueness_ratio", 0, 99), "an integer from 0 to 99"),
        ("disp12_max_diff", whole("disp12_max_diff", -1, 1024), "an integer from -1 to 1024"),
        ("speckle_window_size", whole("speckle_window_size", 0, 10**9), "an integer from 0 to 1e9"),
        ("speckle_range", whole("speckle_range", 0, 1024), "an integer from 0 to 1024"),
        ("pre_filter_cap", whole("pre_filter_cap", 1, 127), "an integer from 1 to 127"),
        ("min_valid_share", fraction("min_valid_share", 0.0, 1.0), "a fraction from 0 to 1"),
        ("shape_share", fraction("shape_share", 0.0, math.inf), "a number of 0 or more"),
    ]


class Sgbm:
    """Computes dense disparities; an instance may be used by one thread at a time."""

    def __init__(self, settings: SgbmSettings | None = None) -> None:
        settings = self._settings = settings or SgbmSettings()
        self._matcher = cv2.StereoSGBM.create(
            minDisparity=settings.min_disparity,
            numDisparities=settings.n_disparities,
            blockSize=settings.block_size,
            P1=settings.small_step_penalty * settings.block_size**2,
            P2=settings.large_step_penalty * settings.block_size**2,
            disp12MaxDiff=settings.disp12_max_diff,
            preFilterCap=settings.pre_filter_cap,
            uniquenessRatio=settings.uniqueness_ratio,
            speckleWindowSize=settings.speckle_window_size,
            speckleRange=settings.speckle_range,
            mode=_OPENCV_MODE[settings.mode],
        )

    def dense_disparity(self, left: Image, right: Image) -> DisparityMap:
        """(H, W) float32 disparity x_left - x_right of each left pixel, NaN where unknown.

        The images are rectified, of equal size, each (H, W) grey or (H, W, 3) BGR. Raises
        ValueError if they are not.
        """
        if left.shape[:2] != right.shape[:2]:
            raise ValueError(
                f"left and right: expected equal sizes, got {left.shape[:2]} and {right.shape[:2]}"
            )
        # columns on the left
        n_padded = max(self._settings.min_disparity + self._settings.n_disparities, 0)
        padded = [
            cv2.copyMakeBorder(grey(image), 0, 0, n_padded, 0, cv2.BORDER_REPLICATE)
            for image in (left, right)
        ]
        steps = self._matcher.compute(padded[0], padded[1])[:, n_padded:]
        disparity = steps.astype(np.float32) / _STEPS_PER_PX
        column = np.arange(left.shape[1], dtype=np.float32)
        # OpenCV marks rejected pixels with less than the minimum, and gives the minimum itself
        # without texture.
        is_unknown = (disparity <= self._settings.min_disparity) | (disparity > column)
        return np.where(is_unknown, np.float32(np.nan), disparity)


class Patch(NamedTuple):
    """A rectangle of pixels; all four edges are inclusive."""

    left: int
    top: int
    right: int
    bottom: int

    @property
    def window(self) -> tuple[slice, slice]:
        """Index of the pixels in an image."""
        return np.s_[self.top : self.bottom + 1, self.left : self.right + 1]


def inner_halves(
    xyxy_px: FloatArray, image_hw: tuple[int, int], *, margin_px: int = 0, min_side_px: int = 1
) -> Iterator[Patch | None]:
    """The inner half of each box (N, 4), clipped at `margin_px` from the image border.

    It is the central half in width and height, which contains the object and little background.
    None where fewer than `min_side_px` columns or rows are left, or the box is not finite or
    inverted.
    """
    height, width = image_hw
    # infinite boxes become NaN, which gives no patch
    with np.errstate(invalid="ignore", over="ignore"):
        cut = (xyxy_px[:, 2:] - xyxy_px[:, :2]) * _FRACTION_CUT
        first = np.maximum(np.ceil(xyxy_px[:, :2] + cut), margin_px)
        last = np.minimum(
            np.floor(xyxy_px[:, 2:] - cut), np.array([width, height]) - 1.0 - margin_px
        )
    big_enough = (last - first + 1 >= min_side_px).all(axis=1)  # False for NaN too
    for i, usable in enumerate(np.asarray(big_enough).tolist()):
        yield (
            Patch(*first[i].astype(np.int64).tolist(), *last[i].astype(np.int64).tolist())
            if usable
            else None
        )


def centre_disparity(
    disparity: DisparityMap | FloatArray,
    xyxy_px: FloatArray,
    *,
    settings: SgbmSettings | None = None,
) -> tuple[FloatArray, FloatArray]:
    """Disparity of the pixel at the centre of each box (N, 4), as used by Guo Pengyu, and sigma,
    (N,) each.

    NaN where that pixel is unknown or outside the image. Sigma is computed from the inner half,
    including the scatter of its pixels, or for a flat patch if too few pixels are known.
    """
    settings = settings or SgbmSettings()
    centre_px, sigma_px = np.full(len(xyxy_px), np.nan), np.full(len(xyxy_px), np.nan)
    # the centres of infinite boxes are outside the image
    with np.errstate(invalid="ignore", over="ignore"):
        centres_px = np.nan_to_num((xyxy_px[:, :2] + xyxy_px[:, 2:]) / 2, nan=-1.0)
    centres = np.rint(np.clip(centres_px, -1.0, max(disparity.shape))).astype(np.int64).tolist()
    for i, patch in enumerate(inner_halves(xyxy_px, disparity.shape)):
        x, y = centres[i]
        is_inside = 0 <= y < disparity.shape[0] and 0 <= x < disparity.shape[1]
        if patch is not None and is_inside and np.isfinite(disparity[y, x]):
            sigma = _median_and_sigma(disparity, patch, settings)[1]
            centre_px[i], sigma_px[i] = (
                disparity[y, x],
                _MEDIAN_SIGMA_PX if math.isnan(sigma) else sigma,
            )
    return centre_px, sigma_px


def disparity_picture(
    disparity: DisparityMap | FloatArray, *, largest_px: float | None = None
) -> Image:
    """(H, W, 3) uint8 BGR colour map of disparities (H, W): near is red, far is blue, unknown (NaN)
    is black.

    `largest_px` is the disparity of the nearest colour; None = the 99th percentile.
    """
    known = np.isfinite(disparity)
    if largest_px is None:
        largest_px = float(np.percentile(disparity[known], 99)) if known.any() else 1.0
    level = np.clip(np.where(known, disparity, 0.0) / max(largest_px, 1e-6), 0.0, 1.0)
    picture = np.asarray(
        cv2.applyColorMap((255 * level).astype(np.uint8), cv2.COLORMAP_TURBO), np.uint8
    )
    return np.where(known[:, :, None], picture, np.uint8(0))


def _median_and_sigma(
    disparity: DisparityMap | FloatArray, patch: Patch, settings: SgbmSettings
) -> tuple[float, float]:
    inside = disparity[patch.window]
    known = inside[np.isfinite(inside)].astype(np.float64)
    if len(known) < max(settings.min_valid_share * inside.size, 1):
        return math.nan, math.nan
    return float(np.median(known)), math.hypot(
        _MEDIAN_SIGMA_PX, settings.shape_share * mad_sigma(known)
    )
