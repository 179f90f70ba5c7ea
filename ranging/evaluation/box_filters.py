"""Temporal filters for the measured distances of labelled boxes, per track as in a run.

The ego speed is not known: the filter of Zhang et al. (`paper_filter`) assumes 0, and the default one
(`ranging.filtering.distance_filter`) estimates the relative speed.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import Literal

import numpy as np

from track_range.foundation.arrays import FloatArray
from track_range.ranging.evaluation.box_evaluation import frame_rows
from track_range.ranging.evaluation.errors import MethodColumn
from track_range.ranging.evaluation.paper_filter import PaperFilter
from track_range.ranging.filtering.distance_filter import DistanceFilters, FilteredRanges
from track_range.ranging.fitting.labelled_boxes import BoxSet
from track_range.ranging.ranges import Ranges

FilterName = Literal["none", "paper", "default"]

_Filter = Callable[[Ranges, float], FilteredRanges]
"""Function from the measured ranges and the time of a frame to filtered ranges."""

_NOISE_FRACTION = 0.6  # initial independent fraction of sigma for the default filter, that of mono


def _default_filter() -> _Filter:
    filters = DistanceFilters({"": _NOISE_FRACTION})
    return lambda measured, time_s: filters.update({"": measured}, time_s)[""]


_FILTERS: Mapping[str, Callable[[], _Filter]] = {"paper": lambda: PaperFilter().update, "default": _default_filter}

_UNKNOWN_SIGMA = 0.1  # relative sigma that is assumed for methods without a sigma (plain curves)


@dataclass(frozen=True, slots=True)
class FilteredColumn:
    """Filtered distances and sigmas of a method, and (N,) closing speed in m/s; NaN = unknown."""

    column: MethodColumn
    closing_mps: FloatArray


def filtered(boxes: BoxSet, column: MethodColumn, filter_name: FilterName) -> FilteredColumn:
    """Filtered distances of a method; for "none" the unfiltered ones, with NaN as closing speed."""
    if filter_name == "none":
        return FilteredColumn(column, np.full(len(boxes), np.nan))
    is_given = np.isfinite(column.sigma_m)
    sigma_m = np.where(is_given, column.sigma_m, _UNKNOWN_SIGMA * column.distance_m)
    distance_m, out_sigma_m, closing_mps = np.full((3, len(boxes)), np.nan)
    sequence, update = -1, _FILTERS[filter_name]()
    for rows in frame_rows(boxes):
        if boxes.sequence[rows[0]] != sequence:
            sequence, update = boxes.sequence[rows[0]], _FILTERS[filter_name]()
        systematic_m = None if column.sigma_systematic_m is None else column.sigma_systematic_m[rows]
        measured = Ranges(boxes.track_id[rows], column.distance_m[rows], sigma_m[rows], systematic_m)
        result = update(measured, float(boxes.time_s[rows[0]]))
        distance_m[rows], out_sigma_m[rows] = result.ranges.distance_m, result.ranges.sigma_m
        closing_mps[rows] = -result.rate_mps
    return FilteredColumn(MethodColumn(distance_m, np.where(is_given.any(), out_sigma_m, np.nan)), closing_mps)
