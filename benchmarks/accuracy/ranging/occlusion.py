"""Occlusion: failures of stereo matchers, and the fit of the choice between the surfaces of a
box.
"""

from __future__ import annotations

from argparse import Namespace
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from scipy.optimize import minimize

from benchmarks.harness import Figures, option, workload
from benchmarks.inputs.occlusion_pairs import (
    MAX_COVERED_FRACTION,
    CoveredObjects,
    OcclusionPair,
    is_scored,
    sequences,
    unrelated_pairs,
)
from track_range.evaluation.stereo_evaluation import expected_disparities
from track_range.foundation.arrays import BoolArray, FloatArray, IntArray
from track_range.stereo.evaluation.box_matchers import MATCHER_NAMES, measure_pairs
from track_range.stereo.evaluation.disparity_errors import (
    FAILURE,
    MatcherColumn,
    Objects,
    figures_with_intervals,
)
from track_range.stereo.evaluation.kitti_2015 import StereoPair
from track_range.stereo.matching.patch_matcher import (
    KnownBoxes,
    PatchMatcher,
    PatchMatcherSettings,
    SurfaceSearch,
)
from track_range.stereo.matching.patch_matches import ExpectedDisparity
from track_range.stereo.matching.surface_choice import THETA, OtherBoxes, none_features

MATCHERS = ("patch", "sgbm", "sgbm-hh")
REFERENCE = "sgbm-hh"  # matcher with which the failures of the others are compared

KINDS = ("none", "pole", "sign", "fence", "bush", "road user", "scenery")
"""Kinds of occluders, in the order of the tables."""

COVERED = ((-1.0, 0.0), (0.0, 0.25), (0.25, 0.5), (0.5, 0.75))
"""Intervals of the covered share, without the lower and with the upper end; the first one is 0."""

HIDDEN = "hidden 50-85 %"  # group of objects that count in no other one
GROSS_ERROR, GROSS_SIGMA = 0.1, 3.0  # an error above both is gross, relative and in sigmas

PARTS: dict[str, Callable[[range], Iterator[OcclusionPair]]] = {
    "unrelated": unrelated_pairs,
    "sequences": sequences,
}
"""Function of each part that renders its pairs."""


@workload(
    option(
        "--first-seed", "--seed", default=100, help="first random seed; 0-19 are for development"
    ),
    option("--seeds", default=20, help="number of drives"),
    option("--matchers", default=MATCHERS, choices=MATCHER_NAMES, help="compared matchers"),
    option("--parts", default=tuple(PARTS), choices=PARTS, help="parts to measure"),
)
def occlusion(options: Namespace) -> Figures:
    """Errors of stereo matchers for road users behind poles, signs, fences, bushes and nearer
    vehicles.
    """
    seeds = range(options.first_seed, options.first_seed + options.seeds)
    measured = {name: _Measured(PARTS[name](seeds), options.matchers) for name in options.parts}
    figures = (
        {name: _figures([part]) for name, part in measured.items()} if len(measured) > 1 else {}
    )
    figures["all"] = _figures(list(measured.values()))
    return {"failure_ratios": _ratios(figures["all"]["all"]), **figures}


def _ratios(by_matcher: Mapping[str, dict[str, Any]]) -> dict[str, float]:
    """Failures of each matcher relative to those of the reference, if it was measured and has
    failures.
    """
    reference = by_matcher.get(REFERENCE, {}).get("failures_pct")
    return {
        name: row["failures_pct"] / reference
        for name, row in by_matcher.items()
        if reference and name != REFERENCE
    }


