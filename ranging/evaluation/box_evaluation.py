"""Errors of box-only methods on labelled boxes, per class, distance band and drive.

Errors are relative. The metrics of a class and of its drives cover 10-100 m, the metrics of far
objects 30-100 m, and the bands 5-100 m. Errors of sizes, of the ground and of a calibration are
common to a drive: a coverage over all drives hides drives that are wrong in opposite directions.

Metrics of published evaluations (Eigen, Puhrsch and Fergus, NIPS 2014):

    abs rel   mean |d - t| / t              sq rel   mean (d - t)^2 / t            d: measured, t: reference distance
    RMSE      sqrt(mean (d - t)^2)          RMSE log sqrt(mean (log d - log t)^2)
    delta_k   fraction of max(d / t, t / d) < 1.25^k
"""

from collections.abc import Iterator, Mapping
from typing import Any

import numpy as np

from track_range.foundation.arrays import BoolArray, FloatArray, IntArray
from track_range.foundation.bootstrap import (
    CI95,
    Resamples,
    Statistic,
    figures_of,
    measured_by_all,
    paired_differences,
)
from track_range.ranging.truth.errors import (
    BANDS_M,
    MethodColumn,
    distance_statistics,
    score_bands,
    score_rows,
)
from track_range.ranging.truth.label_classes import SIZE_CLASS_ORDER as CLASSES
from track_range.ranging.truth.labelled_boxes import BoxSet
from track_range.stereo.evaluation.disparity_errors import MatcherColumn, risk_coverage

# smallest distance in m of the metrics of a class, and of far objects
NEAREST_M, FAR_M = 10.0, 30.0
# s before and after a label of the central difference that is its true closing speed
CLOSING_HALF_SPAN_S = 0.5
# metrics of each drive besides the number of its tracks: number of boxes, median signed error,
# fractions within one and two sigma
_DRIVE_FIGURES = ("bias_pct", "within_1_sigma", "within_2_sigma")
_DRIVE_KEYS = ("n", *_DRIVE_FIGURES, *(name + CI95 for name in _DRIVE_FIGURES))
# smallest number of boxes of a drive that may be named as the worst: fewer are one or two tracks
_MIN_DRIVE_BOXES = 30
_MIN_M = 0.1  # smallest distance in m in ratios and logarithms: polynomials may be negative

METRICS = (
    "abs_rel",
    "sq_rel_m",
    "rmse_m",
    "rmse_log",
    "delta_1_25",
    "delta_1_25_2",
    "delta_1_25_3",
)
"""Keys of the metrics of published evaluations."""


def figures(boxes: BoxSet, column: MethodColumn, seed: int = 0) -> dict[str, dict[str, Any]]:
    """Metrics of measured distances by class, with 95 % intervals by resampling drives and tracks."""
    present = [name for name in CLASSES if (boxes.class_name == name).any()]
    return {name: _class_figures(boxes, column, boxes.class_name == name, seed) for name in present}


def _class_figures(
    boxes: BoxSet, column: MethodColumn, is_class: BoolArray, seed: int
) -> dict[str, Any]:
    true_m = boxes.distance_m
    in_span = is_class & (true_m >= NEAREST_M) & (true_m <= BANDS_M[-1])
    tracks = np.unique(np.stack([boxes.sequence, boxes.track_id])[:, in_span], axis=1)
    resamples = Resamples.of(boxes.track_id, drive=boxes.sequence, seed=seed, rows=is_class)
    is_far = true_m >= FAR_M
    parts = {
        "rear_view_pct": boxes.is_rear_view,
        "far_pct": is_far,
        "rear_view_far_pct": boxes.is_rear_view & is_far,
    }
    statistics = {
        name: distance_statistics(column, true_m, in_span & rows)["mean_relative_error_pct"]
        for name, rows in parts.items()
    }
    by_drive = _drive_figures(boxes, column, in_span, seed)
    return {
        **score_rows(column, true_m, in_span, resamples),
        "n_tracks": tracks.shape[1],
        **figures_of(statistics, resamples),
        "bands": score_bands(column, true_m, is_class, resamples),
        "by_drive": by_drive,
        "worst_drive": _worst_drive(by_drive),
    }


def comparison(
    boxes: BoxSet, columns: Mapping[str, MethodColumn], seed: int = 0
) -> dict[str, dict[str, Any]]:
    """By class, the median errors of several methods on the boxes at 10-100 m that all of them
    measured, with the differences from the smallest one, and the number of boxes of each; see
    `paired_differences`. Methods that measured less than half of the boxes are only counted.
    """
    compared = {}
    true_m = boxes.distance_m
    errors = {name: np.abs(column.distance_m / true_m - 1) for name, column in columns.items()}
    for class_name in CLASSES if len(columns) > 1 else ():
        rows = (boxes.class_name == class_name) & (true_m >= NEAREST_M) & (true_m <= BANDS_M[-1])
        common, names = measured_by_all(errors, rows)
        if not rows.any():
            continue
        resamples = Resamples.of(boxes.track_id, drive=boxes.sequence, seed=seed, rows=common)
        statistics = {
            name: Statistic(np.where(common, errors[name], np.nan), 0.5, 100) for name in names
        }
        compared[class_name] = {
            "n": int(rows.sum()),
            "n_common": int(common.sum()),
            "n_measured": {
                name: int((np.isfinite(error) & rows).sum()) for name, error in errors.items()
            },
            **paired_differences(statistics, resamples, "median_relative_error_pct"),
        }
    return compared


