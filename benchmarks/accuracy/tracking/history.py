"""Median label prediction (`tracking/history.py`) by median length, form and gates.

jitter = |second difference of a box's edges over three consecutive frames| in px: median of each track minus that
of the matched ground truth (IoU >= 0.5), mean over tracks weighted by the number of such triples
label  = the paper's median-smoothed box ("after" in its figure); its error is the median |edge - true edge|
"""

from __future__ import annotations

from argparse import Namespace
from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from benchmarks.harness import Figures, option, workload
from benchmarks.inputs import tracking_sets
from benchmarks.inputs.drives import REAL_DATA
from benchmarks.inputs.tracking_sets import sequences_of
from track_range.detection.boxes import iou
from track_range.detection.formats.video_labels.kitti import KittiLabels
from track_range.foundation.arrays import BoolArray, FloatArray, IntArray
from track_range.tracking.association import min_cost_matching
from track_range.tracking.deepsort import DeepSortSettings, DeepSortTracker
from track_range.tracking.evaluation.benchmark_rules import KITTI_TYPES
from track_range.tracking.evaluation.scores import TrackingCounts
from track_range.tracking.evaluation.tracked_boxes import TrackedBoxes
from track_range.tracking.history import BoxHistory, Form, PredictionGates, smoothed

FORMS: tuple[Form, ...] = ("median-of-steps", "step-of-medians")  # forms of the prediction


@dataclass(frozen=True, slots=True)
class _Tracked:
    """N reported boxes of a sequence, ordered by track and frame, with the labels that they match
    in their frames.

    `truth_xyxy_px` (N, 4) is NaN without a label.
    """

    boxes: TrackedBoxes
    observed: BoolArray
    truth_xyxy_px: FloatArray


@workload(
    option("--data", default=REAL_DATA, help="folder with kitti_labels"),
    option("--classes", default=("car", "person"), choices=("car", "person"), help="classes"),
    option("--k", default=(2, 3, 5, 7, 9), help="lengths of the median in frames"),
)
def history(options: Namespace) -> Figures:
    sequences = {name: sequences_of(f"kitti-{name}", options.data) for name in options.classes}
    return {
        road_class: {
            f"{name}, k {k}": _row(class_sequences, k, gates)
            for name, k, gates in _settings(options.k)
        }
        for road_class, class_sequences in sequences.items()
    }


def _settings(ks: Sequence[int]) -> list[tuple[str, int, PredictionGates]]:
    free = PredictionGates(
        min_hit_streak=2, min_hit_streak_visible=2, max_deviation=np.inf, min_margin=0.0
    )
    rows = [("nothing", k, PredictionGates(n_kept=k + 1, max_missing_s=0.0)) for k in ks]
    for form in FORMS:
        rows += [(f"{form}, border, age", k, replace(free, form=form, n_kept=k + 1)) for k in ks]
        rows += [(f"{form}, all gates", k, PredictionGates(form=form, n_kept=k + 1)) for k in ks]
    return rows


def _row(
    sequences: Sequence[tracking_sets.Sequence], k: int, gates: PredictionGates
) -> dict[str, Any]:
    tracked = [_tracked(sequence, gates) for sequence in sequences]
    boxes = [result.boxes for result in tracked]
    counts = [sequence.counts(tracks) for sequence, tracks in zip(sequences, boxes, strict=True)]
    is_even = [int(sequence.name) % 2 == 0 for sequence in sequences]
    halves = [
        TrackingCounts.sum_of([c for c, e in zip(counts, is_even, strict=True) if e == half])
        for half in (1, 0)
    ]
    scores = TrackingCounts.sum_of(counts).scores()
    labels = [_labels(result, k) for result in tracked]
    truth = np.concatenate([result.truth_xyxy_px for result in tracked])
    return {
        "hota": scores.hota,
        "hota_even": halves[0].scores().hota,
        "hota_odd": halves[1].scores().hota,
        "mota": scores.mota,
        "frag": scores.frag,
        "n_predicted": sum(int(np.count_nonzero(~result.observed)) for result in tracked),
        "jitter_px": _jitter_px(tracked, [tracks.xyxy_px for tracks in boxes]),
        "label_jitter_px": _jitter_px(tracked, labels),
        "error_px": float(
            np.nanmedian(np.abs(np.concatenate([tracks.xyxy_px for tracks in boxes]) - truth))
        ),
        "label_error_px": float(np.nanmedian(np.abs(np.concatenate(labels) - truth))),
    }


