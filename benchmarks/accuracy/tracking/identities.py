"""What a whole run with images loses of IDF1: missed road users, false boxes, or identities.

The run is made as by the command line; the detections of its tracker are kept. Rows are the run and
two bounds: its own boxes with the true identities, and all of its detections (from a score of 0.1)
with the true identities and without the false ones, which no association exceeds. Labels that do
not count (other classes, below 25 px, less visible than asked for) are regions in which unmatched
tracks are ignored, as in a run with `--truth`.
"""

from __future__ import annotations

from argparse import Namespace
from collections import Counter
from collections.abc import Iterator, Sequence
from dataclasses import asdict, dataclass, field
from pathlib import Path
from typing import NamedTuple

import numpy as np
from scipy.optimize import linear_sum_assignment

import track_range as tr
from benchmarks.harness import Figures, option, workload
from track_range.detection.boxes import iou
from track_range.detection.detections import Detections
from track_range.detection.formats.video_labels.csv_labels import read_csv_labels
from track_range.foundation.arrays import BoolArray, FloatArray, Image, IntArray
from track_range.tracking.evaluation.benchmark_rules import MIN_HEIGHT_PX
from track_range.tracking.evaluation.scores import evaluate_tracks
from track_range.tracking.evaluation.tracked_boxes import IgnoreRegions, TrackedBoxes
from track_range.tracking.registry import (
    ObjectTracker,
    TrackerOptions,
    create_tracker,
    register_tracker,
)
from track_range.tracking.tracks import Tracks

_METRICS = ("hota", "deta", "assa", "idf1", "idsw", "fp", "fn", "n")
_LEAST_VISIBLE = (0.2, 0.5, 0.8)  # 0.2 = as a run with --truth
_MIN_IOU, _LOOSE_IOU = 0.5, 0.25
_RECORDED = "recorded "  # before the name of the tracker


class _Frame(NamedTuple):
    number: int
    detections: Detections
    tracks: Tracks


class _Counted(NamedTuple):
    """Labels that count, and the regions of the others."""

    labels: TrackedBoxes
    ignored: IgnoreRegions


@dataclass(slots=True)
class _Recorder:
    """A tracker of the program that keeps the detections and tracks of each frame."""

    tracker: ObjectTracker
    frames: list[_Frame] = field(default_factory=list)

    def update(self, detections: Detections, time_s: float, image: Image | None) -> Tracks:
        tracks = self.tracker.update(detections, time_s, image)
        self.frames.append(_Frame(len(self.frames), detections, tracks))
        return tracks


@workload(
    option("--video", type=Path, required=True, help="video of one camera"),
    option("--rig", type=Path, required=True, help="its calibration"),
    option("--truth", type=Path, required=True, help="CSV of ground truth, as of run --truth"),
    option("--ego-speed", default="auto", help="as of a run"),
    option("--detector", default="road", help="as of a run"),
    option("--far-pass", type=int, help="as of a run"),
    option("--trackers", default=("road", "deepsort", "sort"), help="trackers by name"),
)
def identities(options: Namespace) -> Figures:
    figures: Figures = {}
    for name in options.trackers:
        frames = _frames_of_run(options, name)
        rows: Figures = {}
        for least_visible in _LEAST_VISIBLE:
            counted = _counted(options.truth, least_visible)
            rows[f"visible {least_visible:g}"] = _rows(frames, counted) | {
                "labels": dict(Counter(_causes(frames, counted.labels)).most_common())
            }
        figures[name] = rows
    return figures


def _frames_of_run(options: Namespace, tracker: str) -> Sequence[_Frame]:
    recorders = []

    def recorded(tracker_options: TrackerOptions) -> _Recorder:
        recorders.append(_Recorder(create_tracker(tracker, tracker_options)))
        return recorders[-1]

    register_tracker(_RECORDED + tracker, recorded)
    with tr.Run.mono(
        options.video,
        rig=options.rig,
        ego_speed=options.ego_speed,
        detector=options.detector,
        far_pass=options.far_pass,
        tracker=_RECORDED + tracker,
    ) as run:
        n_frames = sum(1 for _ in run)
    frames: Sequence[_Frame] = recorders[-1].frames
    if len(frames) != n_frames:
        raise ValueError(f"expected a new image in each of {n_frames} frames, got {len(frames)}")
    return frames