class _Measured:
    def __init__(self, pairs: Iterator[OcclusionPair], matchers: Sequence[str]) -> None:
        kept, parts = list[BoolArray](), list[tuple[CoveredObjects, IntArray, list[str]]]()
        scored: list[BoolArray] = []

        def recorded() -> Iterator[StereoPair]:
            for image in pairs:
                of_choice = is_scored(image.objects, image.pair)
                kept.append(of_choice | _is_hidden(image.objects))
                scored.append(of_choice[kept[-1]])
                objects = image.objects.select(kept[-1])
                names = np.array(image.pair.class_names, np.str_)[kept[-1]].tolist()
                parts.append((objects, np.full(len(objects), image.seed), names))
                yield image.pair

        results = measure_pairs(recorded(), matchers, expected=expected_disparities)
        rows, self.is_scored = np.concatenate(kept), np.concatenate(scored)
        objects, seeds, names = zip(*parts, strict=True)
        self.objects: Objects = replace(results.objects.select(rows), group=np.concatenate(seeds))
        self.columns: dict[str, MatcherColumn] = {
            name: column.select(rows) for name, column in results.columns.items()
        }
        self.class_name = np.concatenate(names)
        self.kind, self.covered, self.is_modal = (
            np.concatenate([getattr(part, name) for part in objects])
            for name in ("kind", "covered_inner", "is_modal")
        )

    def groups(self) -> dict[str, BoolArray]:
        groups = {"all": np.ones(len(self.kind), np.bool_)}
        groups |= {f"occluder {kind}": self.kind == kind for kind in KINDS}
        for low, high in COVERED:
            name = "covered 0 %" if high == 0 else f"covered {100 * low:.0f}-{100 * high:.0f} %"
            groups[name] = (self.covered > low) & (self.covered <= high)
        groups |= {
            f"class {name}": self.class_name == name
            for name in ("car", "truck", "person", "bicycle")
        }
        groups |= {"box of visible part": self.is_modal, "box of whole object": ~self.is_modal}
        scored = {name: rows & self.is_scored for name, rows in groups.items()}
        return scored | {HIDDEN: ~self.is_scored}


def _is_hidden(objects: CoveredObjects) -> BoolArray:
    """(N,) objects that are covered by more than a half, but not wholly."""
    is_hidden = objects.covered_fraction > MAX_COVERED_FRACTION
    is_hidden &= objects.covered_fraction <= MOST_COVERED
    return np.asarray(is_hidden & ~objects.is_cut & (objects.kitti_type != "TrafficSign"))


def _gross_pct(column: MatcherColumn, objects: Objects) -> float | None:
    """Percentage of the measured objects that are more than 10 % and three sigma off."""
    is_measured = np.isfinite(column.disparity_px)
    error_px = np.abs(column.disparity_px - objects.true_px)[is_measured]
    is_gross = error_px > GROSS_SIGMA * column.sigma_px[is_measured]
    is_gross &= error_px > GROSS_ERROR * objects.true_px[is_measured]
    return 100 * float(is_gross.mean()) if len(is_gross) else None


def _figures(parts: Sequence[_Measured]) -> dict[str, dict[str, dict[str, Any]]]:
    figures: dict[str, dict[str, dict[str, Any]]] = {}
    for group in parts[0].groups():
        rows = [part.groups()[group] for part in parts]
        objects = _joined_objects(
            [part.objects.select(chosen) for part, chosen in zip(parts, rows, strict=True)]
        )
        figures[group] = {}
        for name in parts[0].columns:
            columns = [
                part.columns[name].select(chosen) for part, chosen in zip(parts, rows, strict=True)
            ]
            column = MatcherColumn(
                *(
                    np.concatenate([getattr(c, key) for c in columns])
                    for key in MatcherColumn.__slots__
                )
            )
            figures[group][name] = figures_with_intervals(column, objects)
            figures[group][name]["gross_pct"] = _gross_pct(column, objects)
    return figures


def _joined_objects(parts: Sequence[Objects]) -> Objects:
    """The objects of several parts; their pairs are not used."""
    true_px, focal_baseline_m, x_px, pair, group = (
        np.concatenate([getattr(part, name) for part in parts])
        for name in ("true_px", "focal_baseline_m", "x_px", "pair", "group")
    )
    return Objects(true_px, focal_baseline_m, x_px, pair, group, cameras=())


WAYS = ("size", "track and size", "track", "full range")  # in which the surfaces are searched

TRACK_LOG_SIGMA, OCCLUDER_FRACTION = 0.03, 0.07
"""Standard deviation of the log disparity of tracks, and the fraction of occluded objects with that
of the occluder."""

