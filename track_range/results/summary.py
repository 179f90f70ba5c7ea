"""Sections of summary.json: coverage and errors of the methods, tracking metrics, events, run
times.

Figures without `_pct` are fractions 0..1, except MOT metrics, which are in per cent, and counts.
"""

from __future__ import annotations

from collections.abc import Collection, Mapping, Sequence
from dataclasses import asdict, dataclass, field, replace
from typing import Any

import numpy as np
import numpy.typing as npt

from track_range.detection.classes import ROAD_CLASSES, map_to_road_classes
from track_range.foundation.arrays import BoolArray, FloatArray, IntArray
from track_range.ranging.truth.errors import (
    BANDS_M,
    MethodColumn,
    coverage_only,
    match_truth,
    score_closing,
    score_methods,
)
from track_range.ranging.truth.target_matching import (
    MatchedTargets,
    MeasuredRows,
    match_targets,
    offset_notes,
)
from track_range.ranging.truth.target_table import TargetTable
from track_range.ranging.truth.truth import Truth
from track_range.results.approaches import reference_distance
from track_range.results.events.event import EVENT_KINDS, Event, severity_key
from track_range.results.events.files import rounded_values
from track_range.results.rows.columns import methods_with_sigma
from track_range.results.rows.rows import Rows
from track_range.tracking.evaluation.benchmark_rules import (
    KITTI_RULE,
    MIN_HEIGHT_PX,
    kitti_cleaned_classes,
)
from track_range.tracking.evaluation.scores import evaluate_tracks
from track_range.tracking.evaluation.tracked_boxes import IgnoreRegions, TrackedBoxes

_HEIGHT_RULE = (
    f"labels and unmatched tracks below {MIN_HEIGHT_PX:g} px, and labels of other classes, do not "
    "count"
)


@dataclass(frozen=True, slots=True)
class MatchedTruth:
    """Ground truth of N rows (a track in a frame each)."""

    truth: Truth  # the labels
    row: IntArray  # (N,) index of the matching label in `truth`; -1 = no match
    # of targets without boxes: offset of the clocks and its sigma, and a row per target
    targets: Mapping[str, Any] = field(default_factory=dict)

    @property
    def distance_m(self) -> FloatArray:
        """(N,) true distances; NaN = no match."""
        return self.of_labels(self.truth.distance_m, np.nan)

    @property
    def is_road_class(self) -> BoolArray:
        """(N,) mask of the rows that match a label of a road class, not a van or tram."""
        return self.of_labels(self.truth.class_id, -1) >= 0

    def of_scored(self, values: FloatArray) -> FloatArray:
        """(N,) values, NaN for rows that match no label of a road class at a distance in
        `BANDS_M`.
        """
        is_scored = (
            self.is_road_class & (self.distance_m >= BANDS_M[0]) & (self.distance_m <= BANDS_M[-1])
        )
        return np.where(is_scored, values, np.nan)

    def of_labels(self, values: npt.NDArray[Any], unmatched: Any) -> npt.NDArray[Any]:
        """(N,) values of the matching labels, from the values of all labels; `unmatched` for rows
        without a match.
        """
        return np.where(self.row >= 0, np.append(values, unmatched)[self.row], unmatched)


def matched_truth(rows: Rows, truth: Truth) -> MatchedTruth:
    """Ground truth matched to the rows of a run by frame and box overlap, or targets without boxes
    by distance and time.
    """
    if truth.targets is not None:
        return _matched_targets(rows, truth, truth.targets)
    return MatchedTruth(truth, match_truth(rows["frame"], rows.boxes_px, truth))


def _matched_targets(rows: Rows, truth: Truth, table: TargetTable) -> MatchedTruth:
    """Targets matched to whole tracks: a label per matched row, whose box is that of the row."""
    clock = rows["utc"] if table.clock == "utc_s" else rows[table.clock]
    table.check_clock(has_utc=bool(np.isfinite(clock).any()))
    distance_m, sigma_m = reference_distance(rows, ("fused", "fused_kf"))
    values = np.stack([distance_m, rows["x_m"], rows["closing_mps"]])
    sigmas = np.stack([sigma_m, rows["x_sigma_m"], rows["closing_sigma_mps"]])
    measured = MeasuredRows(rows["frame"], clock.astype(float), rows["track_id"], values, sigmas)
    matches = match_targets(table, measured)
    own = np.flatnonzero(matches.target >= 0)
    target, names = matches.target[own], rows["class"][own]
    has_sides = bool(np.isfinite(matches.values[1]).any())
    labels = replace(
        truth,
        frame=rows["frame"][own],
        track_id=target,
        kitti_type=names,
        class_id=map_to_road_classes([str(name) for name in names]),
        xyxy_px=rows.boxes_px[own],
        distance_m=matches.values[0, own],
        closing_mps=matches.values[2, own],
        right_m=matches.values[1, own] if has_sides else None,
        notes=(*truth.notes, *offset_notes(table, matches)),
    )
    row = np.full(len(rows), -1)
    row[own] = np.arange(len(own))
    return MatchedTruth(labels, row, _target_figures(rows, table, matches))


