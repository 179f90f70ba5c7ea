"""Occlusion: errors of stereo matchers for road users behind poles, signs, fences, bushes and nearer vehicles.

Simulated drives of the scenario `occlusion` with exact truth (`benchmarks/inputs/occlusion_pairs.py`). Half of the
boxes are those of the visible part, the others those of the whole object. The full range is searched in unrelated
images (four per seed); in sequences (six frames at 10 frames/s per seed), the last disparity of a track is the prior,
as in a run. All road users and signs are given to the matchers; counted are vehicles and people at 5-60 m that are at
least half visible, with at most 75 % of their part in the inner half of the box covered. Failures are objects without a
value (refused) or with an error above 15 % (wrong). `covered` is the fraction of the part in the inner half that
something nearer covers. Intervals are 95 % bootstrap intervals over drives.

Seeds 0-19 are for development: settings of a matcher may be fitted to them. Seeds from 100 are for judgement only.
Goals, over both parts together: failures at most a third of those of `sgbm-hh`, and at most 2 %.
"""

from __future__ import annotations

import argparse
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import replace
from typing import Any

import numpy as np
from rich.console import Console

from benchmarks.inputs.occlusion_pairs import OcclusionPair, is_scored, sequences, unrelated_pairs
from benchmarks.plain_tables import figure_text, plain_table
from track_range.evaluation.expected_disparities import expected_disparities
from track_range.foundation.arrays import BoolArray
from track_range.stereo.evaluation.disparity_errors import MatcherColumn, Objects, figures_with_intervals
from track_range.stereo.evaluation.kitti_2015 import StereoPair
from track_range.stereo.matching.box_matchers import MATCHER_NAMES, measure_pairs

MATCHERS = ("patch", "sgbm", "sgbm-hh")
"""Names of the compared matchers."""

REFERENCE = "sgbm-hh"
"""Matcher with which the failures of the others are compared."""

KINDS = ("none", "pole", "sign", "fence", "bush", "road user", "scenery")
"""Kinds of occluders, in the order of the tables."""

COVERED = ((-1.0, 0.0), (0.0, 0.25), (0.25, 0.5), (0.5, 0.75))
"""Intervals of the covered share, without the lower and with the upper end; the first one is 0."""

PARTS: dict[str, Callable[[range], Iterator[OcclusionPair]]] = {"unrelated": unrelated_pairs, "sequences": sequences}
"""Function of each part that renders its pairs."""


def add_options(parser: argparse.ArgumentParser) -> None:
    """Add the options of this workload."""
    parser.add_argument("--first-seed", type=int, default=100, help="first random seed; 0-19 are for development")
    parser.add_argument("--seeds", type=int, default=20, help="number of drives")
    parser.add_argument("--matchers", nargs="+", default=MATCHERS, choices=MATCHER_NAMES, help="compared matchers")
    parser.add_argument("--parts", nargs="+", default=list(PARTS), choices=list(PARTS), help="parts to measure")


def measure(options: argparse.Namespace) -> dict[str, Any]:
    """Figures by part, occluder and covered share; prints the tables."""
    seeds = range(options.first_seed, options.first_seed + options.seeds)
    measured = {name: _Measured(PARTS[name](seeds), options.matchers) for name in options.parts}
    both = _figures(list(measured.values()))
    figures = {name: _figures([part]) for name, part in measured.items()} if len(measured) > 1 else {}
    figures["all"] = both
    for name, by_group in figures.items():
        _print(name, by_group, options.matchers)
    ratios = _ratios(both["all"])
    for name, ratio in ratios.items():
        Console().print(f"Failures of {name} relative to {REFERENCE}: {ratio:.2f} (goal 0.33)")
    return {"first_seed": options.first_seed, "seeds": options.seeds, "ratios": ratios, **figures}


def _ratios(by_matcher: Mapping[str, dict[str, Any]]) -> dict[str, float]:
    """Failures of each matcher relative to those of the reference, if it was measured and has failures."""
    reference = by_matcher.get(REFERENCE, {}).get("failures_pct")
    return {
        name: row["failures_pct"] / reference for name, row in by_matcher.items() if reference and name != REFERENCE
    }


