"""Clarity: whether the minimum that a surface stands for is deep, and alone."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from track_range.foundation.arrays import BoolArray, FloatArray, FloatArray32, IntArray
from track_range.stereo.matching.sample_windows import BoxWindows
from track_range.stereo.matching.surfaces import Surface

_CHANCE_PERCENTILE = 75.0
"""The costs' percentile that stands for a chance match, also about a prior, where half the costs are in the valley."""


@dataclass(frozen=True, slots=True)
class Clarity:
    """How clearly each of N boxes has one disparity.

    Attributes:
        cost: (N,) of the object's minimum, bits per pixel; inf = none.
        depth: (N,) of that minimum below the cost of a chance match, bits per pixel.
        rival: (N,) cost of the next best minimum above it, bits per pixel; inf = there is none.
        is_inside: (N,) whether the minimum lies inside the range that was searched.
    """

    cost: FloatArray
    depth: FloatArray
    rival: FloatArray
    is_inside: BoolArray


def clarity_of(cost: FloatArray32, surface: Surface, windows: BoxWindows, first: IntArray) -> Clarity:
    """From costs (D, N, G) at the disparities first (N,) + k, and the surfaces found in them.

    What counts are the costs of the object's windows, each shifted by the plane's tilt, so that a slanted surface has
    one minimum.
    """
    last = len(cost) - 1
    curve = _object_curve(cost, surface, windows.places())
    best = np.nan_to_num(np.rint(surface.centre - first), nan=-1.0).astype(np.int64)
    is_inside = (best > 0) & (best < last)
    at = curve[np.clip(best, 0, last), np.arange(len(first))]
    depth = _percentile_of_finite(curve) - at
    aside = 2 + (first + best) // 20  # the nearer the object, the wider the valley that it makes itself
    is_rival = np.abs(np.arange(len(cost))[:, None] - best) > aside
    rival = np.where(is_rival, curve, np.inf).min(axis=0)
    with np.errstate(invalid="ignore"):  # no surface, no costs: inf - inf
        return Clarity(np.asarray(at), np.asarray(depth), np.asarray(rival - at), is_inside)


def _object_curve(cost: FloatArray32, surface: Surface, places: tuple[FloatArray, FloatArray]) -> FloatArray:
    """(D, N) mean cost of the object's windows where the plane's middle is at each disparity; inf = few are seen."""
    last = len(cost) - 1
    right, down = places
    is_object = np.isfinite(surface.residual)
    shift = np.rint(surface.tilt[:, :1] * right + surface.tilt[:, 1:] * down).astype(np.int64)
    k = np.arange(len(cost))[:, None, None] + shift
    place = np.arange(shift.size).reshape(shift.shape)
    shifted = cost.reshape(-1).take(np.clip(k, 0, last) * shift.size + place)  # a third of `take_along_axis`'s time
    known = (k >= 0) & (k <= last) & is_object & np.isfinite(shifted)
    n_known = known.sum(axis=2)
    total = np.where(known, shifted, np.float32(0.0)).sum(axis=2)
    enough = n_known >= np.maximum(0.5 * is_object.sum(axis=1), 1)
    return np.where(enough, total / np.maximum(n_known, 1), np.inf)


def _percentile_of_finite(curve: FloatArray) -> FloatArray:
    """(N,) chance cost of each column of (D, N); -inf where it has no finite value."""
    ordered = np.sort(curve, axis=0)
    n_finite = np.isfinite(curve).sum(axis=0)
    index = np.rint(_CHANCE_PERCENTILE / 100 * (n_finite - 1)).astype(np.int64)
    chosen = ordered[np.maximum(index, 0), np.arange(curve.shape[1])]
    return np.where(n_finite > 0, chosen, -np.inf)
