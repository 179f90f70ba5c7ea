"""Match confidence: margins of a surface's cost to the costs of a chance match and of the second
best disparity.
"""

from dataclasses import dataclass

import numpy as np

from track_range.foundation.arrays import BoolArray, FloatArray, FloatArray32
from track_range.stereo.matching.subpixel import RefinedSurface
from track_range.stereo.matching.tiles import BoxTiles

# Percentile of a box's costs that estimates the cost of a chance match; above the median, because
# in a search around a prior half of the costs belong to the minimum.
_CHANCE_PERCENTILE = 75.0
# disparities on both sides of the best one that belong to its minimum, px of the tile
_PEAK_HALF_WIDTH = 2
# px of disparity per px of half width: nearer objects extend over more
_PEAK_HALF_WIDTH_PER_DISPARITY = 20


@dataclass(frozen=True, slots=True)
class MatchConfidence:
    """Confidence of the disparities of N boxes; costs in bits of 24 per pixel."""

    cost: FloatArray  # (N,) cost of the object's minimum; inf = none
    margin: FloatArray  # (N,) cost of a chance match minus that of the minimum
    # (N,) cost of the second best minimum minus that of the best; inf = there is no other
    second_best_margin: FloatArray
    is_inside: BoolArray  # (N,) whether the minimum lies inside the search range, not at an end


def match_confidence(
    cost: FloatArray32, surface: RefinedSurface, tiles: BoxTiles
) -> MatchConfidence:
    """Confidence of surfaces in costs (D, G, N), bits per pixel."""
    last = len(cost) - 1
    curve = _object_curve(cost, surface, tiles)
    centre = surface.fit.p[:, 0]
    best = np.where(np.isfinite(centre), np.rint(centre), -1.0).astype(np.int64)
    is_inside = (best > 0) & (best < last)
    best_cost = curve[np.minimum(np.maximum(best, 0), last), np.arange(len(best))]
    margin = _chance_cost(curve) - best_cost
    half_width = _PEAK_HALF_WIDTH + (tiles.first + best) // _PEAK_HALF_WIDTH_PER_DISPARITY
    is_other = np.abs(np.arange(len(cost))[:, None] - best) > half_width
    second_best_cost = np.where(is_other, _between_disparities(curve), np.inf).min(axis=0)
    with np.errstate(invalid="ignore"):  # no surface, no costs: inf - inf
        second_best_margin = np.asarray(second_best_cost - best_cost)
    return MatchConfidence(np.asarray(best_cost), np.asarray(margin), second_best_margin, is_inside)


def _between_disparities(curve: FloatArray) -> FloatArray:
    """(D, N) costs of minima between two disparities, by a V-shaped fit to costs (D, N); other
    costs do not change.
    """
    lowest = curve.copy()
    before, at, after = curve[:-2], curve[1:-1], curve[2:]
    with np.errstate(invalid="ignore"):  # inf - inf
        below = np.abs(before - after) / 2
    is_minimum = (at <= before) & (at <= after) & np.isfinite(below)
    lowest[1:-1] = np.where(is_minimum, np.maximum(at - np.where(is_minimum, below, 0.0), 0.0), at)
    return lowest


def _object_curve(cost: FloatArray32, surface: RefinedSurface, tiles: BoxTiles) -> FloatArray:
    """(D, N) mean cost of the object's windows as a function of the surface's p0; inf = more than
    half are not visible.

        curve(k) = mean over the object's windows i of C_i(k + round(d(u_i, v_i) - p0))

    so that a slanted surface also has one minimum.
    """
    n_disparities, n_windows, n = cost.shape
    is_object = np.isfinite(surface.residual).T
    shift = np.rint(surface.fit.at(tiles.u, tiles.v) - surface.fit.p[:, :1]).T
    shift = np.where(is_object, np.minimum(np.maximum(shift, -n_disparities), n_disparities), 0.0)
    reach = int(np.abs(shift).max(initial=0.0))
    padded = np.full((n_disparities + 2 * reach, n_windows * n), np.nan, np.float32)
    padded[reach : reach + n_disparities] = cost.reshape(n_disparities, -1)
    place = (shift.astype(np.int64) + reach).reshape(-1) * (n_windows * n) + np.arange(
        n_windows * n
    )
    k = np.arange(0, cost.size, n_windows * n)[:, None]
    shifted = padded.reshape(-1).take(k + place).reshape(cost.shape)
    is_seen = np.isfinite(shifted)
    is_seen &= is_object
    n_seen = is_seen.sum(axis=1)
    total = np.where(is_seen, shifted, np.float32(0.0)).sum(axis=1)
    is_enough = n_seen >= np.maximum(0.5 * is_object.sum(axis=0), 1)
    return np.where(is_enough, total / np.maximum(n_seen, 1), np.inf)


def _chance_cost(curve: FloatArray) -> FloatArray:
    """(N,) the percentile of the finite costs of each column of (D, N); -inf where there are
    none.
    """
    ordered = np.sort(curve, axis=0)
    n_finite = np.isfinite(curve).sum(axis=0)
    index = np.rint(_CHANCE_PERCENTILE / 100 * (n_finite - 1)).astype(np.int64)
    chosen = ordered[np.maximum(index, 0), np.arange(curve.shape[1])]
    return np.where(n_finite > 0, chosen, -np.inf)