class _Measured:
    """Scored objects of one part with their disparities and strata."""

    def __init__(self, pairs: Iterator[OcclusionPair], matchers: Sequence[str]) -> None:
        scored: list[BoolArray] = []
        seed, kind, covered, is_modal, class_name = (list[Any]() for _ in range(5))

        def recorded() -> Iterator[StereoPair]:
            for occlusion in pairs:
                is_counted = is_scored(occlusion.objects, occlusion.pair)
                objects = occlusion.objects.select(is_counted)
                scored.append(is_counted)
                seed.extend([occlusion.seed] * len(objects))
                kind.extend(objects.kind.tolist())
                covered.extend(objects.covered_inner.tolist())
                is_modal.extend(objects.is_modal.tolist())
                names = np.array(occlusion.pair.class_names, np.str_)
                class_name.extend(names[is_counted].tolist())
                yield occlusion.pair

        results = measure_pairs(recorded(), matchers, expected=expected_disparities)
        rows = np.concatenate(scored)
        self.objects: Objects = replace(results.objects.select(rows), group=np.array(seed, np.int64))
        self.columns: dict[str, MatcherColumn] = {name: column.select(rows) for name, column in results.columns.items()}
        self.kind, self.class_name = np.array(kind, np.str_), np.array(class_name, np.str_)
        self.covered, self.is_modal = np.array(covered, np.float64), np.array(is_modal, np.bool_)

    def groups(self) -> dict[str, BoolArray]:
        """Rows of each stratum by its name in the tables."""
        groups = {"all": np.ones(len(self.kind), np.bool_)}
        groups |= {f"occluder {kind}": self.kind == kind for kind in KINDS}
        for low, high in COVERED:
            name = "covered 0 %" if high == 0 else f"covered {100 * low:.0f}-{100 * high:.0f} %"
            groups[name] = (self.covered > low) & (self.covered <= high)
        groups |= {f"class {name}": self.class_name == name for name in ("car", "truck", "person", "bicycle")}
        return groups | {"box of visible part": self.is_modal, "box of whole object": ~self.is_modal}


def _figures(parts: Sequence[_Measured]) -> dict[str, dict[str, dict[str, Any]]]:
    """Figures of each matcher by stratum over one or several parts."""
    figures: dict[str, dict[str, dict[str, Any]]] = {}
    for group in parts[0].groups():
        rows = [part.groups()[group] for part in parts]
        objects = _joined_objects([part.objects.select(chosen) for part, chosen in zip(parts, rows, strict=True)])
        figures[group] = {}
        for name in parts[0].columns:
            columns = [part.columns[name].select(chosen) for part, chosen in zip(parts, rows, strict=True)]
            column = MatcherColumn(
                *(np.concatenate([getattr(c, key) for c in columns]) for key in MatcherColumn.__slots__)
            )
            figures[group][name] = figures_with_intervals(column, objects)
    return figures


def _joined_objects(parts: Sequence[Objects]) -> Objects:
    """The objects of several parts; their pairs are not used."""
    true_px, focal_baseline_m, x_px, pair, group = (
        np.concatenate([getattr(part, name) for part in parts])
        for name in ("true_px", "focal_baseline_m", "x_px", "pair", "group")
    )
    return Objects(true_px, focal_baseline_m, x_px, pair, group, cameras=())


def _print(part: str, figures: Mapping[str, Mapping[str, dict[str, Any]]], matchers: Sequence[str]) -> None:
    headings = ("n", "failed %", "95 % interval", "wrong %", "refused %", "median %", "95 %", "1 sigma %", "2 sigma %")
    table = plain_table(f"Occlusion, {part}", "objects", "matcher", *headings, n_words=2)
    for group, by_matcher in figures.items():
        for matcher in matchers:
            row = by_matcher[matcher]
            if row["n"]:
                table.add_row(group if matcher == matchers[0] else "", matcher, *_cells(row))
    Console().print(table)


def _cells(row: Mapping[str, Any]) -> list[str]:
    low, high = row["intervals"].get("failures_pct", (None, None))
    return [
        str(row["n"]),
        figure_text(row["failures_pct"], digits=1),
        f"{figure_text(low, digits=1)} .. {figure_text(high, digits=1)}",
        figure_text(row["wrong_pct"], digits=1),
        figure_text(100 * (1 - row["coverage"]), digits=1),
        figure_text(row["median_relative_error_pct"]),
        figure_text(row["p95_relative_error_pct"], digits=1),
        figure_text(row["within_1_sigma"], digits=0, times=100),
        figure_text(row["within_2_sigma"], digits=0, times=100),
    ]