# largest difference between the relative errors of a surface and of the best one if both are right
AS_GOOD = 0.03
PENALTY = 2.0  # weight of the squared coefficients of the standardised features
NONE_PENALTY = 0.5  # the same for the probability that no surface is the object
# smallest relative error of the best surface if none of them is the object
NONE_ERROR = 0.1
# largest covered share of objects of this probability, and their weight if they are covered by more
# than a half: a detector finds a third to a half of them, and the scenario has many
MOST_COVERED, HIDDEN_WEIGHT = 0.85, 0.3
# of the measured disparities of other boxes that are not covered by more than a half
OTHERS_LOG_SIGMA = 0.02
# share of objects whose sizes have a further error, and the standard deviation of its logarithm:
# classes are wrong, and cars of a street differ from the model's
WILD_FRACTION, WILD_LOG_SIGMA = 0.2, 0.2


@dataclass(frozen=True, slots=True)
class _Examples:
    """S surfaces of N objects: features (S, N, F), relative errors (S, N), the seed of each object
    (N,), and whether it counts for the choice between the surfaces.
    """

    features: FloatArray
    error: FloatArray
    seed: IntArray
    is_scored: BoolArray

    @property
    def is_right(self) -> BoolArray:
        """(S, N) surfaces that may be chosen."""
        return np.asarray(self.error <= np.minimum(FAILURE, self.error.min(axis=0) + AS_GOOD))

    def select(self, rows: BoolArray) -> _Examples:
        return _Examples(
            self.features[:, rows], self.error[:, rows], self.seed[rows], self.is_scored[rows]
        )


@workload(option("--seeds", default=20, help="number of drives, from seed 0"))
def surface_choice(options: Namespace) -> Figures:
    """Fit of the probabilities of a box's surfaces, and that none of them is the object
    (`stereo.matching.surface_choice.THETA`, `ETA`), with cross-validation of the choice.
    """
    parts: dict[str, list[_Examples]] = {way: [] for way in WAYS}
    names = list(THETA)
    rng = np.random.default_rng(0)
    for image in unrelated_pairs(range(options.seeds)):
        for way, search, rows in _searches(image, rng):
            parts[way].append(_examples(search, image, rows))
    of_all = {way: _joined(part) for way, part in parts.items()}
    examples = {way: part.select(part.is_scored) for way, part in of_all.items()}
    halves = [
        _fit([part.select(part.seed % 2 != half) for part in examples.values()]) for half in (0, 1)
    ]
    failures = {way: _failures(part, halves) for way, part in examples.items()}
    theta = dict(zip(names, np.round(_fit(list(examples.values())), 2).tolist(), strict=True))
    eta = _fit_none(_joined(list(of_all.values())), names)
    return {"theta": theta, "eta": eta, "failures": failures}


def _fit_none(examples: _Examples, names: list[str]) -> dict[str, float]:
    """Coefficients of the probability that none of the surfaces is the object, by the features of
    the chosen one.
    """
    theta = np.array([THETA[name] for name in names])
    score = np.where(np.isfinite(examples.error), examples.features @ theta, -np.inf)
    best = examples.features[score.argmax(axis=0), np.arange(len(examples.seed))]
    features = none_features(dict(zip(names, best.T, strict=True)))
    values = np.stack(list(features.values()), axis=1)
    scale = np.array([1.0, *(values[:, 1:].std(axis=0) + 1e-6)])  # the first one is the constant
    rows = values / scale
    is_none = examples.error.min(axis=0) > NONE_ERROR
    weight = np.where(examples.is_scored, 1.0, HIDDEN_WEIGHT)
    penalty = NONE_PENALTY * (np.arange(len(scale)) > 0)

    def loss(eta: FloatArray) -> tuple[float, FloatArray]:
        score = rows @ eta
        likelihood = weight @ (np.logaddexp(0.0, score) - is_none * score)
        gradient = rows.T @ (weight * (1.0 / (1.0 + np.exp(-score)) - is_none))
        return float(likelihood + penalty @ eta**2), gradient + 2 * penalty * eta

    eta = minimize(loss, np.zeros(len(penalty)), jac=True).x / scale
    return dict(zip(features, np.round(eta, 2).tolist(), strict=True))


