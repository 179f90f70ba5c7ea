"""Metrics of published evaluations of distances (Eigen, Puhrsch and Fergus, NIPS 2014).

abs rel   mean |d - t| / t              sq rel   mean (d - t)^2 / t            d: measured, t: reference distance
RMSE      sqrt(mean (d - t)^2)          RMSE log sqrt(mean (log d - log t)^2)
delta_k   fraction of max(d / t, t / d) < 1.25^k
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np

from track_range.foundation.arrays import FloatArray
from track_range.ranging.evaluation.errors import MethodColumn
from track_range.ranging.fitting.labelled_boxes import CLASS_OF, BoxSet

ALL = "all"  # name of the row over all classes
_MIN_M = 0.1  # smallest distance in m in ratios and logarithms: polynomials may be negative

METRICS = ("abs_rel", "sq_rel_m", "rmse_m", "rmse_log", "delta_1_25", "delta_1_25_2", "delta_1_25_3")
"""Keys of the metrics."""


def literature_metrics(boxes: BoxSet, columns: Mapping[str, MethodColumn]) -> dict[str, dict[str, dict[str, Any]]]:
    """Metrics by method and class, and over all classes, of all boxes with a reference distance."""
    kinds = {name: boxes.class_name == name for name in CLASS_OF.values() if (boxes.class_name == name).any()}
    kinds[ALL] = np.ones(len(boxes), np.bool_)
    return {
        method: {
            kind: {"n_boxes": int(rows.sum()), **metrics(column.distance_m[rows], boxes.distance_m[rows])}
            for kind, rows in kinds.items()
        }
        for method, column in columns.items()
    }


def metrics(distance_m: FloatArray, reference_m: FloatArray) -> dict[str, Any]:
    """Coverage and metrics of (N,) distances, NaN = not measured, against (N,) references; None without a distance."""
    known = np.isfinite(distance_m)
    d, t = distance_m[known], reference_m[known]
    coverage = {"coverage": round(float(known.mean()), 4) if len(known) else None, "n": len(d)}
    if not len(d):
        return {**coverage, **dict.fromkeys(METRICS)}
    positive_m = np.maximum(d, _MIN_M)
    ratio = np.maximum(positive_m / t, t / positive_m)
    values = (
        np.abs(d - t) / t,
        (d - t) ** 2 / t,
        (d - t) ** 2,
        np.log(positive_m / t) ** 2,
        *(ratio < 1.25**k for k in (1, 2, 3)),
    )
    means = [float(np.mean(value)) for value in values]
    means[2:4] = np.sqrt(means[2:4]).tolist()
    return {**coverage, **{key: round(mean, 4) for key, mean in zip(METRICS, means, strict=True)}}
