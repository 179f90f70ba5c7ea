"""Fusion: one distance from several methods, weighted by inverse variance.

    d = sum(d_i / s_i^2) / sum(1 / s_i^2),   s^2 = max(1, chi^2 / (n - 1)) / sum(1 / s_i^2)

The factor (Birge's ratio) widens sigma where the methods contradict each other by more than their sigmas allow.
Where stereo and mono are further apart than by a factor of 2.5 stereo is left out: an object that is partly hidden can
look half as large as it is, but none of its class is that much larger or smaller, while a match on what stands in front
of it, or on the background, can be anywhere. (A first rule; a track's own history will say more.)
Dense and patch matching look at the same pixels of the same pair and share their errors, so dense matching only stands
in where patch matching has no answer.
"""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np

from detection.detections import IntArray
from ranging.ranges import Ranges

_MAX_SIZE_FACTOR = 2.5
_BIT_OF = {"mono": 1, "lane": 2, "stereo": 4}
_STANDS_IN_FOR = {"stereo": "sgbm"}


def fuse(by_method: Mapping[str, Ranges], track_id: IntArray) -> Ranges:
    """The fused ranges of `track_id` from mono, lane, stereo and sgbm (those that are there), all in its order."""
    parts = list(_parts(by_method).values())
    if not parts:
        return Ranges.unmeasured(track_id)
    distance_m = np.stack([part.distance_m for part in parts])
    sigma_m = np.stack([part.sigma_m for part in parts])
    good = np.isfinite(distance_m) & (sigma_m > 0)
    weight = np.where(good, 1.0 / np.where(good, sigma_m, 1.0) ** 2, 0.0)
    total = weight.sum(axis=0)
    with np.errstate(invalid="ignore", divide="ignore"):  # 0 / 0 = NaN is meant: nobody measured
        mean_m = (weight * np.where(good, distance_m, 0.0)).sum(axis=0) / total
        chi2 = (weight * (np.where(good, distance_m, 0.0) - mean_m) ** 2).sum(axis=0)
        birge = np.maximum(1.0, chi2 / np.maximum(good.sum(axis=0) - 1, 1))
        return Ranges(track_id, mean_m, np.sqrt(birge / total) + 0.0 * mean_m)


def contributors(by_method: Mapping[str, Ranges], track_id: IntArray) -> IntArray:
    """(N,) which methods `fuse` makes each track's distance from: bits 1, 2, 4, 8 for mono, lane, stereo, sgbm."""
    bits = np.zeros(len(track_id), np.int64)
    for name, used in _parts(by_method).items():
        own = by_method[name].distance_m if name in by_method else np.full(len(track_id), np.nan)
        stands_in = np.isfinite(used.distance_m) & np.isnan(own)
        bits |= np.where(stands_in, 8, _BIT_OF[name]) * np.isfinite(used.distance_m)
    return bits


def _parts(by_method: Mapping[str, Ranges]) -> dict[str, Ranges]:
    """What is fused: each method that is there, with its stand-in where it is silent, without what no size explains."""
    used = {name: _with_stand_in(by_method, name) for name in _BIT_OF if _has(by_method, name)}
    return {name: found if name == "mono" else _gated(found, used.get("mono")) for name, found in used.items()}


def _gated(ranges: Ranges, mono: Ranges | None) -> Ranges:
    """The ranges, NaN where mono contradicts them beyond any object's size."""
    if mono is None:
        return ranges
    with np.errstate(invalid="ignore"):
        factor = np.abs(np.log(ranges.distance_m / mono.distance_m))
        impossible = factor > np.log(_MAX_SIZE_FACTOR)
    return Ranges(
        ranges.track_id,
        np.where(impossible, np.nan, ranges.distance_m),
        np.where(impossible, np.nan, ranges.sigma_m),
    )


def _has(by_method: Mapping[str, Ranges], name: str) -> bool:
    return name in by_method or _STANDS_IN_FOR.get(name) in by_method


def _with_stand_in(by_method: Mapping[str, Ranges], name: str) -> Ranges:
    """The method's ranges, each NaN replaced by its stand-in's."""
    stand_in = by_method.get(_STANDS_IN_FOR.get(name, ""))
    first = by_method.get(name, stand_in)
    if first is None or stand_in is None or first is stand_in:
        return first if first is not None else by_method[name]
    missing = np.isnan(first.distance_m)
    return Ranges(
        first.track_id,
        np.where(missing, stand_in.distance_m, first.distance_m),
        np.where(missing, stand_in.sigma_m, first.sigma_m),
    )
