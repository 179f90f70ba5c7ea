"""Errors of two runs on the boxes that both measured, and whether their difference is more than noise.

The differences are of resamples of whole true tracks (`foundation.bootstrap`): both runs measure the
same boxes, so that what is hard for both does not count, and boxes of one track count as one.
"""

from collections.abc import Callable, Iterator
from dataclasses import dataclass

import numpy as np

from track_range.foundation.arrays import FloatArray
from track_range.foundation.bootstrap import FEWEST_BLOCKS, Resamples, interval
from track_range.ranging.truth.errors import MethodColumn, distance_statistics
from track_range.results.rows.rows import Rows
from track_range.views.tables import NOTHING, WITHIN_1_SIGMA, Cell, Grid

NO_DIFFERENCE = "no difference within noise"
TOO_FEW = f"too few tracks ({{n}} of at least {FEWEST_BLOCKS})"
_SAME_TRUTH_M = 1e-6  # largest difference of the true distances of one label

# heading and key of a figure, its format, and what is smaller where the figure is better
_FIGURES: tuple[tuple[str, str, str, Callable[[FloatArray], FloatArray]], ...] = (
    ("median error, %", "median_relative_error_pct", "{:.2f}", np.abs),
    ("mean error, %", "mean_relative_error_pct", "{:.2f}", np.abs),
    ("bias, %", "bias_pct", "{:+.2f}", np.abs),
    ("within 25 %, fraction", "within_25_percent", "{:.3f}", np.negative),
    (
        "within one sigma, fraction",
        "within_1_sigma",
        "{:.3f}",
        lambda value: np.abs(value - WITHIN_1_SIGMA),
    ),
)


@dataclass(frozen=True, slots=True)
class _Side:
    """The rows of a run that match a label whose distance counts, by label."""

    rows: Rows
    key: FloatArray  # (K,) number of the label

    @classmethod
    def of(cls, rows: Rows) -> "_Side":
        if not {"scored_truth_m", "truth_track"} <= rows.columns.keys():
            return cls(rows.select(slice(0, 0)), np.zeros(0))
        scored = rows.select(np.isfinite(rows["scored_truth_m"]))
        return cls(scored, scored["truth_track"] * 2.0**32 + scored["frame"])


def paired_grid(names: tuple[str, str], runs: tuple[Rows, Rows], seed: int = 0) -> Grid:
    """A row per method and figure, with the difference and its 95 % interval; without rows if the
    runs have no labels in common.
    """
    first, second = (_Side.of(rows) for rows in runs)
    _, *places = np.intersect1d(first.key, second.key, return_indices=True)
    sides = [side.rows.select(index) for side, index in zip((first, second), places, strict=True)]
    truths = [side["scored_truth_m"] if len(side) else np.zeros(0) for side in sides]
    rows: list[tuple[Cell, ...]] = []
    if len(truths[0]) and np.abs(truths[1] - truths[0]).max() <= _SAME_TRUTH_M:
        methods = [name for name in sides[0].methods_measured if name in sides[1].methods_measured]
        for method in methods:
            rows += _method_rows(method, names, (sides[0], sides[1]), seed)
    columns = (
        "method",
        "figure",
        "boxes",
        "tracks",
        *names,
        "difference",
        "95 % interval",
        "result",
    )
    title = f"Errors on the boxes that both runs measured: {names[0]} and {names[1]}"
    return Grid(title, columns, tuple(rows))


def _method_rows(
    method: str, names: tuple[str, str], sides: tuple[Rows, Rows], seed: int
) -> Iterator[tuple[Cell, ...]]:
    true_m, track = sides[0]["scored_truth_m"], sides[0]["truth_track"]
    columns = [MethodColumn(*side.distance(method)) for side in sides]
    both = np.all([np.isfinite(column.distance_m) for column in columns], axis=0)
    resamples = Resamples.of(track, seed=seed, rows=both)
    first, second = (distance_statistics(column, true_m, both) for column in columns)
    n_tracks = len(np.unique(track[both]))
    has_few = n_tracks < FEWEST_BLOCKS
    for heading, key, pattern, cost in _FIGURES:
        pair = first[key], second[key]
        values = [value for statistic in pair if (value := statistic.figure()) is not None]
        if len(values) < len(pair):
            continue
        texts = [pattern.format(value) for value in values]
        drawn = [statistic.of_resamples(resamples) for statistic in pair]
        better = None if has_few else _better(drawn, cost)
        ends = interval(drawn[1] - drawn[0])
        signed = pattern.replace("{:.", "{:+.")
        cells = [Cell(text, number == better) for number, text in enumerate(texts)]
        yield (
            *map(Cell, (method, heading, str(int(both.sum())), str(n_tracks))),
            *cells,
            Cell(signed.format(values[1] - values[0])),
            Cell(NOTHING if ends is None else " to ".join(map(signed.format, ends))),
            Cell(_result(better, names) if not has_few else TOO_FEW.format(n=n_tracks)),
        )


def _result(better: int | None, names: tuple[str, str]) -> str:
    return NO_DIFFERENCE if better is None else f"{names[better]} is better"


def _better(drawn: list[FloatArray], cost: Callable[[FloatArray], FloatArray]) -> int | None:
    """The run whose figure is nearer to the best one in 95 % of the resamples; None = neither."""
    ends = interval(cost(drawn[1]) - cost(drawn[0]))
    if ends is None or ends[0] <= 0 <= ends[1]:
        return None
    return int(ends[1] < 0)
