"""Fit of the probabilities of a box's surfaces (`stereo.matching.surface_choice.THETA`), with cross-validation.

Protocol: unrelated images of the scenario `occlusion` (`occlusion_pairs`), development seeds 0-19, objects that count
there. The surfaces of each box are searched in four ways, as in a run: near the disparity by size; near a track's last
disparity (log error 3 %; for 7 % of the occluded objects the track is on the occluder), with and without the size; in
the full range without both. A surface is right if its distance is within 15 %, and not more than 3 % worse than that of
the best. Multinomial logistic regression with an L2 penalty on standardised features. Failures: even seeds are chosen
with the fit to odd ones and vice versa; no surface within 15 % is a failure of the search.
"""

from __future__ import annotations

import argparse
from collections.abc import Iterator
from dataclasses import dataclass
from typing import Any

import numpy as np
from rich.console import Console
from scipy.optimize import minimize

from benchmarks.inputs.occlusion_pairs import OcclusionPair, is_scored, unrelated_pairs
from benchmarks.plain_tables import plain_table
from track_range.evaluation.expected_disparities import expected_disparities
from track_range.foundation.arrays import BoolArray, FloatArray, IntArray
from track_range.stereo.evaluation.disparity_errors import FAILURE
from track_range.stereo.matching.patch_matcher import (
    KnownBoxes,
    PatchMatcher,
    PatchMatcherSettings,
    SurfaceSearch,
)
from track_range.stereo.matching.patch_matches import ExpectedDisparity
from track_range.stereo.matching.surface_choice import OtherBoxes

WAYS = ("size", "track and size", "track", "full range")
"""Ways in which the surfaces are searched."""

TRACK_LOG_SIGMA, OCCLUDER_FRACTION = 0.03, 0.07
"""Standard deviation of the log disparity of tracks, and the fraction of occluded objects with that of the occluder."""

AS_GOOD = 0.03
"""Largest difference between the relative errors of a surface and of the best one if both are right."""

PENALTY = 2.0
"""Weight of the squared coefficients of the standardised features."""


@dataclass(frozen=True, slots=True)
class _Examples:
    """S surfaces of N objects: features (S, N, F), relative errors (S, N), and the seed of each object (N,)."""

    features: FloatArray
    error: FloatArray
    seed: IntArray

    @property
    def is_right(self) -> BoolArray:
        """(S, N) surfaces that may be chosen."""
        return np.asarray(self.error <= np.minimum(FAILURE, self.error.min(axis=0) + AS_GOOD))

    def select(self, rows: BoolArray) -> _Examples:
        """The objects selected by a mask."""
        return _Examples(self.features[:, rows], self.error[:, rows], self.seed[rows])


def add_options(parser: argparse.ArgumentParser) -> None:
    """Add the options of this workload."""
    parser.add_argument("--seeds", type=int, default=20, help="number of drives, from seed 0")


def measure(options: argparse.Namespace) -> dict[str, Any]:
    """Fit the coefficients, print them and the failures of the cross-validation, and return both."""
    parts: dict[str, list[_Examples]] = {way: [] for way in WAYS}
    names: list[str] = []
    rng = np.random.default_rng(0)
    for occlusion in unrelated_pairs(range(options.seeds)):
        for way, search, rows in _searches(occlusion, rng):
            names = list(search.phi)
            parts[way].append(_examples(search, occlusion, rows))
    examples = {way: _joined(part) for way, part in parts.items()}
    halves = [_fit([part.select(part.seed % 2 != half) for part in examples.values()]) for half in (0, 1)]
    failures = {way: _failures(part, halves) for way, part in examples.items()}
    theta = dict(zip(names, np.round(_fit(list(examples.values())), 2).tolist(), strict=True))
    table = plain_table("Failures, %", "search", "objects", "chosen wrong", "not found")
    for way, (n, wrong_pct, missing_pct) in failures.items():
        table.add_row(way, str(n), f"{wrong_pct:.1f}", f"{missing_pct:.1f}")
    Console().print(table)
    Console().print(theta)
    return {"theta": theta, "failures": {way: list(values) for way, values in failures.items()}}


