"""PatchMatcher: the disparity of each box, from the windows in its inner half, all boxes of a frame at once.

    windows (`box_windows`) -> costs at each disparity (`census`) -> between pixels (`refinement`)
    -> the object's surface (`surfaces`) -> is it clear (`clarity`)?

It rather says NaN, with the reason, than a wrong number: where the windows' common minimum lies at the end of the
range, is not deep (no texture), has a rival of nearly the same depth (repeated texture), or costs nearly as much as a
match by chance (12 bits). The best of many chance matches has some depth too: that the object is not near its prior
shows in the cost, and in windows without a minimum; then the full range is searched.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from typing import NamedTuple

import numpy as np

from track_range.foundation.arrays import BoolArray, FloatArray, FloatArray32, Image, IntArray
from track_range.stereo.geometry.frames import ImageView
from track_range.stereo.geometry.rig import StereoRig
from track_range.stereo.matching.census import cost_curves
from track_range.stereo.matching.confidence import clarity_of
from track_range.stereo.matching.patch_matches import Outcome, PatchMatches
from track_range.stereo.matching.sample_windows import COARSE, FINE, WINDOW_HW, BoxWindows, GreyLevels, band_of
from track_range.stereo.matching.subpixel import refined_windows
from track_range.stereo.matching.surfaces import Surface, WindowMatches, matched_windows, object_surface


@dataclass(frozen=True, slots=True, kw_only=True)
class PatchMatcherSettings:
    """What the matcher searches, and what it refuses.

    Attributes:
        min_disparity_px: smallest disparity that is searched.
        max_disparity_px: largest; sets the nearest distance (192 px: 2 m with KITTI's rig).
        max_disparity_per_side: largest disparity per px of the box's larger side, baseline / smallest object, both in
            metres; inf = no limit.
        search_px: half width of the search about a prior, px of the box's level.
        min_side_px: smallest side of a box.
        min_seen_share: share of the windows that must have a minimum that the right eye sees.
        min_support: share of those that must belong to one surface.
        min_depth_bits: least depth of the minimum below the cost of a chance match, in bits of 24 per pixel.
        max_cost_bits: largest cost of the minimum; not asked near what the full range has shown already.
        min_minima_share: share of the windows seen that must have a minimum near a track's prior: where the object is
            elsewhere, most have theirs at an end of the search. As above.
        min_sure_share: share of those minima that grey values must confirm. As above.
        min_rival_share: cost of the next best minimum above the best one, as a share of the depth.
        floor_px: error of a flat, textured, noiseless box, px of its level.
        noise_share: share of what the windows' own variances leave that goes into sigma.
        scatter_share: the same of the windows' scatter about the plane.
        tilt_share: the same of the plane's tilt across the box.
    """

    min_disparity_px: int = 1
    max_disparity_px: int = 192
    max_disparity_per_side: float = math.inf
    search_px: int = 8
    min_side_px: float = 8.0
    min_seen_share: float = 0.25
    min_support: float = 0.3
    min_depth_bits: float = 1.5
    max_cost_bits: float = 8.0
    min_minima_share: float = 0.5
    min_sure_share: float = 0.25
    min_rival_share: float = 0.1
    floor_px: float = 0.03
    noise_share: float = 0.7
    scatter_share: float = 0.75
    tilt_share: float = 0.15

    @classmethod
    def for_rig(cls, rig: StereoRig, *, nearest_m: float = 2.0, smallest_m: float = 0.3) -> PatchMatcherSettings:
        """Settings for a rectified rig that reach as near as `nearest_m`, for objects no smaller than `smallest_m`."""
        reach_px = min(rig.left.fx_px * rig.baseline_m / nearest_m, rig.left.width_px / 2)
        return cls(max_disparity_px=math.ceil(reach_px), max_disparity_per_side=rig.baseline_m / smallest_m)


class _Search(NamedTuple):
    """Costs (D, N, G) at the disparities first (N,) + k of N boxes' windows, px of their levels; priors (N,) px."""

    cost: FloatArray32
    first: IntArray
    windows: BoxWindows
    prior_px: FloatArray


class PatchMatcher:
    """Measures disparities of boxes; keeps no state between calls."""

    def __init__(self, settings: PatchMatcherSettings | None = None) -> None:
        self._settings = settings or PatchMatcherSettings()

    def match(self, left: Image, right: ImageView, xyxy_px: FloatArray, prior_px: FloatArray) -> PatchMatches:
        """The disparities of boxes in the left image, and why some have none.

        Args:
            left: (H, W) grey or (H, W, 3) BGR uint8, rectified.
            right: the same height and width; only what the boxes need of it is looked at.
            xyxy_px: (N, 4) boxes; any values, also NaN and outside the image.
            prior_px: (N,) the disparity expected; NaN = none, and the full range is searched, as it is where the match
                near the prior is not clear.

        Raises:
            ValueError: the images differ in size.
        """
        if left.shape[:2] != right.shape[:2]:
            raise ValueError(f"left and right: equal sizes wanted, {left.shape[:2]} and {right.shape[:2]} got")
        boxes, outcome = self._usable(xyxy_px, (left.shape[0], left.shape[1]))
        found = PatchMatches(np.full(len(boxes), np.nan), np.full(len(boxes), np.nan), outcome)
        todo = outcome == Outcome.MATCHED
        limit_px = self._limit_px(boxes)
        near = np.flatnonzero(todo & (prior_px >= self._settings.min_disparity_px) & (prior_px <= limit_px))
        if len(near):
            found.put(near, self._search(left, right, boxes[near], prior_px[near], limit_px[near]))
        lost = np.flatnonzero(todo & np.isnan(found.disparity_px))
        if len(lost):
            nothing = np.full(len(lost), np.nan)
            found.put(lost, self._search(left, right, boxes[lost], nothing, limit_px[lost]))
            again = lost[np.isfinite(found.disparity_px[lost])]
            if len(again):
                coarse_px = found.disparity_px[again]
                found.put(again, self._search(left, right, boxes[again], coarse_px, limit_px[again], is_known=True))
        return found

    def _usable(self, xyxy_px: FloatArray, image_hw: tuple[int, int]) -> tuple[FloatArray, IntArray]:
        """Boxes cut to the image, and which of them can be looked at."""
        height, width = image_hw
        with np.errstate(invalid="ignore"):
            boxes = np.clip(xyxy_px, -0.5, np.array([width, height, width, height]) - 0.5)
            side_px = (boxes[:, 2:] - boxes[:, :2]).min(axis=1)
            outside = ~np.isfinite(xyxy_px).all(axis=1) | ~(side_px > 0)
        outcome = np.full(len(boxes), int(Outcome.MATCHED), np.int64)
        outcome[(side_px < self._settings.min_side_px) | (height < WINDOW_HW[0] + 4) | (width < WINDOW_HW[1] + 4)] = (
            Outcome.TOO_SMALL
        )
        outcome[outside] = Outcome.OUTSIDE
        return boxes, outcome

    def _limit_px(self, boxes: FloatArray) -> FloatArray:
        """(N,) largest disparity that is searched for each box."""
        keep = self._settings
        if math.isinf(keep.max_disparity_per_side):
            return np.full(len(boxes), float(keep.max_disparity_px))
        side_px = (boxes[:, 2:] - boxes[:, :2]).max(axis=1)
        return np.asarray(np.minimum(side_px * keep.max_disparity_per_side, keep.max_disparity_px))

    def _search(
        self,
        left: Image,
        right: ImageView,
        boxes: FloatArray,
        prior_px: FloatArray,
        limit_px: FloatArray,
        *,
        is_known: bool = False,
    ) -> PatchMatches:
        """Boxes that can be looked at, all about their priors or all (NaN) over the full range.

        is_known: the priors were found in this very pair.
        """
        is_near = bool(np.isfinite(prior_px).all())
        windows = BoxWindows.of_boxes(boxes, (left.shape[0], left.shape[1]), look=FINE if is_near else COARSE)
        first, n_disparities = self._range(windows.scale, prior_px, limit_px)
        reach = windows.reach(first, first + n_disparities - 1, (left.shape[0], left.shape[1]))
        n_levels = int(windows.level.max()) + 1
        top = int(reach[:, 1].min())
        eyes = (
            GreyLevels.of(left[top : int(reach[:, 3].max())], n_levels),
            GreyLevels.of(band_of(right, reach), n_levels),
        )
        windows = replace(windows, row=windows.row - (top >> windows.level)[:, None])
        cost = cost_curves(*eyes, windows, first=first, n_disparities=n_disparities)
        beyond = first + np.arange(n_disparities)[:, None] > limit_px / windows.scale + 1
        cost[beyond] = np.nan  # the range is the largest box's
        found = matched_windows(cost)
        is_sure = found.weight > 0
        if is_near:
            found, is_sure = refined_windows(*eyes, windows, found, first=first)
        return self._measured(_Search(cost, first, windows, prior_px), found, is_sure, is_known=is_known)

    def _range(self, scale: FloatArray, prior_px: FloatArray, limit_px: FloatArray) -> tuple[IntArray, int]:
        """First disparity (N,) of each box at its level, and how many; one more at both ends than is searched.

        In the full range the first may be -1: a disparity of 1 px is about 0 in the shrunk image that finds it.
        """
        keep = self._settings
        lowest = np.floor(keep.min_disparity_px / scale).astype(np.int64) - 1
        if np.isfinite(prior_px).all():
            first = np.rint(prior_px / scale).astype(np.int64) - keep.search_px - 1
            return np.maximum(first, np.maximum(lowest, 0)), 2 * keep.search_px + 3
        n_disparities = int(np.ceil(limit_px / scale).max()) + 2 - int(lowest.min())
        return lowest, max(n_disparities, 2 * keep.search_px + 3)

    def _measured(self, search: _Search, found: WindowMatches, is_sure: BoolArray, *, is_known: bool) -> PatchMatches:
        keep, (cost, first, windows, prior_px) = self._settings, search
        disparity = np.maximum(first[:, None] + found.index + found.offset, 0.1)
        surface = object_surface(disparity, found.weight, places=windows.places(), prior=prior_px / windows.scale)
        outcome = np.full(len(first), int(Outcome.MATCHED), np.int64)
        clear = clarity_of(cost, surface, windows, first)
        is_alone = clear.rival >= keep.min_rival_share * clear.depth
        outcome[~is_alone | (surface.support < keep.min_support)] = Outcome.AMBIGUOUS
        outcome[~clear.is_inside] = Outcome.OUT_OF_RANGE
        outcome[~(clear.depth >= keep.min_depth_bits) | np.isnan(surface.centre)] = Outcome.NO_TEXTURE
        minima, seen = (found.weight > 0).mean(axis=1), np.isfinite(cost).any(axis=0).mean(axis=1)
        if not is_known:
            few_sure = is_sure.mean(axis=1) < keep.min_sure_share * minima
            elsewhere = (minima < keep.min_minima_share * seen) | few_sure
            elsewhere &= np.isfinite(prior_px)
            outcome[np.isfinite(clear.cost) & (elsewhere | (clear.cost > keep.max_cost_bits))] = Outcome.NO_FIT
        outcome[minima < keep.min_seen_share] = Outcome.NO_TEXTURE
        outcome[seen < keep.min_seen_share] = Outcome.NOT_SEEN
        sigma_px = windows.scale * self._sigma(surface, found.weight, windows)
        matched = outcome == Outcome.MATCHED
        disparity_px = np.where(matched, windows.scale * surface.centre, np.nan)
        return PatchMatches(disparity_px, np.where(matched, sigma_px, np.nan), outcome)

    def _sigma(self, surface: Surface, weight: FloatArray, windows: BoxWindows) -> FloatArray:
        """(N,) standard deviation at the boxes' levels, from the windows' weights, 1 / variance."""
        keep = self._settings
        belongs = np.isfinite(surface.residual)
        total = np.maximum(np.where(belongs, weight, 0.0).sum(axis=1), 1e-6)
        # Windows that overlap see the same pixels: they count as if there were as many as fit side by side.
        n_apart = windows.n_pixels / (WINDOW_HW[0] * WINDOW_HW[1])
        noise = np.sqrt(weight.shape[1] / (n_apart * total))
        spread = np.where(belongs, np.abs(surface.residual), 0.0).sum(axis=1)
        scatter = 1.25 * spread / np.maximum(belongs.sum(axis=1), 1)  # mean absolute deviation -> standard deviation
        tilt = np.abs(surface.tilt).sum(axis=1)
        parts = (keep.noise_share * noise, keep.scatter_share * scatter, keep.tilt_share * tilt)
        return np.sqrt(keep.floor_px**2 + sum((part**2 for part in parts), np.zeros(len(tilt))))
