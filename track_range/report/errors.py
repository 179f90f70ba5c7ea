"""How wrong a run's distances are, and whether their sigmas knew it: the numbers of the report's charts.

error = distance / truth - 1        z = |distance - truth| / sigma        P(z <= k) = erf(k / sqrt 2) if normal
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np
from scipy.special import erfinv

from track_range.foundation.arrays import FloatArray
from track_range.report.series import column, thinned
from track_range.report.tables import WITHIN_1_SIGMA, WITHIN_2_SIGMA, figure
from track_range.results.columns import Columns, methods_measured

SCATTER_POINTS = 1500
"""Points of one method in the chart of errors; more would hide each other."""

BAND_M = 10.0
"""Width of the bands that medians are of."""

MIN_IN_BAND = 3

EXPECTED_SHARES = np.arange(0.05, 1.0, 0.05)

_SHARE_KEYS = ((WITHIN_1_SIGMA, "within_1_sigma"), (WITHIN_2_SIGMA, "within_2_sigma"))


def error_curves(columns: Columns, summary: Mapping[str, Any]) -> dict[str, dict[str, Any]]:
    """Per method points (x: true distance in m, y: error in %) and a line of medians by band of distance.

    Where the rows know no truth, the line is the mean error of each of the summary's bands, without a sign.
    """
    found = {}
    for method in methods_measured(columns):
        truth_m, error_pct = _errors_pct(columns, method)
        if len(truth_m):
            shown = thinned(len(truth_m), SCATTER_POINTS) if not method.endswith("_kf") else slice(0)
            found[method] = {
                "points": [_rounded(truth_m[shown]), _rounded(error_pct[shown])],
                "line": [_rounded(part) for part in median_by_distance(truth_m, error_pct)],
            }
    return found or _curves_of_bands(summary)


def _errors_pct(columns: Columns, method: str) -> tuple[FloatArray, FloatArray]:
    truth_m, distance_m = _scored_truth_m(columns), column(columns, f"{method}_m")
    known = np.isfinite(distance_m) & (truth_m > 0)
    order = np.argsort(truth_m[known], kind="stable")
    truth_m, distance_m = truth_m[known][order], distance_m[known][order]
    return truth_m, 100.0 * (distance_m / truth_m - 1.0)


def _scored_truth_m(columns: Columns) -> FloatArray:
    """The truth that the tables' errors are of, where the columns tell it apart (`results.truth`)."""
    return column(columns, "scored_truth_m" if "scored_truth_m" in columns else "truth_m")


def _curves_of_bands(summary: Mapping[str, Any]) -> dict[str, dict[str, Any]]:
    found = {}
    for method, row in (summary.get("methods") or {}).items():
        line = band_line(row)
        if line:
            found[method] = {"points": [[], []], "line": [list(part) for part in zip(*line, strict=True)]}
    return found


def band_line(row: Mapping[str, Any]) -> list[tuple[float, float]]:
    """Middle of each band of distance, in m, and the mean error of a summary's method there, in %."""
    return [
        ((band["from_m"] + band["to_m"]) / 2, error_pct)
        for band in row.get("bands") or []
        if (error_pct := figure(band, "mean_relative_error_pct")) is not None
    ]


def median_by_distance(distance_m: FloatArray, error_pct: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Middles of ten-metre bands and the median error in each that has at least three errors."""
    known = np.isfinite(distance_m) & np.isfinite(error_pct)
    band = np.floor(distance_m[known] / BAND_M)
    found = [
        (BAND_M * (b + 0.5), np.median(error_pct[known][band == b]))
        for b in np.unique(band)
        if np.sum(band == b) >= MIN_IN_BAND
    ]
    middles_m, medians = np.array(found, np.float64).reshape(-1, 2).T
    return middles_m, medians


def calibration_curves(columns: Columns, summary: Mapping[str, Any]) -> dict[str, dict[str, Any]]:
    """Per method the share of errors expected within k sigma (x, in %) and the share observed (y).

    Where the rows know no truth, the summary's shares within one and two sigma.
    """
    k = np.sqrt(2.0) * erfinv(EXPECTED_SHARES)
    found = {}
    for method in methods_measured(columns):
        z = _errors_in_sigmas(columns, method)
        if len(z):
            observed = np.searchsorted(np.sort(z), k, side="right") / len(z)
            found[method] = {"line": [_rounded(100.0 * EXPECTED_SHARES), _rounded(100.0 * observed)], "n": len(z)}
    return found or _curves_of_shares(summary)


def _errors_in_sigmas(columns: Columns, method: str) -> FloatArray:
    truth_m, sigma_m = _scored_truth_m(columns), column(columns, f"{method}_sigma_m")
    error_m = np.abs(column(columns, f"{method}_m") - truth_m)
    known = np.isfinite(error_m) & (sigma_m > 0) & (truth_m > 0)
    return error_m[known] / sigma_m[known]


def _curves_of_shares(summary: Mapping[str, Any]) -> dict[str, dict[str, Any]]:
    found = {}
    for method, row in (summary.get("methods") or {}).items():
        known = [
            (100 * expected, 100 * share) for expected, key in _SHARE_KEYS if (share := figure(row, key)) is not None
        ]
        if known:
            found[method] = {"line": [list(part) for part in zip(*known, strict=True)], "n": row.get("n")}
    return found


def _rounded(values: FloatArray) -> list[float]:
    return [round(float(value), 2) for value in values]