def _searches(occlusion: OcclusionPair, rng: np.random.Generator) -> Iterator[tuple[str, SurfaceSearch, IntArray]]:
    """Name and surfaces of each way, and the searched boxes of the pair."""
    pair, objects = occlusion.pair, occlusion.objects
    settings = PatchMatcherSettings.for_rig(pair.rig)
    matcher, by_size, n = PatchMatcher(settings), expected_disparities(pair), len(pair.true_px)
    height, width = pair.left.shape[:2]
    boxes = np.clip(pair.xyxy_px, -0.5, np.array([width, height, width, height]) - 0.5)
    limit_px = np.full(n, float(settings.max_disparity_px))
    is_on_occluder = (rng.random(n) < OCCLUDER_FRACTION) & np.isfinite(objects.occluder_px)
    track_px = np.where(is_on_occluder, objects.occluder_px, pair.true_px * np.exp(rng.normal(0, TRACK_LOG_SIGMA, n)))
    no_track, no_size = np.full(n, np.nan), ExpectedDisparity.unknown(n)
    is_large = (boxes[:, 2:] - boxes[:, :2]).min(axis=1) >= settings.min_side_px
    for way, track, size in zip(
        WAYS, (no_track, track_px, track_px, no_track), (by_size, by_size, no_size, no_size), strict=True
    ):
        centre_px = by_size.disparity_px if way == "size" else track
        known = KnownBoxes(boxes, track, size, limit_px, OtherBoxes(boxes, centre_px))
        is_searched = is_large & is_scored(objects, pair)
        if way != "full range":
            is_searched &= (centre_px >= settings.min_disparity_px) & (centre_px <= limit_px)
        rows = np.flatnonzero(is_searched)
        if not len(rows):
            continue
        if way == "full range":
            yield way, matcher.search_full_range(pair.left, pair.right, known.select(rows)), rows
        else:
            reach_px = settings.size_search_px if way == "size" else settings.search_px
            yield way, matcher.search_near(pair.left, pair.right, known.select(rows), centre_px[rows], reach_px), rows


def _examples(search: SurfaceSearch, occlusion: OcclusionPair, rows: IntArray) -> _Examples:
    with np.errstate(invalid="ignore", divide="ignore"):
        error = np.abs(occlusion.pair.true_px[rows] / search.disparity_px - 1.0)
    is_surface = np.isfinite(search.surfaces.centre) & (search.surfaces.disparity > 0)
    features = np.where(is_surface[..., None], np.stack(list(search.phi.values()), axis=2), 0.0)
    return _Examples(features, np.where(is_surface, error, np.inf), np.full(len(rows), occlusion.seed))


def _joined(parts: list[_Examples]) -> _Examples:
    return _Examples(
        np.concatenate([part.features for part in parts], axis=1),
        np.concatenate([part.error for part in parts], axis=1),
        np.concatenate([part.seed for part in parts]),
    )


def _fit(parts: list[_Examples]) -> FloatArray:
    """(F,) coefficients with the largest penalised likelihood of the right surfaces."""
    examples = _joined(parts)
    examples = examples.select(np.asarray(examples.is_right.any(axis=0)))
    is_surface, is_right = np.isfinite(examples.error), examples.is_right
    scale = examples.features[is_surface].std(axis=0) + 1e-6
    features = examples.features / scale

    def loss(theta: FloatArray) -> tuple[float, FloatArray]:
        probability = _probability(features, theta, is_surface)
        of_right = np.maximum((probability * is_right).sum(axis=0), 1e-12)
        difference = probability * is_right / of_right - probability
        gradient = 2 * PENALTY * theta - np.einsum("sn,snf->f", difference, features)
        return float(PENALTY * theta @ theta - np.log(of_right).sum()), gradient

    return np.asarray(minimize(loss, np.zeros(features.shape[2]), jac=True).x / scale)


def _probability(features: FloatArray, theta: FloatArray, is_surface: BoolArray) -> FloatArray:
    """(S, N) softmax of the scores of the surfaces."""
    score = np.where(is_surface, features @ theta, -1e9)
    likelihood = np.exp(score - score.max(axis=0))
    return np.asarray(likelihood / likelihood.sum(axis=0))


def _failures(examples: _Examples, halves: list[FloatArray]) -> tuple[int, float, float]:
    """Number of objects, and the percentages chosen wrongly and without a right surface."""
    is_surface, n = np.isfinite(examples.error), len(examples.seed)
    score = np.where(examples.seed % 2 == 0, *(examples.features @ theta for theta in halves))
    chosen = np.where(is_surface, score, -np.inf).argmax(axis=0)
    error = examples.error[chosen, np.arange(n)]
    return n, float(100 * np.mean(error > FAILURE)), float(100 * np.mean(examples.error.min(axis=0) > FAILURE))
