"""ErrorModel: covariance of the errors of any number of methods, from the error sources that the
methods declare.

    cov(i, j) = sigma_i sigma_j  sum_s sqrt(p_is p_js)        over the error sources s that both methods declare

p_is is the fraction of source s in the variance of method i. The covariance of the systematic
fractions is constant over a track; the covariance of the independent fractions is new in every
frame. Methods do not share the source `own`.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from track_range.foundation.arrays import BoolArray, FloatArray, IntArray
from track_range.ranging.methods.method import RangingMethod

# smallest fraction of `own` in the independent variance: methods with equal sources still differ
_MIN_OWN_NOISE = 0.1
# correlation above which fusion does not extrapolate from one method through the other
_SIMILAR = 0.5


@dataclass(frozen=True, slots=True)
class ErrorModel:
    """Error correlations of M methods, and their grouping by error source for the outlier rules."""

    names: tuple[str, ...]  # names of the methods, in the order of all arrays
    systematic: FloatArray  # (M, 1) systematic fraction of sigma, constant over a track
    independent: FloatArray  # (M, 1) independent fraction of sigma, new in every frame
    systematic_correlation: FloatArray  # (M, M) correlation C0 of the systematic errors
    systematic_covariance: FloatArray  # (M, M, 1) products of the systematic fractions of sigma
    # (M, M, 1) covariance of the independent errors for sigmas of 1
    independent_covariance: FloatArray
    # (2, K) pairs of methods with an error correlation above 0.5 that may both be used
    similar: IntArray
    # indices of scale references, and of methods with the systematic errors of one of them
    reference: IntArray
    # (M, 1) whether the bias of a method is estimated: all but scale references
    is_learnt: BoolArray
    # (M, M) whether method i is not used for a track that method j measures
    superseded_by: BoolArray
    size: IntArray  # indices of methods that depend on the size of the object's class
    matching: IntArray  # indices of methods that match two images
    contact: IntArray  # indices of methods that depend on the contact point and not on object size
    lane: IntArray  # indices of methods that depend on the width of the lane
    # indices of methods that depend on the contact point only, not on size or lane width
    horizon: IntArray

    @classmethod
    def of(cls, methods: Sequence[RangingMethod]) -> ErrorModel:
        """Error model of the given methods that measure distances; other methods are left out."""
        methods = [method for method in methods if method.measures_distance]
        systematic, systematic_correlation = _correlation(methods, "systematic")
        independent, independent_correlation = _correlation(
            methods, "independent", min_own=_MIN_OWN_NOISE
        )
        independent_covariance = independent * independent.T * independent_correlation
        correlation = systematic * systematic.T * systematic_correlation + independent_covariance
        # Scale references, and methods whose systematic errors are all those of scale references.
        parts = {method.name: set(_parts(method, "systematic")) for method in methods}
        known = set[str]().union(
            *(parts[method.name] for method in methods if method.is_scale_reference)
        ) - {"own"}
        is_reference = np.array(
            [
                method.is_scale_reference or set() < parts[method.name] <= known
                for method in methods
            ],
            bool,
        )
        superseded_by = _superseded_by(methods)
        has_size, has_baseline, has_contact, has_lane = (
            np.array(
                [any(source.name == name for source in method.error_sources) for method in methods],
                bool,
            )
            for name in ("size", "baseline", "contact_point", "lane_width")
        )
        return cls(
            names=tuple(method.name for method in methods),
            systematic=systematic,
            independent=independent,
            systematic_correlation=systematic_correlation,
            systematic_covariance=(systematic * systematic.T)[:, :, None],
            independent_covariance=independent_covariance[:, :, None],
            similar=np.array(
                np.nonzero(np.triu(correlation > _SIMILAR, k=1) & ~superseded_by & ~superseded_by.T)
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


def _parts(method: RangingMethod, component: str) -> dict[str, float]:
    parts: dict[str, float] = {}
    for source in method.error_sources:
        parts[source.name] = parts.get(source.name, 0.0) + getattr(source, component)
    return {name: part for name, part in parts.items() if part > 0}


def _correlation(
    methods: Sequence[RangingMethod], component: str, *, min_own: float = 0.0
) -> tuple[FloatArray, FloatArray]:
    """(M, 1) fraction of sigma and (M, M) correlation of the errors of one component ("systematic"
    or "independent").

    A source that only one method declares counts as `own`. If `own` is less than the fraction
    `min_own` of a method's variance of this component, the shared sources are scaled down.
    """
    parts = [_parts(method, component) for method in methods]
    variance = np.array([sum(part.values()) for part in parts])
    names = sorted({name for part in parts for name in part} - {"own"})
    shared = np.array([[part.get(name, 0.0) for name in names] for part in parts]).reshape(
        len(parts), len(names)
    )
    shared = shared * ((shared > 0).sum(axis=0) > 1)
    shared = shared / np.where(variance > 0, variance, 1.0)[:, None]
    total = shared.sum(axis=1, keepdims=True)
    shared = shared * np.where(
        total > 1 - min_own, (1 - min_own) / np.where(total > 0, total, 1.0), 1.0
    )
    root = np.sqrt(shared)
    correlation = (root[:, None] * root).sum(axis=2)
    np.fill_diagonal(correlation, 1.0)
    return np.sqrt(variance)[:, None], correlation


def _superseded_by(methods: Sequence[RangingMethod]) -> BoolArray:
    """(M, M) whether method i is not used for tracks that method j measures.

    A fallback is superseded by its method, and by another fallback for this method that has the
    method's error sources.
    """
    shared = {
        method.name: {
            (s.name, s.systematic, s.independent) for s in method.error_sources if s.name != "own"
        }
        for method in methods
    }

    def is_superseded(method: RangingMethod, other: RangingMethod) -> bool:
        target = method.fallback_for
        if target is None or target not in shared or method is other:
            return False
        return other.name == target or (
            other.fallback_for == target and shared[other.name] == shared[target]
        )

    return np.array(
        [[is_superseded(method, other) for other in methods] for method in methods], bool
    ).reshape(len(methods), len(methods))
