"""Risk-coverage curves of distances: errors of the boxes that are answered first, in the order of their relative sigma.

The curves are those of `stereo.evaluation.risk_coverage`, with 1 / d as the disparity: failures are boxes without a
distance or with an error above 15 %.
"""

from __future__ import annotations

from typing import Any

import numpy as np

from track_range.ranging.evaluation.box_evaluation import CLASSES, NEAREST_M
from track_range.ranging.evaluation.errors import BANDS_M, MethodColumn
from track_range.ranging.fitting.labelled_boxes import BoxSet
from track_range.stereo.evaluation.disparity_errors import MatcherColumn
from track_range.stereo.evaluation.risk_coverage import risk_coverage


def distance_risk(boxes: BoxSet, column: MethodColumn) -> dict[str, dict[str, Any]]:
    """Curve and areas by class at 10-100 m; empty for a method without sigma."""
    if not np.isfinite(column.sigma_m).any():
        return {}
    in_span = (boxes.distance_m >= NEAREST_M) & (boxes.distance_m <= BANDS_M[-1])
    known = np.where(np.isfinite(column.distance_m), column.distance_m, np.nan)
    reciprocal = MatcherColumn(1.0 / known, column.sigma_m / known**2)
    curves = {}
    for name in CLASSES:
        rows = np.flatnonzero(in_span & (boxes.class_name == name))
        if len(rows):
            curves[name] = risk_coverage(reciprocal.select(rows), 1.0 / boxes.distance_m[rows])
    return curves
