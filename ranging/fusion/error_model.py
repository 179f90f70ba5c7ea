"""ErrorModel: how the errors of any number of methods hang together, from the error sources that each declares.

    cov(i, j) = sigma_i sigma_j  sum_s sqrt(part_is part_js)        over the error sources s that both declare

once with the systematic parts, which a track keeps from frame to frame, and once with the independent ones, which are
drawn anew in every frame. No two methods share the source `own`.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from track_range.foundation.arrays import BoolArray, FloatArray, IntArray
from track_range.ranging.method import RangingMethod

_MIN_OWN_NOISE = 0.1
"""At least this part of a method's independent variance is taken to be its own, whatever it declares: two methods with
the same sources still differ by rounding and by implementation, and their covariance stays positive definite."""

_SIMILAR = 0.5
"""Correlation of the errors of two methods from which fusion does not extrapolate from one through the other."""


@dataclass(frozen=True, slots=True)
class ErrorModel:
    """M methods: their correlations, and what the outlier rules need to know of them.

    Attributes:
        names: of the methods, in the order of all arrays.
        systematic: (M, 1) share of each sigma that a track keeps.
        independent: (M, 1) share of each sigma that is new in every frame.
        systematic_correlation: (M, M) correlation C0 of the parts that a track keeps.
        systematic_covariance: (M, M, 1) products of the shares that a track keeps.
        independent_covariance: (M, M, 1) covariance of the parts that are new in every frame, for sigmas of 1.
        similar: pairs of methods that share more than half of their variance and may count together.
        reference: indices of scale references: those declared, and those whose systematic errors are all shared with
            a declared one.
        is_learnt: (M, 1) whether the bias of a method is estimated: of all but references.
        superseded_by: (M, M) whether method i does not count where method j measures.
        size: indices of methods that depend on the size of the object's class.
        matching: indices of methods that match two images.
        contact: indices of methods that go by the foot of the box and not by sizes.
        lane: indices of methods that depend on the width of the lane.
        horizon: indices of methods that go by the foot of the box and neither by sizes nor by the lane.
    """

    names: tuple[str, ...]
    systematic: FloatArray
    independent: FloatArray
    systematic_correlation: FloatArray
    systematic_covariance: FloatArray
    independent_covariance: FloatArray
    similar: tuple[tuple[int, int], ...]
    reference: IntArray
    is_learnt: BoolArray
    superseded_by: BoolArray
    size: IntArray
    matching: IntArray
    contact: IntArray
    lane: IntArray
    horizon: IntArray

    @classmethod
    def of(cls, methods: Sequence[RangingMethod]) -> ErrorModel:
        """The model of these methods."""
        systematic, systematic_correlation = _correlation(methods, "systematic")
        independent, independent_correlation = _correlation(methods, "independent", min_own=_MIN_OWN_NOISE)
        independent_covariance = independent * independent.T * independent_correlation
        correlation = systematic * systematic.T * systematic_correlation + independent_covariance
        is_reference, superseded_by = _references(methods), _superseded_by(methods)
        has_size, has_baseline, has_contact, has_lane = (
            np.array([any(source.name == name for source in method.error_sources) for method in methods], bool)
            for name in ("size", "baseline", "contact_point", "lane_width")
        )
        return cls(
            names=tuple(method.name for method in methods),
            systematic=systematic,
            independent=independent,
            systematic_correlation=systematic_correlation,
            systematic_covariance=(systematic * systematic.T)[:, :, None],
            independent_covariance=independent_covariance[:, :, None],
            similar=tuple(
                (i, j)
                for j in range(len(methods))
                for i in range(j)
                if correlation[i, j] > _SIMILAR and not (superseded_by[i, j] or superseded_by[j, i])
            ),
            reference=np.flatnonzero(is_reference),
            is_learnt=~is_reference[:, None],
            superseded_by=superseded_by,
            size=np.flatnonzero(has_size),
            matching=np.flatnonzero(has_baseline),
            contact=np.flatnonzero(has_contact & ~has_size),
            lane=np.flatnonzero(has_lane),
            horizon=np.flatnonzero(has_contact & ~has_size & ~has_lane),
        )


def _parts(method: RangingMethod, kind: str) -> dict[str, float]:
    """Part of the variance by error source, of one kind ("systematic" or "independent")."""
    parts: dict[str, float] = {}
    for source in method.error_sources:
        parts[source.name] = parts.get(source.name, 0.0) + getattr(source, kind)
    return {name: part for name, part in parts.items() if part > 0}


def _correlation(methods: Sequence[RangingMethod], kind: str, *, min_own: float = 0.0) -> tuple[FloatArray, FloatArray]:
    """(M, 1) share of sigma that is of this kind, and (M, M) its correlation.

    Sources that only one method declares are its own. Where less than `min_own` of a method's variance of this kind is,
    the parts that it shares are made smaller.
    """
    parts = [_parts(method, kind) for method in methods]
    variance = np.array([sum(of_one.values()) for of_one in parts])
    names = sorted({name for of_one in parts for name in of_one} - {"own"})
    shared = np.array([[of_one.get(name, 0.0) for name in names] for of_one in parts]).reshape(len(parts), len(names))
    shared = shared * ((shared > 0).sum(axis=0) > 1)
    shared = shared / np.where(variance > 0, variance, 1.0)[:, None]
    total = shared.sum(axis=1, keepdims=True)
    shared = shared * np.where(total > 1 - min_own, (1 - min_own) / np.where(total > 0, total, 1.0), 1.0)
    root = np.sqrt(shared)
    correlation = (root[:, None] * root).sum(axis=2)
    np.fill_diagonal(correlation, 1.0)
    return np.sqrt(variance)[:, None], correlation


def _references(methods: Sequence[RangingMethod]) -> BoolArray:
    """(M,) which methods are scale references."""
    known = {name for method in methods if method.is_scale_reference for name in _parts(method, "systematic")}
    parts = [set(_parts(method, "systematic")) for method in methods]
    return np.array(
        [
            method.is_scale_reference or (bool(names) and names <= known - {"own"})
            for method, names in zip(methods, parts, strict=True)
        ],
        bool,
    )


def _superseded_by(methods: Sequence[RangingMethod]) -> BoolArray:
    """(M, M) which methods make which others superfluous.

    A fallback does not count where the method that it stands in for measures, nor where another fallback for that
    method does that has the very same error sources, and so replaces it.
    """
    shared = {
        method.name: {(s.name, s.systematic, s.independent) for s in method.error_sources if s.name != "own"}
        for method in methods
    }

    def is_superseded(one: RangingMethod, other: RangingMethod) -> bool:
        target = one.fallback_for
        if target is None or target not in shared or one is other:
            return False
        return other.name == target or (other.fallback_for == target and shared[other.name] == shared[target])

    return np.array([[is_superseded(one, other) for other in methods] for one in methods], bool).reshape(
        len(methods), len(methods)
    )
