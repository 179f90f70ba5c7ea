"""PatchMatcher: the disparity of each box from windows inside it, for all boxes of a frame at once.

    1. tiles      each box, and the strip of the right image it may match, at one size     `tiles`
    2. costs      census costs of the windows at each disparity                            `window_matches`
    3. matches    semi-global matching between the windows of a box                        `window_matches`
    4. surfaces   groups of windows on a plane: the object, occluders, background          `surfaces`
    5. choice     the probability of each surface to be the object                         `surface_choice`
    6. subpixel   least squares on grey values, and the surface through the windows        `subpixel`, `surfaces`
    7. checks     texture, uniqueness, search range, cost; sigma                           `confidence`

The range of disparities lies about the last match of the box's track; else about the disparity
expected from the object's size; else it is the full range, first on coarse tiles and then, about
the result, on fine tiles. The full range is also searched where the other two give no match.

A doubtful match is NaN, with the reason: the minimum lies at the end of the search range, is
shallow (no texture), has a second best minimum of nearly the same cost (repeated texture), or costs
nearly as much as a chance match (12 bits). The best of many chance matches has some depth too. An
object that is not near its prior is recognised by the cost and by windows without a minimum.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from scipy.special import ndtri

from track_range.foundation.arrays import BoolArray, FloatArray, FloatArray32, Image, IntArray
from track_range.stereo.geometry.frames import ImageView
from track_range.stereo.geometry.rig import StereoRig
from track_range.stereo.matching.confidence import match_confidence
from track_range.stereo.matching.patch_matches import ExpectedDisparity, Outcome, PatchMatches
from track_range.stereo.matching.subpixel import RefinedSurface, refine_surface
from track_range.stereo.matching.surface_choice import (
    OtherBoxes,
    SurfaceChoice,
    are_behind,
    choose_surface,
    features,
)
from track_range.stereo.matching.surfaces import SurfaceFit, Surfaces, find_surfaces, window_weights
from track_range.stereo.matching.tiles import (
    COARSE,
    FINE,
    MIN_IMAGE_HW,
    BoxTiles,
    box_tiles,
    tile_scale,
)
from track_range.stereo.matching.window_matches import WindowMatches, match_windows, window_costs

# largest deviation of an expected disparity from that by size, in standard deviations
_EXPECTED_SIGMAS = 2.0
_MIN_EXPECTED_LOG_SIGMA = 0.1  # smallest of these
# minimum support at the expected disparity: three of 49 windows, such as between bars
_EXPECTED_SUPPORT = 0.06
# cost by which a surface at the expected disparity may exceed the limit, bits per pixel
_EXPECTED_COST_BITS = 2.0
_OUTSIDE = 0.05  # probability outside of two sigma
# standard deviation of the log disparity of an object of unknown size that its box does not show
_UNKNOWN_LOG_SIGMA = 0.5


@dataclass(frozen=True, slots=True, kw_only=True)
class PatchMatcherSettings:
    """Search range, thresholds of the checks, and the parts of sigma."""

    min_disparity_px: int = 1  # smallest disparity of the full search
    # largest disparity; sets the nearest distance (192 px: 2 m with KITTI's rig)
    max_disparity_px: int = 192
    # largest disparity per px of the box's larger side, baseline / smallest object, both in metres;
    # inf = no limit
    max_disparity_per_side: float = math.inf
    search_px: int = 8  # half width of the search around the last match of a track, px of the tile
    # half width of the search around the disparity expected from the size, px of the tile
    size_search_px: int = 16
    min_side_px: float = 8.0  # smallest side of a box
    # smallest fraction of the windows that must have a minimum, and lie within the right image
    min_seen_fraction: float = 0.25
    min_support: float = 0.15  # smallest fraction of those that must belong to the object's surface
    min_probability: float = 0.4  # smallest probability of the surface to be the object
    # minimum difference between the costs of a chance match and of the minimum, in bits of 24 per
    # pixel
    min_margin_bits: float = 1.5
    # largest cost of the minimum; not checked for priors from the full search
    max_cost_bits: float = 8.0
    # minimum fraction of the visible windows with a minimum near a track's prior: if the object is
    # elsewhere, most minima lie at an end of the search range. Not checked for priors from the full
    # search.
    min_minima_fraction: float = 0.5
    # minimum fraction of those minima that are confirmed by grey values. Not checked for priors
    # from the full search.
    min_confirmed_fraction: float = 0.25
    # minimum difference between the costs of the second best and the best minimum, as a fraction of
    # the margin (OpenCV's uniquenessRatio is a fraction of the cost)
    uniqueness_ratio: float = 0.12
    floor_px: float = 0.1  # sigma of a flat, textured, noiseless box, px of its tile
    # the same as a fraction of the disparity: objects are not smooth surfaces
    floor_fraction: float = 0.008
    # fraction of the propagated variances of the windows that contributes to sigma
    noise_fraction: float = 0.5
    # fraction of the windows' scatter about the surface that contributes to sigma
    scatter_fraction: float = 0.6
    # fraction of the surface's tilt across the box that contributes to sigma
    tilt_fraction: float = 0.12

    @classmethod
    def for_rig(
        cls, rig: StereoRig, *, nearest_m: float = 2.0, smallest_m: float = 0.3
    ) -> PatchMatcherSettings:
        """Settings for a rectified rig, for distances from `nearest_m` and objects of at least
        `smallest_m`, metres.
        """
        nearest_px = min(rig.left.fx_px * rig.baseline_m / nearest_m, rig.left.width_px / 2)
        return cls(
            max_disparity_px=math.ceil(nearest_px),
            max_disparity_per_side=rig.baseline_m / smallest_m,
        )


class KnownBoxes(NamedTuple):
    """What is known of N boxes before the search."""

    xyxy_px: FloatArray  # (N, 4) boxes inside the image
    track_px: FloatArray  # (N,) last match of the track; NaN = none
    by_size: ExpectedDisparity  # expected disparities from the size
    limit_px: FloatArray  # (N,) largest disparity
    others: OtherBoxes  # all boxes of the frame, these included

    def select(self, rows: IntArray) -> KnownBoxes:
        """The boxes in rows (M,)."""
        xyxy_px, track_px, by_size, limit_px, others = self
        return KnownBoxes(
            xyxy_px[rows], track_px[rows], by_size.select(rows), limit_px[rows], others
        )


class SurfaceSearch(NamedTuple):
    """The surfaces of N boxes in a range of disparities."""

    tiles: BoxTiles
    cost: FloatArray32  # (D, G, N) costs of the windows
    matches: WindowMatches
    weight: FloatArray  # (N, G) weights of the windows
    surfaces: Surfaces
    phi: FloatArray  # (F, S, N) features of the surfaces, in the order of THETA
    choice: SurfaceChoice  # their probabilities

    @property
    def disparity_px(self) -> FloatArray:
        """(S, N) disparities of the surfaces at the boxes' centres, px of the image; NaN = no
        surface.
        """
        return self.tiles.disparity_px(self.surfaces.centre.T).T

    @property
    def chosen(self) -> tuple[BoolArray, SurfaceFit]:
        """Windows (N, G) and planes of the chosen surfaces."""
        chosen, rows = self.choice.chosen, np.arange(len(self.choice.chosen))
        return self.surfaces.is_member[chosen, rows], SurfaceFit(
            self.surfaces.planes.p[chosen, rows]
        )


def _sigma_of_none(
    disparity_px: FloatArray, none: FloatArray, by_size: ExpectedDisparity
) -> FloatArray:
    """(N,) standard deviation because none of the surfaces may be the object, px: half the radius
    about the disparity that holds 95 %, if the object then has the disparity of its size.
    """
    is_known = np.isfinite(by_size.disparity_px)
    expected_px = np.where(is_known, by_size.disparity_px, disparity_px)
    log_sigma = np.where(
        is_known, np.hypot(by_size.log_sigma, _MIN_EXPECTED_LOG_SIGMA), _UNKNOWN_LOG_SIGMA
    )
    # as a fraction of `none`; from 1 on, the rest holds 95 %
    outside = np.minimum(_OUTSIDE / np.maximum(none, _OUTSIDE), 1.0 - 1e-9)
    radius_px = np.abs(expected_px - disparity_px) + log_sigma * expected_px * ndtri(1.0 - outside)
    return np.where(none > _OUTSIDE, np.maximum(radius_px, 0.0) / 2, 0.0)


def _others(xyxy_px: FloatArray, matches: PatchMatches, size_px: FloatArray) -> OtherBoxes:
    """All boxes with their disparities as measured so far, else by size."""
    is_measured = np.isfinite(matches.disparity_px)
    return OtherBoxes(xyxy_px, np.where(is_measured, matches.disparity_px, size_px))


class PatchMatcher:
    """Measures the disparities of boxes; stateless."""

    def __init__(self, settings: PatchMatcherSettings | None = None) -> None:
        self._settings = settings or PatchMatcherSettings()

    def match(
        self,
        left: Image,
        right: ImageView,
        xyxy_px: FloatArray,
        prior_px: FloatArray,
        by_size: ExpectedDisparity | None = None,
    ) -> PatchMatches:
        """See `BoxMatcher.match`; images are rectified and of equal size; boxes may be NaN or
        outside the image.

        Without a prior or a clear match near it, the disparities near that of the size `by_size`,
        then all disparities are searched. Only the needed pixels of the right image are read.
        ValueError: the images differ in size.
        """
        if left.shape[:2] != right.shape[:2]:
            raise ValueError(
                f"left and right: expected equal sizes, got {left.shape[:2]} and {right.shape[:2]}"
            )
        boxes, limit_px, outcome = self._usable(xyxy_px, (left.shape[0], left.shape[1]))
        n = len(boxes)
        matches = PatchMatches.of(np.full(n, np.nan), np.full(n, np.nan), outcome)
        track_px = self._in_range(prior_px, limit_px)
        expected = by_size or ExpectedDisparity.unknown(n)
        size_px = self._in_range(expected.disparity_px, limit_px)
        others = OtherBoxes(boxes, np.where(np.isfinite(track_px), track_px, size_px))
        known = KnownBoxes(boxes, track_px, expected, limit_px, others)
        no_match = outcome == Outcome.MATCHED
        images, search_px = (left, right), self._settings.search_px
        rows = np.flatnonzero(no_match & np.isfinite(track_px))
        if len(rows):
            matches.put(
                rows, self._measured_near(*images, known.select(rows), track_px[rows], search_px)
            )
            no_match &= np.isnan(matches.disparity_px)
        if not no_match.any():
            return matches
        no_track = known._replace(track_px=np.full(n, np.nan))
        # Boxes that nearer ones cover come last: their occluders then have disparities.
        is_behind = are_behind(boxes)
        for is_part in (~is_behind, is_behind):
            rows = np.flatnonzero(no_match & is_part & np.isfinite(size_px))
            if len(rows):
                seen = no_track._replace(others=_others(boxes, matches, size_px)).select(rows)
                matches.put(
                    rows,
                    self._measured_near(
                        *images, seen, size_px[rows], self._settings.size_search_px
                    ),
                )
        no_track = no_track._replace(others=_others(boxes, matches, size_px))
        rows = np.flatnonzero(no_match & np.isnan(matches.disparity_px))
        if len(rows):
            coarse = self._full_range(*images, no_track.select(rows))
            matches.put(rows, coarse)
            has_match = np.isfinite(coarse.disparity_px)
            rows, coarse_px = rows[has_match], coarse.disparity_px[has_match]
            if len(rows):
                part = no_track.select(rows)
                matches.put(
                    rows, self._measured_near(*images, part, coarse_px, search_px, is_known=True)
                )
        return matches

    def _usable(
        self, xyxy_px: FloatArray, image_hw: tuple[int, int]
    ) -> tuple[FloatArray, FloatArray, IntArray]:
        """Boxes (N, 4) in the image, (N,) their largest disparities, (N,) outcomes: MATCHED if it
        can be searched.
        """
        settings, (height, width) = self._settings, image_hw
        with np.errstate(invalid="ignore"):
            boxes = np.clip(xyxy_px, -0.5, np.array([width, height, width, height]) - 0.5)
            size_px = boxes[:, 2:] - boxes[:, :2]
            side_px = size_px.min(axis=1)
            is_outside = ~np.isfinite(xyxy_px).all(axis=1) | ~(side_px > 0)
        outcome = np.full(len(boxes), int(Outcome.MATCHED), np.int64)
        is_small_image = height < MIN_IMAGE_HW[0] or width < MIN_IMAGE_HW[1]
        outcome[(side_px < settings.min_side_px) | is_small_image] = Outcome.TOO_SMALL
        outcome[is_outside] = Outcome.OUTSIDE
        limit_px = np.full(len(boxes), float(settings.max_disparity_px))
        if math.isfinite(settings.max_disparity_per_side):
            limit_px = np.minimum(size_px.max(axis=1) * settings.max_disparity_per_side, limit_px)
        return boxes, limit_px, outcome

    def _in_range(self, disparity_px: FloatArray, limit_px: FloatArray) -> FloatArray:
        """(N,) disparities inside the range of each box; NaN elsewhere."""
        is_inside = (disparity_px >= self._settings.min_disparity_px) & (disparity_px <= limit_px)
        return np.where(is_inside, disparity_px, np.nan)

    def search_near(
        self,
        left: Image,
        right: ImageView,
        known: KnownBoxes,
        centre_px: FloatArray,
        search_px: int,
    ) -> SurfaceSearch:
        """The surfaces of boxes within `search_px` px of their tiles of disparities (N,)."""
        scale = tile_scale(known.xyxy_px, FINE)
        first_px = np.maximum(
            centre_px - search_px * scale[0], self._settings.min_disparity_px - scale[0]
        )
        tiles = box_tiles(
            left, right, known.xyxy_px, first_px, 2 * search_px + 1, FINE, scale=scale
        )
        return self._search(tiles, known)

    def _measured_near(
        self,
        left: Image,
        right: ImageView,
        known: KnownBoxes,
        centre_px: FloatArray,
        search_px: int,
        *,
        is_known: bool = False,
    ) -> PatchMatches:
        """Matches of boxes near disparities (N,); is_known = these are results of the full search
        in the same pair.
        """
        search = self.search_near(left, right, known, centre_px, search_px)
        members, plane = search.chosen
        refined = refine_surface(search.tiles, search.matches.index, members, plane)
        return self._checked(search, refined, known, is_known=is_known)

    def search_full_range(self, left: Image, right: ImageView, known: KnownBoxes) -> SurfaceSearch:
        """The surfaces of boxes in the full range, on coarse tiles."""
        settings = self._settings
        scale = tile_scale(known.xyxy_px, COARSE)
        first_px = settings.min_disparity_px - scale[0]
        n_steps = int(np.ceil((known.limit_px - first_px) / scale[0]).max()) + 3
        n_disparities = max(n_steps, 2 * settings.search_px) + 1
        tiles = box_tiles(left, right, known.xyxy_px, first_px, n_disparities, COARSE, scale=scale)
        return self._search(tiles, known)

    def _full_range(self, left: Image, right: ImageView, known: KnownBoxes) -> PatchMatches:
        """Matches of boxes by a search over the full range, on coarse tiles without fractions of a
        pixel.
        """
        search = self.search_full_range(left, right, known)
        members, plane = search.chosen
        residual = np.where(
            members, search.matches.index - plane.at(search.tiles.u, search.tiles.v), np.nan
        )
        coarse = RefinedSurface(plane, residual, np.where(members, 1.0, 0.0), members)
        return self._checked(search, coarse, known, is_known=False)

    def _search(self, tiles: BoxTiles, known: KnownBoxes) -> SurfaceSearch:
        """Windows and surfaces of boxes at the disparities of their tiles."""
        cost = window_costs(tiles)
        # All boxes have the range of the largest one; disparities beyond a box's limits are no
        # matches.
        disparity = tiles.first + np.arange(tiles.n_disparities)[:, None]
        beyond = disparity > known.limit_px / tiles.scale[0] + 2
        if beyond.any():
            cost[np.broadcast_to(beyond[:, None], cost.shape)] = np.nan
        matches = match_windows(cost)
        weight = window_weights(matches, tiles)
        surfaces = find_surfaces(matches.index, weight, tiles)
        expected_px = np.where(
            np.isfinite(known.track_px), known.track_px, known.by_size.disparity_px
        )
        others = known.others.windows(
            known.xyxy_px, expected_px, tiles, tiles.disparity_px(matches.index)
        )
        phi = features(
            surfaces,
            tiles,
            matches.cost,
            by_size=known.by_size,
            track_px=known.track_px,
            others_fraction=others,
        )
        return SurfaceSearch(
            tiles, cost, matches, weight, surfaces, phi, choose_surface(phi, surfaces)
        )

    def _checked(
        self, search: SurfaceSearch, surface: RefinedSurface, known: KnownBoxes, *, is_known: bool
    ) -> PatchMatches:
        """Checks and sigmas of the boxes; the first check of the table that fails determines the
        outcome.
        """
        settings, tiles, cost, choice = self._settings, search.tiles, search.cost, search.choice
        confidence = match_confidence(cost, surface, tiles)
        is_used = tiles.is_used
        counts = np.array(
            [
                is_used,
                (search.matches.slope > 0) & is_used,
                np.isfinite(cost).any(axis=0).T & is_used,
                np.isfinite(surface.residual),
                surface.is_confirmed,
            ]
        ).sum(axis=2)
        n_used = np.maximum(counts[0], 1)
        minima_fraction, seen_fraction, support, confirmed_fraction = counts[1:] / n_used
        rows = np.arange(len(n_used))
        probability = choice.probability[choice.chosen, rows]

        disparity_px = tiles.disparity_px(surface.fit.p[:, 0])
        # A surface at the distance that the object's size lets expect needs less support from the
        # images.
        log_sigma = np.hypot(known.by_size.log_sigma, _MIN_EXPECTED_LOG_SIGMA)
        with np.errstate(invalid="ignore", divide="ignore"):
            deviation = np.abs(np.log(disparity_px / known.by_size.disparity_px))
        is_expected = deviation < _EXPECTED_SIGMAS * log_sigma  # False where the size is unknown
        support_limit = (
            np.where(is_expected, _EXPECTED_SUPPORT, settings.min_support) * seen_fraction
        )
        cost_limit = settings.max_cost_bits + np.where(is_expected, _EXPECTED_COST_BITS, 0.0)

        is_elsewhere = minima_fraction < settings.min_minima_fraction * seen_fraction
        is_elsewhere |= confirmed_fraction < settings.min_confirmed_fraction * support
        is_elsewhere &= ~is_expected & (tiles.shape == FINE)
        is_misfit = (
            np.isfinite(confidence.cost)
            & (is_elsewhere | (confidence.cost > cost_limit))
            & (not is_known)
        )
        is_unique = confidence.second_best_margin >= settings.uniqueness_ratio * confidence.margin
        is_certain = probability >= settings.min_probability
        checks = (
            (Outcome.NOT_SEEN, seen_fraction < settings.min_seen_fraction),
            (Outcome.NO_TEXTURE, minima_fraction < settings.min_seen_fraction),
            (Outcome.NO_FIT, is_misfit),
            (Outcome.NO_TEXTURE, ~(confidence.margin >= settings.min_margin_bits) | (support == 0)),
            (Outcome.OUT_OF_RANGE, ~confidence.is_inside),
            (
                Outcome.AMBIGUOUS,
                ~(is_unique | is_expected) | ~is_certain | (support < support_limit),
            ),
            (Outcome.OUT_OF_RANGE, ~(disparity_px > 0)),
        )
        outcome = np.full(len(rows), int(Outcome.MATCHED), np.int64)
        for reason, has_failed in checks[::-1]:
            outcome[has_failed] = reason
        is_matched = outcome == Outcome.MATCHED
        sigma_px = np.hypot(
            tiles.scale[0] * self._sigma(search, surface),
            _sigma_of_none(disparity_px, choice.none, known.by_size),
        )
        measured = (
            np.where(is_matched, disparity_px, np.nan),
            np.where(is_matched, sigma_px, np.nan),
        )
        return PatchMatches(*measured, outcome, choice.n_surfaces, probability)

    def _sigma(self, search: SurfaceSearch, surface: RefinedSurface) -> FloatArray:
        """(N,) standard deviation of p0, px of the tile.

        sigma^2 = floor^2 + (floor_fraction d)^2 + (noise_fraction noise)^2 + (scatter_fraction scatter)^2
                  + (tilt_fraction tilt)^2 + choice^2

            noise^2 = G / (G_independent sum of weight)
            scatter = 1.25 mean |residual|          mean absolute deviation -> standard deviation
            tilt    = (|p1| + |p2|) / 2             over the inner half of the box
            choice^2 = sum over the other surfaces of P (d - p0)^2

        Windows that overlap share pixels: G_independent is the number of windows that fit side by side.
        """
        settings = self._settings
        tiles, surfaces, choice = search.tiles, search.surfaces, search.choice
        is_inlier = np.isfinite(surface.residual)
        n_inliers = np.maximum(is_inlier.sum(axis=1), 1)
        total = np.maximum(surface.weight.sum(axis=1), 1e-6)
        noise = np.sqrt(n_inliers / np.maximum(n_inliers / 4.0, 1.0) / total)
        scatter = 1.25 * np.where(is_inlier, np.abs(surface.residual), 0.0).sum(axis=1) / n_inliers
        tilt = np.abs(surface.fit.p[:, 1:3]).sum(axis=1) / 2
        difference = np.where(
            np.isfinite(surfaces.centre), surfaces.centre - surface.fit.p[:, 0], 0.0
        )
        is_other = np.arange(len(difference))[:, None] != choice.chosen
        other = np.where(is_other, choice.probability * difference**2, 0.0).sum(axis=0)
        variance = (
            other
            + (settings.floor_fraction * np.maximum(tiles.first + surface.fit.p[:, 0], 0.0)) ** 2
        )
        variance = (
            variance
            + (settings.noise_fraction * noise) ** 2
            + (settings.scatter_fraction * scatter) ** 2
        )
        return np.asarray(
            np.sqrt(settings.floor_px**2 + (variance + (settings.tilt_fraction * tilt) ** 2))
        )
