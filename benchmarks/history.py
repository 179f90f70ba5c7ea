"""Median label prediction (`tracking/history.py`): what it is worth by k, form and gates, and the paper's figure 5.

Protocol: the stored RRC boxes of KITTI tracking sequences, cars and pedestrians, tracked without pictures; KITTI's own
rules of what counts. The gates were chosen on these very sequences, with MOT15's and MOT17's: HOTA is also given for
even and odd numbers, to show how far a gain is one of all; the table ranks the variants, it promises nothing elsewhere.

    jitter = |second difference of a box's edges over three frames in a row|, median of each track minus the same of the
             truth that it matches (IoU >= 0.5), mean over tracks by their number of such triples; pixels
    label  = the paper's median-smoothed box, the figure's "after"; its error is the median |edge - truth's edge|

`--figure FILE` draws an edge of one track's box, as detected, and as the paper smooths and predicts it (its figure 5).
"""

from __future__ import annotations

import argparse
from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from rich import box
from rich.console import Console
from rich.table import Table

from benchmarks.inputs import tracking_sets
from benchmarks.inputs.drives import REAL_DATA
from benchmarks.inputs.tracking_sets import sequences_of
from track_range.detection.boxes import iou
from track_range.detection.classes import ROAD_CLASSES
from track_range.detection.formats.kitti import KittiLabels
from track_range.foundation.arrays import BoolArray, FloatArray, IntArray
from track_range.sequences.tracking import track_sequence
from track_range.tracking.association import min_cost_matching
from track_range.tracking.benchmark_rules import KITTI_TYPES
from track_range.tracking.deepsort import DeepSortSettings, DeepSortTracker
from track_range.tracking.evaluation import TrackingCounts
from track_range.tracking.history import BoxHistory, Form, PredictionGates, smoothed
from track_range.tracking.tracked_boxes import TrackedBoxes

FORMS: tuple[Form, ...] = ("median-of-steps", "step-of-medians")
TRUTH, FOUND, PREDICTED = "#8c96a0", "#2f7ed8", "#e08214"


def add_options(parser: argparse.ArgumentParser) -> None:
    """Options of this workload."""
    parser.add_argument("--data", type=Path, default=REAL_DATA, help="folder with kitti_labels")
    parser.add_argument("--classes", nargs="+", default=["car", "person"], choices=["car", "person"])
    parser.add_argument("--k", type=int, nargs="+", default=[2, 3, 5, 7, 9], help="frames of the median")
    parser.add_argument("--figure", type=Path, metavar="FILE", help="draw the figure (PNG) instead of the tables")
    parser.add_argument("--track", metavar="NAME:ID", help="its track; default: one that shows much")


@dataclass(frozen=True, slots=True)
class _Tracked:
    """A sequence's reported boxes, ordered by track and frame, and what they match.

    Attributes:
        boxes: (N).
        observed: (N,) False = predicted.
        truth_row: (N,) row of the labels that each matches in its frame; -1 = none.
        truth_xyxy_px: (N, 4) its box; NaN = none.
    """

    boxes: TrackedBoxes
    observed: BoolArray
    truth_row: IntArray
    truth_xyxy_px: FloatArray


