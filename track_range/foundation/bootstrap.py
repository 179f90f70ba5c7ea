"""Block bootstrap: 95 % confidence intervals of figures whose values depend on one another.

The errors of a track in its frames have a cause in common, and so have those of a drive. Resamples
therefore draw whole blocks: drives with replacement, and in each drawn drive as many tracks as it
has, with replacement. With one drive these are its tracks (Kuensch, "The jackknife and the bootstrap
for general stationary observations", 1989; Davison and Hinkley, "Bootstrap methods and their
application", 1997, section 3.8). All figures of the same resamples are paired, so that the interval of
a difference is that of the differences.

Figures of several methods on the same objects are compared with the smallest one. A method is worse
only if the interval of its difference is above zero and there are enough blocks; the others are not
ranked.
"""

import math
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np

from track_range.foundation.arrays import BoolArray, FloatArray, IntArray

N_RESAMPLES = 500
_FEWEST_BLOCKS = 2  # one block shows no spread
# that five of five blocks agree has a probability of 6 % by chance
FEWEST_BLOCKS = 6
# fraction of the objects below which a method is not compared: too few would be common to all
_MIN_COVERAGE = 0.5
CI95 = "_ci95"  # ending of the keys of intervals, beside the key of the figure


@dataclass(frozen=True, slots=True)
class Resamples:
    """How often each of R resamples has each of B blocks; none with fewer than two blocks."""

    block: IntArray  # (N,) block of each row; -1 = of none
    counts: FloatArray  # (R, B)

    @classmethod
    def of(
        cls, track: IntArray, *, drive: IntArray | None = None, seed: int = 0, rows: BoolArray
    ) -> "Resamples":
        """Resamples of the (N,) tracks, whose numbers may repeat in other drives, of the chosen
        rows (N,).
        """
        drives = np.zeros_like(track) if drive is None else drive
        blocks, index = np.unique(np.stack([drives, track])[:, rows], axis=1, return_inverse=True)
        block = np.full(len(track), -1)
        block[rows] = index.reshape(-1)
        n_blocks, rng = blocks.shape[1], np.random.default_rng(seed)
        names = np.unique(blocks[0])
        if n_blocks < _FEWEST_BLOCKS:
            return cls(block, np.zeros((0, n_blocks)))
        if len(names) == 1:
            drawn = rng.integers(n_blocks, size=(N_RESAMPLES, n_blocks))
            one_drive = np.stack([np.bincount(row, minlength=n_blocks) for row in drawn])
            return cls(block, one_drive.astype(np.float64))
        times = rng.multinomial(len(names), np.full(len(names), 1 / len(names)), N_RESAMPLES)
        counts = np.zeros((N_RESAMPLES, n_blocks))
        for number, name in enumerate(names):
            of_drive = np.flatnonzero(blocks[0] == name)
            n = len(of_drive)
            counts[:, of_drive] = rng.multinomial(times[:, number] * n, np.full(n, 1 / n))
        return cls(block, counts)


@dataclass(frozen=True, slots=True)
class Statistic:
    """A figure of (N,) values, of which NaN do not count: their mean, or the quantile `level`."""

    values: FloatArray
    level: float | None = None
    scale: float = 1.0
    is_root: bool = False  # whether the figure is the square root of the mean, of squares

    def figure(self) -> float | None:
        """The figure of all values; None without a value."""
        known = self.values[np.isfinite(self.values)]
        if not len(known):
            return None
        value = known.mean() if self.level is None else np.quantile(known, self.level)
        return float(self.scale * (np.sqrt(value) if self.is_root else value))

    def of_resamples(self, resamples: Resamples) -> FloatArray:
        """(R,) the figure in each resample; NaN without a value, and of values of one block."""
        known = np.flatnonzero(np.isfinite(self.values) & (resamples.block >= 0))
        n_resamples, n_blocks = resamples.counts.shape
        if len(np.unique(resamples.block[known])) < _FEWEST_BLOCKS:
            return np.full(n_resamples, np.nan)
        block, values = resamples.block[known], self.values[known]
        if self.level is None:
            sums = np.bincount(block, values, n_blocks), np.bincount(block, minlength=n_blocks)
            total, number = (resamples.counts @ part for part in sums)
            mean = total / np.where(number > 0, number, np.nan)
            return np.asarray(self.scale * (np.sqrt(mean) if self.is_root else mean))
        order = np.argsort(values, kind="stable")
        return self.scale * _quantiles(
            values[order], block[order], counts=resamples.counts, level=self.level
        )