def _tracked(sequence: tracking_sets.Sequence, gates: PredictionGates) -> _Tracked:
    boxes, observed = sequence.tracked(DeepSortTracker(DeepSortSettings(prediction=gates)))
    order = np.lexsort((boxes.frame, boxes.track_id))
    boxes = boxes.select(order)
    row = _matching_rows(sequence, boxes)
    return _Tracked(
        boxes, observed[order], np.where(row[:, None] >= 0, _truth(sequence).xyxy_px[row], np.nan)
    )


def _truth(sequence: tracking_sets.Sequence) -> KittiLabels:
    if not isinstance(sequence.truth, KittiLabels):
        raise TypeError(
            f"{sequence.name}: expected KITTI labels, got {type(sequence.truth).__name__}"
        )
    return sequence.truth


def _matching_rows(sequence: tracking_sets.Sequence, boxes: TrackedBoxes) -> IntArray:
    """(N,) row of the label that each box matches in its frame; -1 = none."""
    labels = _truth(sequence)
    is_class = labels.kitti_type == KITTI_TYPES[sequence.road_class][0]
    matching = np.full(len(boxes), -1)
    for frame in range(sequence.n_frames):
        rows, label_rows = (
            np.flatnonzero(boxes.frame == frame),
            np.flatnonzero((labels.frame == frame) & is_class),
        )
        overlap = iou(boxes.xyxy_px[rows], labels.xyxy_px[label_rows])
        row, label = min_cost_matching(
            np.where(overlap >= 0.5, 1.0 - overlap, np.inf), max_cost=1.0
        )
        matching[rows[row]] = label_rows[label]
    return matching


def _labels(tracked: _Tracked, k: int) -> FloatArray:
    """(N, 4) median-smoothed boxes; predicted ones are not smoothed."""
    xyxy_px = tracked.boxes.xyxy_px.copy()
    for track_id in np.unique(tracked.boxes.track_id):
        rows = np.flatnonzero((tracked.boxes.track_id == track_id) & tracked.observed)
        buffer = np.concatenate([np.full((k, 4), np.nan), tracked.boxes.xyxy_px[rows]])
        windows = np.lib.stride_tricks.sliding_window_view(buffer, k + 1, axis=0).transpose(0, 2, 1)
        hit_streak = np.ones(len(rows), np.int64)
        xyxy_px[rows] = smoothed(BoxHistory(windows, hit_streak))
    return xyxy_px


def _jitter_px(tracked: Sequence[_Tracked], boxes: Sequence[FloatArray]) -> float:
    """Jitter of boxes (N, 4) per sequence, as defined in the docstring of the module."""
    excess, weight = [], []
    for result, xyxy_px in zip(tracked, boxes, strict=True):
        rows = _triples(result)
        difference, true_difference = (
            np.abs(np.diff(edges[rows], n=2, axis=1)[:, 0])
            for edges in (xyxy_px, result.truth_xyxy_px)
        )
        track_id = result.boxes.track_id[rows[:, 0]]
        for track in np.unique(track_id):
            is_track = track_id == track
            excess.append(
                float(np.median(difference[is_track]) - np.median(true_difference[is_track]))
            )
            weight.append(int(np.count_nonzero(is_track)))
    return float(np.average(excess, weights=weight))


def _triples(tracked: _Tracked) -> IntArray:
    """(T, 3) rows of a track in three consecutive frames with matching labels."""
    rows = np.arange(len(tracked.boxes) - 2)[:, None] + np.arange(3)
    boxes, is_matched = tracked.boxes, np.isfinite(tracked.truth_xyxy_px[:, 0])
    is_one_track = boxes.track_id[rows[:, 0]] == boxes.track_id[rows[:, 2]]
    is_consecutive = boxes.frame[rows[:, 2]] - boxes.frame[rows[:, 0]] == 2
    return np.asarray(rows[is_one_track & is_consecutive & is_matched[rows].all(axis=1)])
