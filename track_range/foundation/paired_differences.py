"""Differences between methods on the same objects, and which of them are more than noise.

A figure of each method is compared with the smallest one. All methods have the same resamples of
whole blocks (`foundation.bootstrap`), so that what is hard for all of them does not count. A method is
worse only if the 95 % interval of its difference is above zero and there are enough blocks; the others
are not ranked.
"""

from collections.abc import Mapping
from typing import Any

import numpy as np

from track_range.foundation.arrays import BoolArray, FloatArray
from track_range.foundation.bootstrap import CI95, Resamples, Statistic, interval

# that five of five blocks agree has a probability of 6 % by chance
FEWEST_BLOCKS = 6
# fraction of the objects below which a method is not compared: too few would be common to all
_MIN_COVERAGE = 0.5


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
