"""PatchMatcher: the disparity of one box, from its inner half alone.

Census cost summed over the inner half, the integer minimum, then a V-shaped (equiangular) fit, since a sum of absolute
differences falls off linearly on both sides of the true shift (Shimizu & Okutomi 2005):

    d = k + (c[k-1] - c[k+1]) / (2 (max(c[k-1], c[k+1]) - c[k]))

It rather says NaN than a wrong number: where the minimum lies at the end of the range, is not deep (no texture), or has
a rival of nearly the same depth (repeated texture, two surfaces, a steep one).
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from stereo.alignment import UNCORRECTED_SIGMA_PX
from stereo.census import MARGIN_PX, CostCurves, cost_curves
from stereo.frames import Image
from stereo.patches import Patch, inner_halves
from stereo.rig import StereoRig

FloatArray = npt.NDArray[np.float64]

_NO_MATCH = (math.nan, math.nan)

_CHANCE_PERCENTILE = 75.0
"""The costs' percentile that stands for a chance match, also about a prior, where half the costs are in the valley."""


@dataclass(frozen=True, slots=True, kw_only=True)
class PatchMatcherSettings:
    """What the matcher searches, and what it refuses.

    Attributes:
        min_disparity_px: smallest disparity that is searched.
        max_disparity_px: largest; sets the nearest distance (192 px: 2 m with KITTI's rig).
        search_px: half width of the search about a prior.
        max_pixels: rows of a larger patch are skipped until so many pixels are left; more gain nothing.
        min_side_px: smallest side of an inner half; boxes are at least about twice as large.
        min_depth_bits: least depth of the minimum below the cost of a chance match, in bits of 24 per pixel.
        noise_bits: a minimum must also be deeper than this / sqrt(pixels): 4 times the scatter of chance matches.
        min_rival_share: cost of the next best minimum above the best one, as a share of the depth.
        alignment_sigma_px: what the eyes' alignment leaves, added to every sigma.
        shape_share: share of the cells' scatter (the object's own depth) that goes into sigma; from the 36 cars of
            16 KITTI 2015 pairs, so their share within 1 sigma is no proof of it.
    """

    min_disparity_px: int = 1
    max_disparity_px: int = 192
    search_px: int = 8
    max_pixels: int = 2500
    min_side_px: int = 5
    min_depth_bits: float = 1.5
    noise_bits: float = 48.0
    min_rival_share: float = 0.1
    alignment_sigma_px: float = UNCORRECTED_SIGMA_PX
    shape_share: float = 0.3

    @classmethod
    def for_rig(cls, rig: StereoRig, *, nearest_m: float = 2.0) -> PatchMatcherSettings:
        """Settings that reach as near as `nearest_m` with a rectified rig."""
        reach_px = min(rig.left.fx_px * rig.baseline_m / nearest_m, rig.left.width_px / 2)
        return cls(max_disparity_px=math.ceil(reach_px))