def measure(options: argparse.Namespace) -> dict[str, Any]:
    """Run all settings and print a table per class; or draw the figure."""
    sequences = {name: sequences_of(f"kitti-{name}", options.data) for name in options.classes}
    if options.figure:
        return _draw(sequences[options.classes[0]], options.k[len(options.k) // 2], options)
    figures = {}
    for road_class, found in sequences.items():
        figures[road_class] = [_row(found, *setting) for setting in _settings(options.k)]
        _tell(figures[road_class], f"{road_class}: {len(found)} KITTI sequences")
    return {"protocol": __doc__, "classes": figures}


def _settings(ks: Sequence[int]) -> list[tuple[str, int, PredictionGates]]:
    """Name of the gates, k, gates."""
    free = PredictionGates(min_hit_streak=2, min_hit_streak_visible=2, max_deviation=np.inf, min_margin=0.0)
    rows = [("nothing", k, PredictionGates(n_kept=k + 1, max_missing_s=0.0)) for k in ks]
    for form in FORMS:
        rows += [(f"{form}, border, age", k, replace(free, form=form, n_kept=k + 1)) for k in ks]
        rows += [(f"{form}, all gates", k, PredictionGates(form=form, n_kept=k + 1)) for k in ks]
    return rows


def _row(sequences: Sequence[tracking_sets.Sequence], name: str, k: int, gates: PredictionGates) -> dict[str, Any]:
    """Figures of one setting."""
    tracked = [_tracked(each, gates) for each in sequences]
    boxes = [result.boxes for result in tracked]
    counts = [
        each.counts(found.frame, found.track_id, found.xyxy_px) for each, found in zip(sequences, boxes, strict=True)
    ]
    even = [int(each.name) % 2 == 0 for each in sequences]
    halves = [TrackingCounts.sum_of([c for c, e in zip(counts, even, strict=True) if e == half]) for half in (1, 0)]
    scores = TrackingCounts.sum_of(counts).scores()
    labels = [_labels(result, k) for result in tracked]
    truth = np.concatenate([result.truth_xyxy_px for result in tracked])
    return {
        "predicted": name,
        "k": k,
        "hota": scores.hota,
        "hota_even": halves[0].scores().hota,
        "hota_odd": halves[1].scores().hota,
        "mota": scores.mota,
        "frag": scores.frag,
        "n_predicted": sum(int(np.count_nonzero(~result.observed)) for result in tracked),
        "jitter_px": _jitter_px(tracked, [found.xyxy_px for found in boxes]),
        "label_jitter_px": _jitter_px(tracked, labels),
        "error_px": float(np.nanmedian(np.abs(np.concatenate([found.xyxy_px for found in boxes]) - truth))),
        "label_error_px": float(np.nanmedian(np.abs(np.concatenate(labels) - truth))),
    }


def _tracked(sequence: tracking_sets.Sequence, gates: PredictionGates) -> _Tracked:
    tracker, n_frames = DeepSortTracker(DeepSortSettings(prediction=gates)), sequence.n_frames
    tracks = track_sequence(sequence.found, tracker, n_frames=n_frames, fps=sequence.fps, is_online=True).frames
    frame = np.repeat(np.arange(len(tracks)), [len(each) for each in tracks])
    track_id = np.concatenate([each.track_id for each in tracks])
    xyxy_px = np.concatenate([each.xyxy_px for each in tracks])
    class_id = np.full(len(frame), ROAD_CLASSES.index(sequence.road_class))
    order = np.lexsort((frame, track_id))
    boxes = TrackedBoxes(frame, track_id, xyxy_px, class_id).select(order)
    observed = np.concatenate([each.observed for each in tracks])[order]
    row = _truth_of_each(sequence, boxes)
    return _Tracked(boxes, observed, row, np.where(row[:, None] >= 0, _truth(sequence).xyxy_px[row], np.nan))


def _truth(sequence: tracking_sets.Sequence) -> KittiLabels:
    if not isinstance(sequence.truth, KittiLabels):
        raise TypeError(f"{sequence.name}: KITTI's labels wanted")
    return sequence.truth


def _truth_of_each(sequence: tracking_sets.Sequence, boxes: TrackedBoxes) -> IntArray:
    """(N,) the row of the labels that each box matches in its frame; -1 = none."""
    labels = _truth(sequence)
    is_class = labels.kitti_type == KITTI_TYPES[sequence.road_class][0]
    found = np.full(len(boxes), -1)
    for frame in range(sequence.n_frames):
        rows, here = np.flatnonzero(boxes.frame == frame), np.flatnonzero((labels.frame == frame) & is_class)
        overlap = iou(boxes.xyxy_px[rows], labels.xyxy_px[here])
        got, wanted = min_cost_matching(np.where(overlap >= 0.5, 1.0 - overlap, np.inf), max_cost=1.0)
        found[rows[got]] = here[wanted]
    return found


def _labels(tracked: _Tracked, k: int) -> FloatArray:
    """(N, 4) median-smoothed boxes; a predicted one as it is."""
    found = tracked.boxes.xyxy_px.copy()
    for track_id in np.unique(tracked.boxes.track_id):
        rows = np.flatnonzero((tracked.boxes.track_id == track_id) & tracked.observed)
        buffer = np.concatenate([np.full((k, 4), np.nan), tracked.boxes.xyxy_px[rows]])
        windows = np.lib.stride_tricks.sliding_window_view(buffer, k + 1, axis=0).transpose(0, 2, 1)
        hit_streak = np.ones(len(rows), np.int64)
        found[rows] = smoothed(BoxHistory(windows, np.zeros(windows.shape[:2]), hit_streak))
    return found


def _jitter_px(tracked: Sequence[_Tracked], boxes: Sequence[FloatArray]) -> float:
    """See the module's docstring; `boxes` are (N, 4) of each sequence."""
    excess, weight = [], []
    for each, xyxy_px in zip(tracked, boxes, strict=True):
        rows = _triples(each)
        bends = [np.abs(np.diff(b[rows], n=2, axis=1)[:, 0]) for b in (xyxy_px, each.truth_xyxy_px)]
        track_id = each.boxes.track_id[rows[:, 0]]
        for track in np.unique(track_id):
            own = track_id == track
            excess.append(float(np.median(bends[0][own]) - np.median(bends[1][own])))
            weight.append(int(np.count_nonzero(own)))
    return float(np.average(excess, weights=weight))


def _triples(tracked: _Tracked) -> IntArray:
    """(T, 3) rows of one track in three frames in a row, each of which matches truth."""
    rows = np.arange(len(tracked.boxes) - 2)[:, None] + np.arange(3)
    boxes, known = tracked.boxes, np.isfinite(tracked.truth_xyxy_px[:, 0])
    one_track = boxes.track_id[rows[:, 0]] == boxes.track_id[rows[:, 2]]
    in_a_row = boxes.frame[rows[:, 2]] - boxes.frame[rows[:, 0]] == 2
    return np.asarray(rows[one_track & in_a_row & known[rows].all(axis=1)])


_COLUMNS = {
    "hota": "HOTA",
    "hota_even": "even",
    "hota_odd": "odd",
    "mota": "MOTA",
    "frag": "Frag",
    "n_predicted": "predicted\nboxes",
    "jitter_px": "jitter\npx",
    "label_jitter_px": "label's\njitter",
    "error_px": "error\npx",
    "label_error_px": "label's\nerror",
}


def _tell(rows: Sequence[dict[str, Any]], title: str) -> None:
    table = Table(title=title, box=box.SIMPLE_HEAD, padding=0, title_justify="left")
    table.add_column("predicted", no_wrap=True)
    for heading in ("k", *_COLUMNS.values()):
        table.add_column(heading, justify="right", no_wrap=True)
    for row in rows:
        cells = (row[key] for key in ("k", *_COLUMNS))
        table.add_row(row["predicted"], *(f"{c:.2f}" if isinstance(c, float) else str(c) for c in cells))
    Console(width=140).print(table)


def _draw(sequences: Sequence[tracking_sets.Sequence], k: int, options: argparse.Namespace) -> dict[str, Any]:
    """The paper's figure 5: an edge of one track's box over the frames, before and after."""
    gates = PredictionGates(form="step-of-medians", n_kept=k + 1)
    tracked = {each.name: _tracked(each, gates) for each in sequences}
    name, track = options.track.split(":") if options.track else _most_telling(tracked)
    sequence, result = next(each for each in sequences if each.name == name), tracked[name]
    own = np.flatnonzero(result.boxes.track_id == int(track))
    if not (len(own) and (result.truth_row[own] >= 0).any()):
        raise SystemExit(f"{name}: no track {track} that matches truth.")
    edge = int(np.argmax(_flicker(result, own)))
    frame, observed = result.boxes.frame[own], result.observed[own]
    label_px = _labels(result, k)[own, edge]
    figure = Figure(figsize=(9.5, 6.2), layout="constrained")
    upper, lower = figure.subplots(2, 1, sharex=True, sharey=True)
    for axes in (upper, lower):
        _line(axes, *_truth_of_track(sequence, result, own, edge), color=TRUTH, linewidth=5, alpha=0.4, label="truth")
        axes.set_ylabel(f"{('left', 'upper', 'right', 'lower')[edge]} edge of the box, px")
        axes.grid(True, alpha=0.2, linewidth=0.6)
        axes.spines[["top", "right"]].set_visible(False)
    seen_px = np.where(observed, result.boxes.xyxy_px[own, edge], np.nan)
    _line(upper, frame, seen_px, color=FOUND, marker=".", linewidth=1.2, label="box as detected")
    _line(lower, frame, label_px, color=FOUND, linewidth=1.6, label=f"label: median of {k}")
    lower.plot(frame[~observed], label_px[~observed], "o", mfc="white", mec=PREDICTED, mew=1.6, label="observed False")
    title = f"KITTI {name}, {ROAD_CLASSES[result.boxes.class_id[0]]} {track}"
    upper.set_title(f"(a) {title}: boxes as detected, missing ones left out", loc="left", fontsize=10)
    lower.set_title("(b) the same after: median-smoothed, missing boxes predicted", loc="left", fontsize=10)
    lower.set_xlabel("frame, 10 per second")
    for axes in (upper, lower):
        axes.legend(frameon=False, loc="best")
    figure.savefig(options.figure, dpi=110)
    print(f"{options.figure}: sequence {name}, track {track}, median of {k}")
    return {"sequence": name, "track_id": int(track), "k": k, "n_predicted": int(np.count_nonzero(~observed))}


def _truth_of_track(
    sequence: tracking_sets.Sequence, result: _Tracked, own: IntArray, edge: int
) -> tuple[IntArray, FloatArray]:
    """Frames and edge of the true object that a track matches most, over the track's time."""
    labels, rows = _truth(sequence), result.truth_row[own]
    true_id = np.bincount(labels.track_id[rows[rows >= 0]]).argmax()
    first, last = result.boxes.frame[own[[0, -1]]]
    here = np.flatnonzero((labels.track_id == true_id) & (labels.frame >= first) & (labels.frame <= last))
    return labels.frame[here], labels.xyxy_px[here, edge]


def _line(axes: Axes, frame: IntArray, y_px: FloatArray, **style: Any) -> None:
    """A line that is broken where frames are missing."""
    y = np.full(frame[-1] - frame[0] + 1, np.nan)
    y[frame - frame[0]] = y_px
    axes.plot(np.arange(frame[0], frame[-1] + 1), y, **style)


def _most_telling(tracked: dict[str, _Tracked]) -> tuple[str, int]:
    """Sequence and track, of 60 boxes at least, with the most flicker times predictions that match truth."""
    best, chosen = -1.0, ("", 0)
    for name, each in tracked.items():
        right = ~each.observed & (each.truth_row >= 0)
        for track_id in np.unique(each.boxes.track_id):
            own = np.flatnonzero(each.boxes.track_id == track_id)
            value = np.count_nonzero(right[own]) * _flicker(each, own).max() if len(own) >= 60 else -1.0
            best, chosen = max((best, chosen), (float(value), (name, int(track_id))))
    return chosen


def _flicker(tracked: _Tracked, own: IntArray) -> FloatArray:
    """(4,) mean second difference of a track's edges, as a share of the way they go (15 px at least)."""
    xyxy_px = tracked.boxes.xyxy_px[own]
    return np.asarray(np.abs(np.diff(xyxy_px, n=2, axis=0)).mean(axis=0) / np.maximum(np.ptp(xyxy_px, axis=0), 15.0))