def _searches(
    image: OcclusionPair, rng: np.random.Generator
) -> Iterator[tuple[str, SurfaceSearch, IntArray]]:
    pair, objects = image.pair, image.objects
    settings = PatchMatcherSettings.for_rig(pair.rig)
    matcher, n = PatchMatcher(settings), len(pair.true_px)
    by_size = _with_wild_sizes(expected_disparities(pair), rng)
    height, width = pair.left.shape[:2]
    boxes = np.clip(pair.xyxy_px, -0.5, np.array([width, height, width, height]) - 0.5)
    limit_px = np.full(n, float(settings.max_disparity_px))
    is_on_occluder = (rng.random(n) < OCCLUDER_FRACTION) & np.isfinite(objects.occluder_px)
    track_px = np.where(
        is_on_occluder,
        objects.occluder_px,
        pair.true_px * np.exp(rng.normal(0, TRACK_LOG_SIGMA, n)),
    )
    no_track, no_size = np.full(n, np.nan), ExpectedDisparity.unknown(n)
    measured_px = pair.true_px * np.exp(rng.normal(0, OTHERS_LOG_SIGMA, n))
    is_seen = objects.covered_fraction < MAX_COVERED_FRACTION
    is_fitted = ~objects.is_cut & (objects.kitti_type != "TrafficSign")
    is_fitted &= objects.covered_fraction <= MOST_COVERED
    is_large = (boxes[:, 2:] - boxes[:, :2]).min(axis=1) >= settings.min_side_px
    for way, track, size in zip(
        WAYS,
        (no_track, track_px, track_px, no_track),
        (by_size, by_size, no_size, no_size),
        strict=True,
    ):
        centre_px = by_size.disparity_px if way == "size" else track
        is_measured = is_seen & (way in ("size", "full range"))
        others = OtherBoxes(boxes, np.where(is_measured, measured_px, centre_px))
        known = KnownBoxes(boxes, track, size, limit_px, others)
        is_searched = is_large & is_fitted
        if way != "full range":
            is_searched &= (centre_px >= settings.min_disparity_px) & (centre_px <= limit_px)
        rows = np.flatnonzero(is_searched)
        if not len(rows):
            continue
        if way == "full range":
            yield way, matcher.search_full_range(pair.left, pair.right, known.select(rows)), rows
        else:
            reach_px = settings.size_search_px if way == "size" else settings.search_px
            yield (
                way,
                matcher.search_near(
                    pair.left, pair.right, known.select(rows), centre_px[rows], reach_px
                ),
                rows,
            )


def _with_wild_sizes(by_size: ExpectedDisparity, rng: np.random.Generator) -> ExpectedDisparity:
    n = len(by_size.disparity_px)
    is_wild = rng.random(n) < WILD_FRACTION
    error = np.where(is_wild, rng.normal(0, WILD_LOG_SIGMA, n), 0.0)
    return replace(by_size, disparity_px=by_size.disparity_px * np.exp(error))


def _examples(search: SurfaceSearch, image: OcclusionPair, rows: IntArray) -> _Examples:
    with np.errstate(invalid="ignore", divide="ignore"):
        error = np.abs(image.pair.true_px[rows] / search.disparity_px - 1.0)
    is_surface = np.isfinite(search.surfaces.centre) & (search.surfaces.disparity > 0)
    features = np.where(is_surface[..., None], search.phi.transpose(1, 2, 0), 0.0)
    return _Examples(
        features,
        np.where(is_surface, error, np.inf),
        np.full(len(rows), image.seed),
        is_scored(image.objects, image.pair)[rows],
    )


def _joined(parts: list[_Examples]) -> _Examples:
    return _Examples(
        np.concatenate([part.features for part in parts], axis=1),
        np.concatenate([part.error for part in parts], axis=1),
        np.concatenate([part.seed for part in parts]),
        np.concatenate([part.is_scored for part in parts]),
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


def _failures(examples: _Examples, halves: list[FloatArray]) -> Figures:
    is_surface, n = np.isfinite(examples.error), len(examples.seed)
    score = np.where(examples.seed % 2 == 0, *(examples.features @ theta for theta in halves))
    chosen = np.where(is_surface, score, -np.inf).argmax(axis=0)
    error = examples.error[chosen, np.arange(n)]
    wrong, missing = np.mean(error > FAILURE), np.mean(examples.error.min(axis=0) > FAILURE)
    return {
        "objects": n,
        "chosen_wrong_pct": 100 * float(wrong),
        "not_found_pct": 100 * float(missing),
    }