def _target_figures(rows: Rows, table: TargetTable, matches: MatchedTargets) -> dict[str, Any]:
    """Section `targets`: the offset of the clocks, and each target with its tracks."""
    by_target = []
    for number, name in enumerate(table.names):
        own = matches.target == number
        tracks = np.unique(rows["track_id"][own]).tolist()
        n_rows = int((table.target == number).sum())
        by_target.append(
            {"target": name, "rows": n_rows, "matched": int(own.sum()), "tracks": tracks}
        )
    sigma_s = None if np.isnan(matches.offset_sigma_s) else round(matches.offset_sigma_s, 3)
    return {
        "offset_s": round(matches.offset_s, 3),
        "offset_sigma_s": None if sigma_s == np.inf else sigma_s,
        "by_target": by_target,
    }


def with_truth(rows: Rows, matched: MatchedTruth) -> Rows:
    """Rows with `truth_m`, the true distance, `scored_truth_m`, only of objects that count for the
    errors, and `truth_track`, the identity of the label, -1 = none.
    """
    truth_m = matched.distance_m
    return rows.with_columns(
        {
            "truth_m": truth_m,
            "scored_truth_m": matched.of_scored(truth_m),
            "truth_track": matched.of_labels(matched.truth.track_id, -1),
        }
    )


def range_scores(
    rows: Rows, matched: MatchedTruth | None, methods: Collection[str], seed: int = 0
) -> dict[str, Any]:
    """Sections `methods` and `common` for the methods that ran; `closing` if the ground truth
    contains speeds. Their 95 % intervals resample the true tracks with this seed.
    """
    methods = [name for name in methods if f"{name}_m" in rows]
    known = [name for name in methods_with_sigma() if name in methods]
    # methods of packages that are not installed here come last
    names = [*known, *sorted(set(methods) - set(known))]
    by_name = {name: MethodColumn(*rows.distance(name)) for name in names}
    if matched is None:
        return {"methods": coverage_only(by_name), "common": {}}
    kitti_type = matched.of_labels(matched.truth.kitti_type, "")
    track_id = matched.of_labels(matched.truth.track_id, -1)
    own, common = score_methods(
        by_name,
        matched.distance_m,
        is_road_class=matched.is_road_class,
        kitti_type=kitti_type,
        track_id=track_id,
        seed=seed,
    )
    true_mps = matched.of_scored(matched.of_labels(matched.truth.closing_mps, np.nan))
    measured = (rows["closing_mps"], rows["closing_sigma_mps"])
    closing = score_closing(*measured, true_mps, track_id, seed)
    sections = {"closing": closing, "lateral": _lateral(rows, matched, seed)}
    labelled = {name: section for name, section in sections.items() if section is not None}
    return {"methods": own, "common": common, **labelled}


def _lateral(rows: Rows, matched: MatchedTruth, seed: int) -> dict[str, Any] | None:
    """Errors of offsets to the side in m, where the ground truth has them."""
    if matched.truth.right_m is None:
        return None
    true_m = matched.of_scored(matched.of_labels(matched.truth.right_m, np.nan))
    track_id = matched.of_labels(matched.truth.track_id, -1)
    scores = score_closing(rows["x_m"], rows["x_sigma_m"], true_m, track_id, seed)
    if scores is None:
        return None
    return {key.replace("_mps", "_m"): value for key, value in scores.items()}


