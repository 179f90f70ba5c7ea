"""summary.json: coverage and errors of the methods, tracking metrics and run times.

Figures without `_pct` are fractions 0..1, except MOT metrics, which are in per cent, and counts.
"""

from __future__ import annotations

import json
from collections.abc import Collection, Mapping
from dataclasses import asdict
from pathlib import Path
from typing import Any

import numpy as np

from track_range.detection.classes import ROAD_CLASSES, map_to_road_classes
from track_range.foundation.arrays import IntArray
from track_range.foundation.files.output_files import write_text
from track_range.ranging.evaluation.errors import (
    BANDS_M,
    MethodColumn,
    coverage_only,
    score_closing,
    score_methods,
)
from track_range.ranging.evaluation.truth import Truth
from track_range.results.columns import Columns, methods_with_sigma
from track_range.results.truth import MatchedTruth, boxes_px
from track_range.tracking.evaluation.benchmark_rules import MIN_HEIGHT_PX
from track_range.tracking.evaluation.scores import evaluate_tracks
from track_range.tracking.evaluation.tracked_boxes import IgnoreRegions, TrackedBoxes


def range_scores(columns: Columns, matched: MatchedTruth | None, methods: Collection[str]) -> dict[str, Any]:
    """Sections `methods` and `common` for the methods that ran; `closing` if the ground truth contains speeds."""
    known = [name for name in methods_with_sigma() if name in methods]
    names = [*known, *sorted(set(methods) - set(known))]  # methods of packages that are not installed here come last
    by_name = {name: MethodColumn(columns[f"{name}_m"], columns[f"{name}_sigma_m"]) for name in names}
    if matched is None:
        return {"methods": coverage_only(by_name), "common": {}}
    true_m, is_road_class = matched.distance_m, matched.is_road_class
    kitti_type = matched.of_labels(matched.truth.kitti_type, "")
    own, common = score_methods(by_name, true_m, is_road_class=is_road_class, kitti_type=kitti_type)
    in_range = is_road_class & (true_m >= BANDS_M[0]) & (true_m <= BANDS_M[-1])
    true_closing_mps = np.where(in_range, matched.of_labels(matched.truth.closing_mps, np.nan), np.nan)
    closing = score_closing(columns["closing_mps"], columns["closing_sigma_mps"], true_closing_mps)
    return {"methods": own, "common": common, **({} if closing is None else {"closing": closing})}


def track_scores(columns: Columns, truth: Truth | None, frames: IntArray) -> dict[str, Any]:
    """Section `tracks`: the number of tracks and, with ground truth, the MOT metrics over its classes.

    As in KITTI's benchmark, labels less than 25 px high are ignored, and so are unmatched tracks less than 25 px high,
    unless `truth.has_low_labels`.
    """
    track_id = columns["track_id"].astype(np.int64)
    counts: dict[str, Any] = {"n": len(np.unique(track_id)), "mota": None, "idf1": None, "idsw": None}
    if truth is None:
        return counts
    truth = truth.select(np.isin(truth.frame, frames))
    min_height_px = 0.0 if truth.has_low_labels else MIN_HEIGHT_PX
    counted = (truth.class_id >= 0) & (truth.xyxy_px[:, 3] - truth.xyxy_px[:, 1] >= min_height_px)
    class_id = map_to_road_classes([str(name) for name in columns["class"]])
    tracks = TrackedBoxes(columns["frame"].astype(np.int64), track_id, boxes_px(columns), class_id)
    low = tracks.xyxy_px[:, 3] - tracks.xyxy_px[:, 1] < min_height_px
    ignored_frame = np.concatenate([truth.frame[~counted], tracks.frame[low]])
    ignored_px = np.concatenate([truth.xyxy_px[~counted], tracks.xyxy_px[low]])
    labels = truth.select(counted)
    scores = evaluate_tracks(
        TrackedBoxes(labels.frame, labels.track_id, labels.xyxy_px, labels.class_id),
        tracks.select(np.isin(class_id, labels.class_id)),
        ignore=IgnoreRegions(ignored_frame, ignored_px),
    )
    figures = {name: _json_number(value) for name, value in asdict(scores).items() if name != "n"}
    return {
        **counts,
        **figures,
        "n_truth_boxes": scores.n,
        "classes": [ROAD_CLASSES[class_id] for class_id in np.unique(labels.class_id)],
    }


def _json_number(value: float) -> float | None:
    """Value for JSON; None for NaN (a ratio with denominator 0)."""
    return None if np.isnan(value) else round(value, 4)


def stage_times_ms(busy_s: Mapping[str, float], n_frames: int) -> dict[str, float]:
    """Run time of each stage in ms per frame."""
    return {name: round(1e3 * seconds / max(n_frames, 1), 3) for name, seconds in busy_s.items()}


def write_summary(path: Path, summary: Mapping[str, Any]) -> None:
    """Write summary.json atomically; raises ValueError for NaN, which is not valid JSON."""
    write_text(path, json.dumps(summary, indent=2, allow_nan=False) + "\n")
