"""Data of the report's charts of distance errors and of the calibration of sigma.

error = distance / truth - 1        z = |distance - truth| / sigma        P(z <= k) = erf(k / sqrt 2) if normal
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np
from scipy.special import erfinv

from track_range.foundation.arrays import FloatArray
from track_range.results.rows.rows import Rows
from track_range.views.report.content.series import thinned
from track_range.views.tables import WITHIN_1_SIGMA, WITHIN_2_SIGMA, figure

# maximum number of points of one method in the chart of errors; more would overlap
SCATTER_POINTS = 1500
BAND_M = 10.0  # width in metres of the distance bands of the median line
MIN_IN_BAND = 3  # minimum number of errors in a band for a median
EXPECTED_FRACTIONS = np.arange(0.05, 1.0, 0.05)  # expected within k sigma, of the calibration curve


def error_curves(rows: Rows, summary: Mapping[str, Any]) -> dict[str, dict[str, Any]]:
    """Points (x: true distance in m, y: signed error in %) and a line of medians by distance band,
    per method.

    Without truth in the rows, the line holds the mean absolute error of each distance band in
    the summary.
    """
    curves = {}
    truth_m = _scored_truth_m(rows)
    for method in rows.methods_measured:
        distance_m, _ = rows.distance(method)
        known = np.flatnonzero(np.isfinite(distance_m) & (truth_m > 0))
        known = known[np.argsort(truth_m[known], kind="stable")]
        error_pct = 100.0 * (distance_m[known] / truth_m[known] - 1.0)
        if len(known):
            shown = thinned(len(known), SCATTER_POINTS) if not method.endswith("_kf") else slice(0)
            curves[method] = {
                "points": [_rounded(truth_m[known][shown]), _rounded(error_pct[shown])],
                "line": [_rounded(part) for part in median_by_distance(truth_m[known], error_pct)],
            }
    if curves:
        return curves
    lines = {method: band_line(row) for method, row in (summary.get("methods") or {}).items()}
    return {
        method: {"points": [[], []], "line": [list(part) for part in zip(*line, strict=True)]}
        for method, line in lines.items()
        if line
    }


def _scored_truth_m(rows: Rows) -> FloatArray:
    """(N,) true distances that the tables' errors refer to; see `results.summary`."""
    return rows["scored_truth_m" if "scored_truth_m" in rows else "truth_m"]


def band_line(row: Mapping[str, Any]) -> list[tuple[float, float]]:
    """(Middle of a distance band in m, mean absolute error there in %) for a method's row of a
    summary.
    """
    return [
        ((band["from_m"] + band["to_m"]) / 2, error_pct)
        for band in row.get("bands") or []
        if (error_pct := figure(band, "mean_relative_error_pct")) is not None
    ]


def median_by_distance(
    distance_m: FloatArray, error_pct: FloatArray
) -> tuple[FloatArray, FloatArray]:
    """Middles in m of distance bands of width `BAND_M`, and median error in each with at least
    `MIN_IN_BAND` errors.
    """
    known = np.isfinite(distance_m) & np.isfinite(error_pct)
    band = np.floor(distance_m[known] / BAND_M)
    medians = [
        (BAND_M * (b + 0.5), np.median(error_pct[known][band == b]))
        for b in np.unique(band)
        if np.sum(band == b) >= MIN_IN_BAND
    ]
    middles_m, median_pct = np.array(medians, np.float64).reshape(-1, 2).T
    return middles_m, median_pct


def calibration_curves(rows: Rows, summary: Mapping[str, Any]) -> dict[str, dict[str, Any]]:
    """Fractions of errors expected (x) and observed (y) within k sigma, in %, per method.

    Without truth in the rows, the line holds the summary's fractions within one and two sigma.
    """
    k = np.sqrt(2.0) * erfinv(EXPECTED_FRACTIONS)
    curves: dict[str, dict[str, Any]] = {}
    truth_m = _scored_truth_m(rows)
    for method in rows.methods_measured:
        distance_m, sigma_m = rows.distance(method)
        error_m = np.abs(distance_m - truth_m)
        known = np.isfinite(error_m) & (sigma_m > 0) & (truth_m > 0)
        z = np.sort(error_m[known] / sigma_m[known])
        if len(z):
            observed = np.searchsorted(z, k, side="right") / len(z)
            curves[method] = {
                "line": [_rounded(100.0 * EXPECTED_FRACTIONS), _rounded(100.0 * observed)],
                "n": len(z),
            }
    if curves:
        return curves
    for method, row in (summary.get("methods") or {}).items():
        observed_at = {
            WITHIN_1_SIGMA: figure(row, "within_1_sigma"),
            WITHIN_2_SIGMA: figure(row, "within_2_sigma"),
        }
        fractions = {
            expected: fraction for expected, fraction in observed_at.items() if fraction is not None
        }
        if fractions:
            x, y = (
                [100 * expected for expected in fractions],
                [100 * fraction for fraction in fractions.values()],
            )
            curves[method] = {"line": [x, y], "n": row.get("n")}
    return curves


def _rounded(values: FloatArray) -> list[float]:
    return [round(float(value), 2) for value in values]