def _counted(path: Path, least_visible: float) -> _Counted:
    rows = read_csv_labels(path)
    height_px = rows.xyxy_px[:, 3] - rows.xyxy_px[:, 1]
    counts = (rows.class_id >= 0) & (rows.visible_share >= least_visible)
    counts &= height_px >= MIN_HEIGHT_PX
    labels = TrackedBoxes(rows.frame, rows.track_id, rows.xyxy_px, rows.class_id)
    others = np.flatnonzero(~counts)
    return _Counted(labels.select(counts), IgnoreRegions(rows.frame[others], rows.xyxy_px[others]))


def _rows(frames: Sequence[_Frame], counted: _Counted) -> Figures:
    labels, ignored = counted
    own = TrackedBoxes.joined([_boxes(frame.number, frame.tracks) for frame in frames])
    own = own.select(np.isin(own.class_id, labels.class_id))
    low = own.xyxy_px[:, 3] - own.xyxy_px[:, 1] < MIN_HEIGHT_PX
    ignored = IgnoreRegions(
        np.concatenate([ignored.frame, own.frame[low]]),
        np.concatenate([ignored.xyxy_px, own.xyxy_px[low]]),
    )
    results = {
        "run": own,
        "its boxes, true identities": _identified(own, labels, keeps_others=True),
        "all detections, true identities": _identified(
            TrackedBoxes.joined([_boxes(frame.number, frame.detections) for frame in frames]),
            labels,
            keeps_others=False,
        ),
    }
    scored = {
        name: asdict(evaluate_tracks(labels, boxes, ignore=ignored))
        for name, boxes in results.items()
    }
    return {name: {key: scores[key] for key in _METRICS} for name, scores in scored.items()}


def _boxes(frame: int, found: Detections | Tracks) -> TrackedBoxes:
    """Boxes of a frame; detections get numbers of their own."""
    n = len(found)
    track_id = found.track_id if isinstance(found, Tracks) else np.arange(n)
    return TrackedBoxes(np.full(n, frame), track_id, found.xyxy_px, found.class_id)


def _identified(boxes: TrackedBoxes, labels: TrackedBoxes, *, keeps_others: bool) -> TrackedBoxes:
    """The boxes with the identities of the labels; others are left out, or get one each."""
    track_id = -1 - np.arange(len(boxes))
    for frame in np.unique(labels.frame):
        rows, of_labels = (np.flatnonzero(part.frame == frame) for part in (boxes, labels))
        i, j = _matched(labels.select(of_labels), boxes.select(rows))
        track_id[rows[j]] = labels.track_id[of_labels[i]]
    named = TrackedBoxes(boxes.frame, track_id, boxes.xyxy_px, boxes.class_id)
    return named if keeps_others else named.select(track_id >= 0)


def _matched(labels: TrackedBoxes, boxes: TrackedBoxes) -> tuple[IntArray, IntArray]:
    overlap, is_class = _overlap(labels, boxes)
    overlap[~is_class | (overlap < _MIN_IOU)] = 0.0
    i, j = linear_sum_assignment(overlap, maximize=True)
    is_pair = overlap[i, j] > 0
    return i[is_pair], j[is_pair]


def _overlap(labels: TrackedBoxes, boxes: TrackedBoxes) -> tuple[FloatArray, BoolArray]:
    return iou(labels.xyxy_px, boxes.xyxy_px), labels.class_id[:, None] == boxes.class_id


def _causes(frames: Sequence[_Frame], labels: TrackedBoxes) -> Iterator[str]:
    """Of each label, whether it is tracked, and if not, what of it was detected."""
    for frame in frames:
        of_frame = labels.select(labels.frame == frame.number)
        by_tracks, is_tracked_class = _overlap(of_frame, _boxes(frame.number, frame.tracks))
        overlap, is_class = _overlap(of_frame, _boxes(frame.number, frame.detections))
        for row in range(len(of_frame)):
            found = overlap[row] >= _MIN_IOU
            if (by_tracks[row][is_tracked_class[row]] >= _MIN_IOU).any():
                yield "tracked"
            elif (found & is_class[row]).any():
                yield "detected, not tracked"
            elif found.any():
                yield "another class"
            elif (overlap[row] >= _LOOSE_IOU).any():
                yield "box of a part (IoU 0.25 to 0.5)"
            else:
                yield "not detected"