def _drive_figures(
    boxes: BoxSet, column: MethodColumn, rows: BoolArray, seed: int
) -> dict[str, dict[str, Any]]:
    """Metrics by the name of the drive, of the drives that have boxes among `rows` (N,)."""
    by_drive = {}
    for number in np.unique(boxes.sequence[rows]).tolist():
        in_drive = rows & (boxes.sequence == number)
        tracks = Resamples.of(boxes.track_id, seed=seed, rows=in_drive)
        scores = score_rows(column, boxes.distance_m, in_drive, tracks)
        by_drive[boxes.sequence_names[number]] = {
            "n_tracks": len(np.unique(boxes.track_id[in_drive])),
            **{key: scores[key] for key in _DRIVE_KEYS if key in scores},
        }
    return by_drive


def _worst_drive(by_drive: Mapping[str, Mapping[str, Any]]) -> str | None:
    """Name of the drive with the largest median error; None = all have too few boxes."""
    bias_pct = {
        name: abs(scores["bias_pct"])
        for name, scores in by_drive.items()
        if scores["n"] >= _MIN_DRIVE_BOXES
    }
    return max(bias_pct, key=bias_pct.__getitem__, default=None)


def frame_rows(boxes: BoxSet) -> Iterator[IntArray]:
    """Row indices of each frame, in the order of sequences and frames."""
    order = np.lexsort((boxes.frame, boxes.sequence))
    key = np.stack([boxes.sequence, boxes.frame])[:, order]
    starts = np.flatnonzero(np.any(np.diff(key, axis=1, prepend=-1) != 0, axis=0))
    yield from np.split(order, starts[1:])


def true_closing_mps(boxes: BoxSet) -> FloatArray:
    """(N,) true closing speed in m/s; NaN unless the track is labelled about half a second before
    and after.
    """
    step_s = boxes.time_step_s
    reach = max(round(CLOSING_HALF_SPAN_S / step_s), 1) if step_s else 1
    keys = list(
        zip(boxes.sequence.tolist(), boxes.track_id.tolist(), boxes.frame.tolist(), strict=True)
    )
    row_of = {key: row for row, key in enumerate(keys)}
    before, after = (
        np.array(
            [row_of.get((sequence, track, frame + shift), -1) for sequence, track, frame in keys],
            np.int64,
        )
        for shift in (-reach, reach)
    )
    known = (before >= 0) & (after >= 0)
    span_s = boxes.time_s[after] - boxes.time_s[before]
    closed_m = boxes.distance_m[before] - boxes.distance_m[after]
    return np.where(known, closed_m / np.where(known, span_s, 1.0), np.nan)


def closing_figures(
    boxes: BoxSet, closing_mps: FloatArray, seed: int = 0
) -> dict[str, dict[str, Any]]:
    """Number of boxes, and median and 95th percentile of the closing speed error at 10-100 m, by
    class.
    """
    error = np.abs(closing_mps - true_closing_mps(boxes))
    in_span = np.isfinite(error) & (boxes.distance_m >= NEAREST_M)
    by_class = {}
    for name in CLASSES:
        is_class = boxes.class_name == name
        if is_class.any():
            resamples = Resamples.of(boxes.track_id, drive=boxes.sequence, seed=seed, rows=is_class)
            values = np.where(in_span & is_class, error, np.nan)
            statistics = {
                "closing_median_error_mps": Statistic(values, 0.5),
                "closing_p95_error_mps": Statistic(values, 0.95),
            }
            n = int((in_span & is_class).sum())
            by_class[name] = {"closing_n": n, **figures_of(statistics, resamples)}
    return by_class


def literature_metrics(
    boxes: BoxSet, columns: Mapping[str, MethodColumn]
) -> dict[str, dict[str, dict[str, Any]]]:
    """Metrics by method and class, and over all classes, of all boxes with a reference distance."""
    rows_of = {
        name: boxes.class_name == name for name in CLASSES if (boxes.class_name == name).any()
    }
    rows_of["all"] = np.ones(len(boxes), np.bool_)
    return {
        method: {
            name: {
                "n_boxes": int(rows.sum()),
                **metrics(column.distance_m[rows], boxes.distance_m[rows]),
            }
            for name, rows in rows_of.items()
        }
        for method, column in columns.items()
    }


def metrics(distance_m: FloatArray, reference_m: FloatArray) -> dict[str, Any]:
    """Coverage and metrics of (N,) distances, NaN = not measured, against (N,) references; None
    without a distance.
    """
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


def distance_risk(boxes: BoxSet, column: MethodColumn) -> dict[str, dict[str, Any]]:
    """Risk-coverage curve and areas by class at 10-100 m, with boxes in the order of their relative
    sigma.

    With 1 / d as the disparity: failures are boxes without a distance or with an error above 15 %.
    Empty for a method without sigma.
    """
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
