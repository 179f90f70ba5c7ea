"""Risk-coverage curves: errors of the boxes that are answered first, in the order of their uncertainty.

    A = (1 / N) sum_k r(k)      r(k): risk of the k most certain of N boxes

The risk is the fraction of failures, for which boxes without a value come last, or the mean relative error, over boxes
with a value. The uncertainty is the standard deviation relative to the disparity, or another measure. A small area A
means that the errors are small, and that the uncertain boxes are the wrong ones. (Geifman and El-Yaniv, "Selective
classification for deep neural networks", NIPS 2017.)
"""

from __future__ import annotations

import math
from typing import Any

import numpy as np

from track_range.foundation.arrays import FloatArray, IntArray
from track_range.stereo.evaluation.disparity_errors import FAILURE, MatcherColumn, figures

STEP_PCT = 5  # step of the answered fraction along a curve, per cent
_KEYS = ("failures_pct", "mean_relative_error_pct", "p95_relative_error_pct")  # figures of the answered boxes


def risk_coverage(column: MatcherColumn, true_px: FloatArray, uncertainty: FloatArray | None = None) -> dict[str, Any]:
    """The curve of one matcher for N boxes, with a row per answered fraction, and its areas, as plain values for JSON.

    The areas are those under the curves of failures and of the mean relative error, per cent; the latter is None
    without a value. Boxes are sorted by `uncertainty` (N,), larger = less certain; None = the relative sigma.
    """
    order = certain_first(column, uncertainty)
    disparity_px, expected_px = column.disparity_px[order], true_px[order]
    error = np.abs(expected_px / disparity_px - 1)
    is_failure = ~(error <= FAILURE)  # true for NaN
    known = error[np.isfinite(error)]
    n, count = len(error), np.arange(1, len(error) + 1)
    rows = []
    for answered_pct in range(STEP_PCT, 100 + STEP_PCT, STEP_PCT):
        first = order[: math.ceil(n * answered_pct / 100)]
        figure = figures(column.select(first), true_px[first])
        rows.append({"answered_pct": answered_pct, "n": len(first), **{key: figure[key] for key in _KEYS}})
    means = np.cumsum(known) / count[: len(known)]
    return {
        "area_failures_pct": round(float(100 * (np.cumsum(is_failure) / count).mean()), 4) if n else None,
        "area_error_pct": round(float(100 * means.mean()), 4) if len(known) else None,
        "curve": rows,
    }


def certain_first(column: MatcherColumn, uncertainty: FloatArray | None = None) -> IntArray:
    """(N,) rows of the boxes from the most to the least certain one, boxes without a value last.

    Equal uncertainties are in the order of the relative sigma.
    """
    relative_sigma = column.sigma_px / column.disparity_px
    measure = relative_sigma if uncertainty is None else uncertainty
    is_missing = ~np.isfinite(column.disparity_px)
    return np.lexsort((relative_sigma, np.where(np.isfinite(measure), measure, np.inf), is_missing))