def _quantiles(
    ordered: FloatArray, block: IntArray, *, counts: FloatArray, level: float
) -> FloatArray:
    """(R,) quantiles, as `np.quantile`, of ordered values (N,) that are repeated as their blocks.

    The numbers of values up to the end of bins of sqrt(N) values show in which bin each quantile
    is, so that N values are not counted in each of R resamples.
    """
    n, n_blocks = len(ordered), counts.shape[1]
    width = math.isqrt(n)
    bins = np.arange(n) // width
    n_bins = int(bins[-1]) + 1
    in_bins = np.bincount(block * n_bins + bins, minlength=n_blocks * n_bins)
    ends = np.cumsum(counts @ in_bins.reshape(n_blocks, n_bins), axis=1)
    starts = np.concatenate([np.zeros((len(ends), 1)), ends], axis=1)
    resample = np.arange(len(counts))

    def at(index: FloatArray) -> FloatArray:
        """(R,) values at this place, from 0, of the repeated values."""
        of_bin = np.minimum((ends <= index[:, None]).sum(axis=1), n_bins - 1)
        places = of_bin[:, None] * width + np.arange(width)
        is_inside = places < n
        places = np.minimum(places, n - 1)
        weights = np.where(is_inside, counts[resample[:, None], block[places]], 0)
        upto = starts[resample, of_bin][:, None] + np.cumsum(weights, axis=1)
        inside = (upto <= index[:, None]).sum(axis=1)
        return np.asarray(ordered[np.minimum(of_bin * width + inside, n - 1)])

    total = ends[:, -1]
    place = level * np.maximum(total - 1, 0)
    low, high = at(np.floor(place)), at(np.ceil(place))
    return np.where(total > 0, low + (place - np.floor(place)) * (high - low), np.nan)


def interval(figures: FloatArray) -> list[float] | None:
    """The 95 % interval of a figure from its values (R,) in resamples; None without a value."""
    known = figures[np.isfinite(figures)]
    return np.percentile(known, [2.5, 97.5]).round(4).tolist() if len(known) else None


def figures_of(
    statistics: Mapping[str, Statistic], resamples: Resamples | None = None
) -> dict[str, Any]:
    """Figures by name, and with resamples `NAME_ci95`, [low, high], of those that have an
    interval.
    """
    figures: dict[str, Any] = {}
    for name, statistic in statistics.items():
        value = statistic.figure()
        figures[name] = None if value is None else round(value, 4)
        if resamples is not None and (ends := interval(statistic.of_resamples(resamples))):
            figures[name + CI95] = ends
    return figures


def measured_by_all(
    values: Mapping[str, FloatArray], rows: BoolArray
) -> tuple[BoolArray, tuple[str, ...]]:
    """The rows (N,) that all compared methods measured, and the names of these methods: those that
    measured at least half of `rows`. `values` are (N,) by method, NaN = not measured.
    """
    is_measured = {name: np.isfinite(column) & rows for name, column in values.items()}
    fewest = _MIN_COVERAGE * rows.sum()
    names = tuple(name for name, mask in is_measured.items() if mask.sum() >= max(fewest, 1))
    common = np.all([rows, *(is_measured[name] for name in names)], axis=0)
    return common, names


def paired_differences(
    statistics: Mapping[str, Statistic], resamples: Resamples, key: str
) -> dict[str, Any]:
    """The figure `key` of each method, smaller = better, and its difference from the smallest one,
    with 95 % intervals, as plain values for JSON.

    `is_worse`: whether the difference is more than noise; None = too few blocks, or the smallest
    figure itself. Empty without a figure.
    """
    figures = {name: statistic.figure() for name, statistic in statistics.items()}
    known = {name: value for name, value in figures.items() if value is not None}
    if not known:
        return {}
    reference = min(known, key=known.__getitem__)
    drawn = {name: statistics[name].of_resamples(resamples) for name in known}
    n_blocks = resamples.counts.shape[1]
    methods = {}
    for name, value in known.items():
        row: dict[str, Any] = {key: round(value, 4)}
        if (ends := interval(drawn[name])) is not None:
            row[key + CI95] = ends
        if name != reference:
            row["difference"] = round(value - known[reference], 4)
            row["is_worse"] = None
            ends = interval(drawn[name] - drawn[reference])
            if ends is not None:
                row["difference" + CI95] = ends
            if ends is not None and n_blocks >= FEWEST_BLOCKS:
                row["is_worse"] = ends[0] > 0
        methods[name] = row
    return {"reference": reference, "n_blocks": n_blocks, "methods": methods}