def track_scores(rows: Rows, truth: Truth | None, frames: IntArray) -> dict[str, Any]:
    """Section `tracks`: the number of tracks and, with ground truth, the MOT metrics over its
    classes, and the `rule` of what counts.

    KITTI's labels are evaluated by the rules of its benchmark, as `evaluate tracks` does. Otherwise
    labels less than 25 px high are ignored, and so are unmatched tracks less than 25 px high, unless
    `truth.has_low_labels`.
    """
    track_id = rows["track_id"]
    counts: dict[str, Any] = {
        "n": len(np.unique(track_id)),
        "mota": None,
        "idf1": None,
        "idsw": None,
    }
    if truth is None:
        return counts
    class_id = map_to_road_classes([str(name) for name in rows["class"]])
    tracks = TrackedBoxes(rows["frame"], track_id, rows.boxes_px, class_id)
    if truth.kitti is None:
        labels, tracks, ignored = _counted(truth.select(np.isin(truth.frame, frames)), tracks)
        rule = "all labels and tracks count" if truth.has_low_labels else _HEIGHT_RULE
    else:
        of_frames = truth.kitti.select(np.isin(truth.kitti.frame, frames))
        labels, tracks = kitti_cleaned_classes(of_frames, tracks)
        rule, ignored = KITTI_RULE, None
    scores = evaluate_tracks(labels, tracks, ignore=ignored)
    figures = {
        name: None if np.isnan(value) else round(value, 4)  # NaN = a ratio with denominator 0
        for name, value in asdict(scores).items()
        if name != "n"
    }
    classes = [ROAD_CLASSES[class_id] for class_id in np.unique(labels.class_id)]
    return {
        **counts,
        **figures,
        "n_truth_boxes": scores.n,
        "n_truth_tracks": len(np.unique(labels.track_id)),
        "classes": classes,
        "rule": rule,
    }


def _counted(
    truth: Truth, tracks: TrackedBoxes
) -> tuple[TrackedBoxes, TrackedBoxes, IgnoreRegions]:
    """Labels and tracks of the road classes that have labels, and where unmatched tracks are
    ignored.
    """
    min_height_px = 0.0 if truth.has_low_labels else MIN_HEIGHT_PX
    counted = (truth.class_id >= 0) & (truth.xyxy_px[:, 3] - truth.xyxy_px[:, 1] >= min_height_px)
    low = tracks.xyxy_px[:, 3] - tracks.xyxy_px[:, 1] < min_height_px
    ignored_frame = np.concatenate([truth.frame[~counted], tracks.frame[low]])
    ignored_px = np.concatenate([truth.xyxy_px[~counted], tracks.xyxy_px[low]])
    labels = truth.select(counted)
    return (
        TrackedBoxes(labels.frame, labels.track_id, labels.xyxy_px, labels.class_id),
        tracks.select(np.isin(tracks.class_id, labels.class_id)),
        IgnoreRegions(ignored_frame, ignored_px),
    )


def truth_figures(
    rows: Rows,
    matched: MatchedTruth | None,
    methods: Collection[str],
    frames: IntArray,
    seed: int = 0,
) -> dict[str, Any]:
    """Sections that compare the rows of the processed `frames` with ground truth, None = none:
    `methods`, `common`, `closing`, `tracks`, and the description `truth`.
    """
    truth = None if matched is None else matched.truth
    has_targets = truth is not None and truth.targets is not None
    return {
        **range_scores(rows, matched, methods, seed),
        "tracks": track_scores(rows, None if has_targets else truth, frames),
        "truth": None if truth is None else truth.protocol,
        **({"targets": matched.targets} if matched is not None and has_targets else {}),
    }


def events_section(events: Sequence[Event], seconds: float) -> dict[str, Any]:
    """Section `events`: number of events by kind, the most severe event, and the hours of processed
    video.
    """
    worst = min(events, key=severity_key, default=None)
    return {
        "n": len(events),
        "by_kind": {kind: sum(event.kind == kind for event in events) for kind in EVENT_KINDS},
        "worst": None if worst is None else rounded_values(worst),
        "hours": round(seconds / 3600, 6),
    }


def frame_spans(frames: IntArray, every: int) -> dict[str, list[list[int]]]:
    """`processed_frames`, first and last of each series of each `every`-th frame; no entry if there
    is one series.
    """
    ends = np.flatnonzero(np.diff(frames) != every)
    spans = (
        np.column_stack([frames[[0, *(ends + 1)]], frames[[*ends, -1]]]).tolist()
        if len(ends)
        else []
    )
    return {"processed_frames": spans} if spans else {}


def stage_times_ms(busy_s: Mapping[str, float], n_frames: int) -> dict[str, float]:
    """Run time of each stage in ms per frame."""
    return {name: round(1e3 * seconds / max(n_frames, 1), 3) for name, seconds in busy_s.items()}