class PatchMatcher:
    """Measures disparities box by box; keeps no state between calls."""

    def __init__(self, settings: PatchMatcherSettings | None = None) -> None:
        self._settings = settings or PatchMatcherSettings()

    def match(
        self, left: Image, right: Image, xyxy_px: FloatArray, prior_px: FloatArray
    ) -> tuple[FloatArray, FloatArray]:
        """Disparity and its standard deviation, (N,) pixels each, of boxes in the left image; NaN = not measured.

        Args:
            left: (H, W) grey or (H, W, 3) BGR uint8, rectified.
            right: the same size.
            xyxy_px: (N, 4) boxes; any values, also NaN and outside the image.
            prior_px: (N,) the disparity expected; NaN = none, and the full range is searched, as it is where the match
                does not lie near the prior.

        Raises:
            ValueError: the images differ in size.
        """
        if left.shape != right.shape:
            raise ValueError(f"left and right: equal shapes wanted, {left.shape} and {right.shape} got")
        disparity_px, sigma_px = np.full(len(xyxy_px), np.nan), np.full(len(xyxy_px), np.nan)
        image_hw = (left.shape[0], left.shape[1])
        patches = inner_halves(xyxy_px, image_hw, margin_px=MARGIN_PX, min_side_px=self._settings.min_side_px)
        for i, (patch, prior) in enumerate(zip(patches, prior_px.tolist(), strict=True)):
            if patch is not None:
                disparity_px[i], sigma_px[i] = self._measure(left, right, patch, prior)
        return disparity_px, sigma_px

    def _measure(self, left: Image, right: Image, patch: Patch, prior_px: float) -> tuple[float, float]:
        """One patch: near the prior if there is one, in the full range otherwise or when that fails."""
        keep = self._settings
        row_step = _row_step(patch, keep.max_pixels)
        n_pixels = patch.width_px * -(-patch.height_px // row_step)
        # One disparity more at both ends, so that each one that is searched has two neighbours.
        full = (keep.min_disparity_px - 1, keep.max_disparity_px + 1)
        for first, last in (*_near(prior_px, full, keep.search_px + 1), full):
            curves = cost_curves(left, right, patch, first_px=first, last_px=last, row_step=row_step)
            best = int(curves.whole.argmin())
            if _is_enclosed(curves.whole, best) and self._is_clear(curves, best, n_pixels):
                return self._refine(curves, best)
        return _NO_MATCH

    def _is_clear(self, curves: CostCurves, best: int, n_pixels: int) -> bool:
        """Whether the minimum is deep, and alone."""
        keep, cost = self._settings, curves.whole
        depth = float(np.percentile(cost[np.isfinite(cost)], _CHANCE_PERCENTILE) - cost[best])
        if depth < max(keep.min_depth_bits, keep.noise_bits / math.sqrt(n_pixels)):
            return False
        aside = 2 + (curves.first_px + best) // 20  # the nearer the object, the wider the valley that it makes itself
        rivals = np.concatenate([cost[: max(best - aside, 0)], cost[best + aside + 1 :]])
        return len(rivals) == 0 or bool(rivals.min() - cost[best] >= keep.min_rival_share * depth)

    def _refine(self, curves: CostCurves, best: int) -> tuple[float, float]:
        """Subpixel disparity, and sigma from how much the cells disagree about it."""
        keep, cost, cells = self._settings, curves.whole, curves.cells
        higher = best + 1 if cost[best + 1] > cost[best - 1] else best - 1
        slope = cost[higher] - cost[best]
        lean = cells[best - 1] - cells[best + 1]
        rise = cells[higher] - cells[best]
        known = np.isfinite(lean)
        if slope <= 0 or known.sum() < 3 or rise[known].sum() <= 0:
            return _NO_MATCH
        offset = (cost[best - 1] - cost[best + 1]) / (2 * slope)
        # Standard error of a ratio of sums over cells: offset = sum(lean) / (2 sum(rise)).
        residual = lean[known] - 2 * offset * rise[known]
        error = math.sqrt(float(residual @ residual) * len(residual) / (len(residual) - 1)) / (2 * rise[known].sum())
        shape = keep.shape_share * _cell_scatter_px(cells, best, keep.search_px)
        return curves.first_px + best + float(offset), math.hypot(keep.alignment_sigma_px, error, shape)


def _near(prior_px: float, full: tuple[int, int], reach_px: int) -> tuple[tuple[int, int], ...]:
    """The range about a prior inside the full one; none without a prior, or where it leaves too little."""
    if not full[0] <= prior_px <= full[1]:
        return ()
    centre = round(prior_px)
    return ((max(centre - reach_px, full[0]), min(centre + reach_px, full[1])),)


def _row_step(patch: Patch, max_pixels: int) -> int:
    """How many rows to go down for each one used; at least six rows stay."""
    wanted = -(-patch.width_px * patch.height_px // max_pixels)
    return max(1, min(wanted, patch.height_px // 6))


def _is_enclosed(cost: FloatArray, best: int) -> bool:
    """Whether the minimum has a neighbour on both sides that the right eye sees."""
    return 0 < best < len(cost) - 1 and bool(np.isfinite(cost[best - 1 : best + 2]).all())


def _cell_scatter_px(cells: FloatArray, best: int, reach_px: int) -> float:
    """Median distance, scaled to a standard deviation, of each cell's own minimum from the whole's."""
    start = max(best - reach_px, 0)
    around = cells[start : best + reach_px + 1]
    own = np.where(np.isfinite(around), around, np.inf).argmin(axis=0) + start
    return 1.4826 * float(np.median(np.abs(own - best)))
