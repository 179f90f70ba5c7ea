"""PatchMatcher: the disparity of each box from windows in its inner half, for all boxes of a frame at once.

    1. windows    a grid of windows in each box, in the image pyramid                     `sample_windows`
    2. costs      census costs of each window at each disparity                           `census`
    3. matches    semi-global matching between the windows of a box                       `window_sgm`
    4. subpixel   least squares on grey values, where a prior is near                     `subpixel`
    5. surface    the windows that belong to the object, and a plane through them         `plane_fit`
    6. checks     texture, uniqueness, search range, cost; sigma                          `confidence`

Boxes without a prior are first searched in the full range on a coarse grid, then around the result on the fine grid.

A doubtful match is NaN, with the reason: the minimum lies at the end of the search range, is shallow (no texture), has
a second best minimum of nearly the same cost (repeated texture), or costs nearly as much as a chance match (12 bits).
The best of many chance matches has some depth too. An object that is not near its prior is recognised by the cost and
by windows without a minimum; then the full range is searched.
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
from track_range.stereo.matching.confidence import match_confidence
from track_range.stereo.matching.patch_matches import Outcome, PatchMatches
from track_range.stereo.matching.plane_fit import Surface, object_surface
from track_range.stereo.matching.sample_windows import (
    COARSE_GRID,
    FINE_GRID,
    MARGIN_PX,
    WINDOW_HW,
    BoxWindows,
    GreyLevels,
    band_of,
)
from track_range.stereo.matching.subpixel import refine_windows
from track_range.stereo.matching.window_sgm import WindowMatches, match_windows


@dataclass(frozen=True, slots=True, kw_only=True)
class PatchMatcherSettings:
    """Search range, thresholds of the checks, and the parts of sigma.

    Attributes:
        min_disparity_px: smallest disparity of the full search.
        max_disparity_px: largest disparity; sets the nearest distance (192 px: 2 m with KITTI's rig).
        max_disparity_per_side: largest disparity per px of the box's larger side, baseline / smallest object, both in
            metres; inf = no limit.
        search_px: half width of the search around a prior, px of the box's level.
        min_side_px: smallest side of a box.
        min_seen_share: smallest fraction of the windows that must have a minimum, and lie within the right image.
        min_support: smallest fraction of those that must belong to one surface.
        min_margin_bits: minimum difference between the costs of a chance match and of the minimum, in bits of 24 per
            pixel.
        max_cost_bits: largest cost of the minimum; not checked for priors from the full search.
        min_minima_share: minimum fraction of the visible windows with a minimum near a track's prior: if the object is
            elsewhere, most minima lie at an end of the search range. Not checked for priors from the full search.
        min_confirmed_share: minimum fraction of those minima that are confirmed by grey values. Not checked for priors
            from the full search.
        uniqueness_ratio: minimum difference between the costs of the second best and the best minimum, as a fraction of
            the margin (OpenCV's uniquenessRatio is a fraction of the cost).
        floor_px: sigma of a flat, textured, noiseless box, px of its level.
        noise_share: fraction of the propagated variances of the windows that contributes to sigma.
        scatter_share: fraction of the windows' scatter about the plane that contributes to sigma.
        tilt_share: fraction of the plane's tilt across the box that contributes to sigma.
    """

    min_disparity_px: int = 1
    max_disparity_px: int = 192
    max_disparity_per_side: float = math.inf
    search_px: int = 8
    min_side_px: float = 8.0
    min_seen_share: float = 0.25
    min_support: float = 0.3
    min_margin_bits: float = 1.5
    max_cost_bits: float = 8.0
    min_minima_share: float = 0.5
    min_confirmed_share: float = 0.25
    uniqueness_ratio: float = 0.1
    floor_px: float = 0.03
    noise_share: float = 0.7
    scatter_share: float = 0.75
    tilt_share: float = 0.15

    @classmethod
    def for_rig(cls, rig: StereoRig, *, nearest_m: float = 2.0, smallest_m: float = 0.3) -> PatchMatcherSettings:
        """Settings for a rectified rig, for distances from `nearest_m` and objects of at least `smallest_m`, metres."""
        nearest_px = min(rig.left.fx_px * rig.baseline_m / nearest_m, rig.left.width_px / 2)
        return cls(max_disparity_px=math.ceil(nearest_px), max_disparity_per_side=rig.baseline_m / smallest_m)


class _Search(NamedTuple):
    """Costs of the windows of N boxes.

    Attributes:
        cost: (D, N, G) bits per pixel at the disparities first (N,) + k, px of the boxes' levels; NaN = outside the
            right image.
        first: (N,) disparity of index 0, px of the level.
        windows: the windows.
        prior_px: (N,) priors, px of the image; NaN = none.
        is_known: whether the priors are results of the full search in the same pair.
    """

    cost: FloatArray32
    first: IntArray
    windows: BoxWindows
    prior_px: FloatArray
    is_known: bool


class PatchMatcher:
    """Measures the disparities of boxes; stateless."""

    def __init__(self, settings: PatchMatcherSettings | None = None) -> None:
        self._settings = settings or PatchMatcherSettings()

    def match(self, left: Image, right: ImageView, xyxy_px: FloatArray, prior_px: FloatArray) -> PatchMatches:
        """The disparities of boxes in the left image, with the reasons of failures.

        Args:
            left: (H, W) grey or (H, W, 3) BGR uint8, rectified.
            right: rectified right image of equal size; only the pixels that the boxes need are read.
            xyxy_px: (N, 4) boxes; any values, including NaN and boxes outside the image.
            prior_px: (N,) expected disparity; NaN = none. Without a prior, or with a doubtful match near it, the full
                range is searched.

        Raises:
            ValueError: the images differ in size.
        """
        if left.shape[:2] != right.shape[:2]:
            raise ValueError(f"left and right: expected equal sizes, got {left.shape[:2]} and {right.shape[:2]}")
        boxes, outcome = self._usable(xyxy_px, (left.shape[0], left.shape[1]))
        matches = PatchMatches(np.full(len(boxes), np.nan), np.full(len(boxes), np.nan), outcome)
        is_usable = outcome == Outcome.MATCHED
        limit_px = self._limit_px(boxes)
        near = np.flatnonzero(is_usable & (prior_px >= self._settings.min_disparity_px) & (prior_px <= limit_px))
        if len(near):
            matches.put(near, self._search(left, right, boxes[near], prior_px[near], limit_px[near]))
        unmatched = np.flatnonzero(is_usable & np.isnan(matches.disparity_px))
        if len(unmatched):
            no_prior = np.full(len(unmatched), np.nan)
            matches.put(unmatched, self._search(left, right, boxes[unmatched], no_prior, limit_px[unmatched]))
            rows = unmatched[np.isfinite(matches.disparity_px[unmatched])]
            if len(rows):
                coarse_px = matches.disparity_px[rows]
                matches.put(rows, self._search(left, right, boxes[rows], coarse_px, limit_px[rows], is_known=True))
        return matches

    def _usable(self, xyxy_px: FloatArray, image_hw: tuple[int, int]) -> tuple[FloatArray, IntArray]:
        """Boxes (N, 4) clipped to the image, and (N,) outcomes: MATCHED for boxes that can be searched."""
        height, width = image_hw
        with np.errstate(invalid="ignore"):
            boxes = np.clip(xyxy_px, -0.5, np.array([width, height, width, height]) - 0.5)
            side_px = (boxes[:, 2:] - boxes[:, :2]).min(axis=1)
            is_outside = ~np.isfinite(xyxy_px).all(axis=1) | ~(side_px > 0)
        outcome = np.full(len(boxes), int(Outcome.MATCHED), np.int64)
        is_small_image = height < WINDOW_HW[0] + 2 * MARGIN_PX or width < WINDOW_HW[1] + 2 * MARGIN_PX
        outcome[(side_px < self._settings.min_side_px) | is_small_image] = Outcome.TOO_SMALL
        outcome[is_outside] = Outcome.OUTSIDE
        return boxes, outcome

    def _limit_px(self, boxes: FloatArray) -> FloatArray:
        """(N,) largest disparity of each box."""
        settings = self._settings
        if math.isinf(settings.max_disparity_per_side):
            return np.full(len(boxes), float(settings.max_disparity_px))
        side_px = (boxes[:, 2:] - boxes[:, :2]).max(axis=1)
        return np.asarray(np.minimum(side_px * settings.max_disparity_per_side, settings.max_disparity_px))

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
        """Matches of usable boxes: around priors on the fine grid, or (all NaN) in the full range on the coarse grid.

        Args:
            left: left image.
            right: right image.
            boxes: (N, 4) boxes inside the image.
            prior_px: (N,) priors, all finite or all NaN.
            limit_px: (N,) largest disparities.
            is_known: whether the priors are results of the full search in the same pair.
        """
        has_prior = bool(np.isfinite(prior_px).all())
        image_hw = (left.shape[0], left.shape[1])
        windows = BoxWindows.of_boxes(boxes, image_hw, grid=FINE_GRID if has_prior else COARSE_GRID)
        first, n_disparities = self._range(windows.scale, prior_px, limit_px)
        # Only the rows that the windows need are converted to grey and shrunk; window rows count from the first one.
        required = windows.required_pixels(first, first + n_disparities - 1, image_hw)
        n_levels = int(windows.level.max()) + 1
        top, bottom = int(required[:, 1].min()), int(required[:, 3].max())
        grey_left, grey_right = (
            GreyLevels.of(left[top:bottom], n_levels),
            GreyLevels.of(band_of(right, required), n_levels),
        )
        windows = replace(windows, row=windows.row - (top >> windows.level)[:, None])
        cost = cost_curves(grey_left, grey_right, windows, first=first, n_disparities=n_disparities)
        # All boxes have the range of the largest one; disparities beyond a box's limit are no matches.
        cost[first + np.arange(n_disparities)[:, None] > limit_px / windows.scale + 1] = np.nan
        matches = match_windows(cost)
        is_confirmed = matches.weight > 0
        if has_prior:
            matches, is_confirmed = refine_windows(grey_left, grey_right, windows, matches, first=first)
        return self._measure(_Search(cost, first, windows, prior_px, is_known), matches, is_confirmed)

    def _range(self, scale: FloatArray, prior_px: FloatArray, limit_px: FloatArray) -> tuple[IntArray, int]:
        """First disparity (N,) of each box, px of its level, and the number D, with one extra at both ends.

        In the full range the first may be -1, because a disparity of 1 px is about 0 in the shrunk image.
        """
        settings = self._settings
        lowest = np.floor(settings.min_disparity_px / scale).astype(np.int64) - 1
        if np.isfinite(prior_px).all():
            first = np.rint(prior_px / scale).astype(np.int64) - settings.search_px - 1
            return np.maximum(first, np.maximum(lowest, 0)), 2 * settings.search_px + 3
        n_disparities = int(np.ceil(limit_px / scale).max()) + 2 - int(lowest.min())
        return lowest, max(n_disparities, 2 * settings.search_px + 3)

    def _measure(self, search: _Search, matches: WindowMatches, is_confirmed: BoolArray) -> PatchMatches:
        """Surfaces, checks and sigmas of the boxes; the last check that fails determines the outcome."""
        settings, (cost, first, windows, prior_px, is_known) = self._settings, search
        disparity = np.maximum(first[:, None] + matches.index + matches.offset, 0.1)
        positions, prior = windows.normalized_positions(), prior_px / windows.scale
        surface = object_surface(disparity, matches.weight, positions=positions, prior=prior)
        confidence = match_confidence(cost, surface, windows, first)
        minima_share = (matches.weight > 0).mean(axis=1)
        seen_share = np.isfinite(cost).any(axis=0).mean(axis=1)

        outcome = np.full(len(first), int(Outcome.MATCHED), np.int64)
        is_unique = confidence.second_best_margin >= settings.uniqueness_ratio * confidence.margin
        outcome[~is_unique | (surface.support < settings.min_support)] = Outcome.AMBIGUOUS
        outcome[~confidence.is_inside] = Outcome.OUT_OF_RANGE
        outcome[~(confidence.margin >= settings.min_margin_bits) | np.isnan(surface.centre)] = Outcome.NO_TEXTURE
        if not is_known:
            is_elsewhere = minima_share < settings.min_minima_share * seen_share
            is_elsewhere |= is_confirmed.mean(axis=1) < settings.min_confirmed_share * minima_share
            is_elsewhere &= np.isfinite(prior_px)
            is_costly = confidence.cost > settings.max_cost_bits
            outcome[np.isfinite(confidence.cost) & (is_elsewhere | is_costly)] = Outcome.NO_FIT
        outcome[minima_share < settings.min_seen_share] = Outcome.NO_TEXTURE
        outcome[seen_share < settings.min_seen_share] = Outcome.NOT_SEEN

        is_matched = outcome == Outcome.MATCHED
        sigma_px = windows.scale * self._sigma(surface, matches.weight, windows)
        disparity_px = np.where(is_matched, windows.scale * surface.centre, np.nan)
        return PatchMatches(disparity_px, np.where(is_matched, sigma_px, np.nan), outcome)

    def _sigma(self, surface: Surface, weight: FloatArray, windows: BoxWindows) -> FloatArray:
        """(N,) standard deviation of p0, px of the boxes' levels; weight (N, G) = 1 / variance of the windows.

        sigma^2 = floor^2 + (noise_share noise)^2 + (scatter_share scatter)^2 + (tilt_share (|p1| + |p2|))^2

            noise^2 = G / (G_independent sum of weight)
            scatter = 1.25 mean |residual|          mean absolute deviation -> standard deviation

        Windows that overlap share pixels: G_independent is the number of windows that fit side by side.
        """
        settings = self._settings
        is_inlier = np.isfinite(surface.residual)
        total = np.maximum(np.where(is_inlier, weight, 0.0).sum(axis=1), 1e-6)
        n_independent = windows.n_pixels / (WINDOW_HW[0] * WINDOW_HW[1])
        noise = np.sqrt(weight.shape[1] / (n_independent * total))
        deviation = np.where(is_inlier, np.abs(surface.residual), 0.0).sum(axis=1)
        scatter = 1.25 * deviation / np.maximum(is_inlier.sum(axis=1), 1)
        tilt = np.abs(surface.tilt).sum(axis=1)
        parts = (settings.noise_share * noise, settings.scatter_share * scatter, settings.tilt_share * tilt)
        return np.sqrt(settings.floor_px**2 + sum((part**2 for part in parts), np.zeros(len(tilt))))
