"""Errors of the packaged detector, of stereo and of tracks on rendered drives, and on drives without images.

Protocol: rendered drives of the seeds on which the error model of `benchmarks/boxes` was fitted (`--fit-seeds`) and of
others (`--seeds`), one scenario each; the same scenes without rendering, with the model's errors (`--errors` drives
each). Boxes are matched to the truth one to one, IoU at least 0.4, at least 0.15 for objects lower than 10 px, which
detectors enlarge.
"""

from __future__ import annotations

from argparse import ArgumentParser, Namespace
from collections.abc import Sequence
from dataclasses import dataclass
from itertools import pairwise
from pathlib import Path
from typing import Any

import numpy as np
from rich.console import Console

from benchmarks.accuracy.collision_warnings.track_errors import TrackErrors, rendered_errors, simulated_errors
from benchmarks.boxes.box_drive import BoxDrive
from benchmarks.boxes.true_boxes import TrueBoxes
from benchmarks.inputs.conflict_drives import FPS, conflict_drive, default_cache, stored_boxes
from benchmarks.plain_tables import figure_text, plain_table
from track_range.detection.boxes import iou
from track_range.detection.classes import ROAD_CLASS_OF, ROAD_CLASSES, SAME_OBJECT_GROUP
from track_range.detection.detections import Detections
from track_range.foundation.arrays import BoolArray, FloatArray, IntArray
from track_range.simulation.render.renderer import kitti_like_rig
from track_range.simulation.world.scenarios import make_scenario
from track_range.simulation.world.scene import Scene

SCENARIOS = (
    "rear-stationary",
    "crossing-adult",
    "rear-slower",
    "oncoming",
    "city",
    "crossing-child",
    "rear-braking",
    "curve-parked",
    "following",
    "overhead-sign",
)
"""Scenario of the drive of each seed, by the last digit of the seed."""

WIDTH_PX = 620
"""Width of the images, px."""

MIN_IOU, MIN_IOU_SMALL, SMALL_PX = 0.4, 0.15, 10.0
"""Smallest IoU of a detected box with the true one; that of objects lower than `SMALL_PX`."""

HEIGHTS_PX = (4, 6, 8, 12, 16, 24, 40, 400)
"""Limits of the bins of heights, px, of images 620 px wide."""


@dataclass(frozen=True, slots=True)
class Matched:
    """True boxes of drives with the detection of each, and the boxes without an object.

    Attributes:
        user: (M,) number of the object, unique among the drives.
        frame: (M,) frame.
        class_id: (M,) true class.
        height_px, hidden_fraction, outside_fraction: (M,) of the true box.
        score: (M,) of the detection; NaN = missed.
        detected_class_id: (M,) class of the detection; -1 = missed.
        errors: (M, 4) errors of centre x, centre y, log width, log height: centres relative to the height.
        false_boxes: (K, 7) drive, frame, box, score of boxes without an object.
        false_class_id: (K,) their classes.
        n_frames: number of frames.
    """

    user: IntArray
    frame: IntArray
    class_id: IntArray
    height_px: FloatArray
    hidden_fraction: FloatArray
    outside_fraction: FloatArray
    score: FloatArray
    detected_class_id: IntArray
    errors: FloatArray
    false_boxes: FloatArray
    false_class_id: IntArray
    n_frames: int

    @property
    def is_detected(self) -> BoolArray:
        """(M,) whether there is a detection."""
        return np.isfinite(self.score)


def matched_boxes(scene: Scene, true: TrueBoxes, frames: Sequence[Detections], *, drive: int) -> Matched:
    """The detections of one drive, matched to its true boxes."""
    classes = np.array([ROAD_CLASSES.index(ROAD_CLASS_OF[user.kitti_type.lower()]) for user in scene.road_users])
    n = len(true.frame)
    score, detected_class, errors = np.full(n, np.nan), np.full(n, -1), np.full((n, 4), np.nan)
    false, false_class = [], []
    ends = np.searchsorted(true.frame, np.arange(len(frames) + 1))
    for number, boxes in enumerate(frames):
        rows = np.arange(ends[number], ends[number + 1])
        limit = np.where(true.height_px[rows] < SMALL_PX, MIN_IOU_SMALL / MIN_IOU, 1.0)
        overlap = iou(true.xyxy_px[rows], boxes.xyxy_px) / limit[:, None]
        is_used = np.zeros(len(boxes), bool)
        for flat in np.argsort(-overlap, axis=None).tolist():
            row, column = divmod(flat, max(len(boxes), 1))
            if not overlap.size or overlap[row, column] < MIN_IOU:
                break
            if is_used[column] or np.isfinite(score[rows[row]]):
                continue
            is_used[column] = True
            score[rows[row]], detected_class[rows[row]] = boxes.score[column], boxes.class_id[column]
            errors[rows[row]] = _errors(true.xyxy_px[rows[row]], boxes.xyxy_px[column])
        covered = overlap.max(axis=0, initial=0.0) >= MIN_IOU  # a second box of an object is not a false box
        for column in np.flatnonzero(~is_used & ~covered).tolist():
            false.append([drive, number, *boxes.xyxy_px[column], boxes.score[column]])
            false_class.append(boxes.class_id[column])
    return Matched(
        true.user + 10_000 * drive,
        true.frame,
        classes[true.user],
        true.height_px,
        true.hidden_fraction,
        true.outside_fraction,
        score,
        detected_class,
        errors,
        np.array(false, np.float64).reshape(-1, 7),
        np.array(false_class, np.int64),
        len(frames),
    )


def _errors(true: FloatArray, detected: FloatArray) -> FloatArray:
    width, height = true[2:] - true[:2]
    other_width, other_height = detected[2:] - detected[:2]
    centre = (detected[:2] + detected[2:] - true[:2] - true[2:]) / 2 / height
    return np.array([*centre, np.log(other_width / width), np.log(other_height / height)])


def joined(parts: Sequence[Matched]) -> Matched:
    """The matches of several drives."""
    columns = {
        name: np.concatenate([getattr(part, name) for part in parts])
        for name in Matched.__dataclass_fields__
        if name != "n_frames"
    }
    return Matched(**columns, n_frames=sum(part.n_frames for part in parts))


def add_options(parser: ArgumentParser) -> None:
    """Add the options of this workload."""
    parser.add_argument("--seeds", type=int, nargs="+", default=list(range(20, 30)), metavar="N", help="other seeds")
    parser.add_argument("--fit-seeds", type=int, nargs="+", default=list(range(10)), metavar="N", help="fitted seeds")
    parser.add_argument("--errors", type=int, default=3, metavar="N", help="drives without images per scene")
    parser.add_argument("--cache", type=Path, default=default_cache(), metavar="DIR", help="folder of rendered drives")


def measure(options: Namespace) -> dict[str, Any]:
    """Figures of rendered drives and of those without images, in the same scenes; prints the table."""
    figures: dict[str, dict[str, float | None]] = {}
    for name, seeds in (("fitted", options.fit_seeds), ("others", options.seeds)):
        parts = [_drive_errors(options, seed) for seed in seeds]
        for number, source in enumerate(("rendered", "model")):
            boxes = joined([part[number][0] for part in parts])
            tracks = sum((part[number][1] for part in parts), TrackErrors())
            figures[f"{source},\n{name}"] = {**_statistics(boxes), **tracks.figures()}
    table = plain_table("errors of boxes and tracks", "figure", *figures)
    for figure in dict.fromkeys(name for column in figures.values() for name in column):
        table.add_row(figure, *(_text(column.get(figure)) for column in figures.values()))
    Console().print(table)
    return {name.replace("\n", " "): column for name, column in figures.items()}


def _text(value: float | None) -> str:
    return figure_text(value, digits=3 if value is None or value < 10 else 0)


def _drive_errors(options: Namespace, seed: int) -> tuple[tuple[Matched, TrackErrors], tuple[Matched, TrackErrors]]:
    """Boxes and tracks of a rendered drive, and of drives without images in its scene."""
    scenario = SCENARIOS[seed % 10]
    drive = conflict_drive(options.cache, scenario, seed, width_px=WIDTH_PX)
    boxes = stored_boxes(drive.boxes)
    times_s, seconds = np.arange(len(boxes)) / FPS, len(boxes) / FPS
    scene = make_scenario(scenario, seed=seed, seconds=seconds)
    rig = kitti_like_rig(width_px=WIDTH_PX, height_px=188)
    others = [BoxDrive(scene, times_s, rig, seed=1000 * seed + number) for number in range(options.errors)]
    rendered = matched_boxes(scene, others[0].true, boxes, drive=seed)
    matched = [
        matched_boxes(scene, other.true, [frame.detections for frame in other], drive=1000 * seed + number)
        for number, other in enumerate(others)
    ]
    simulated = simulated_errors(scenario, seed, seconds=seconds, n_errors=options.errors)
    return (rendered, rendered_errors(options.cache, scenario, seed)), (joined(matched), simulated)


def _statistics(matched: Matched) -> dict[str, float | None]:
    """Detection rates, scores and errors by height, runs of misses, and false boxes."""
    group = SAME_OBJECT_GROUP[matched.class_id]
    figures: dict[str, float | None] = {}
    for number, name in ((0, "person"), (2, "vehicle")):
        for low, high in pairwise(HEIGHTS_PX):
            rows = (group == number) & (matched.height_px >= low) & (matched.height_px < high)
            for label, is_hidden in (("", matched.hidden_fraction <= 0.1), (" hidden", matched.hidden_fraction > 0.1)):
                part = rows & is_hidden & (matched.outside_fraction < 0.3)
                if part.sum() >= 30:
                    figures[f"{name} {low}-{high} px{label}: rate"] = float(matched.is_detected[part].mean())
            part = rows & matched.is_detected & (matched.hidden_fraction < 0.3) & (matched.outside_fraction < 0.05)
            if part.sum() >= 30:
                figures[f"{name} {low}-{high} px: median score"] = float(np.median(matched.score[part]))
                spread = 1.4826 * np.median(
                    np.abs(matched.errors[part] - np.median(matched.errors[part], axis=0)), axis=0
                )
                for label, value in zip(("centre x", "centre y", "log width", "log height"), spread, strict=True):
                    figures[f"{name} {low}-{high} px: sigma of {label}"] = float(value)
    runs = _missed_runs(matched)
    figures["runs of misses: mean, frames"] = float(np.mean(runs)) if runs else None
    figures["runs of misses: 90 %, frames"] = float(np.quantile(runs, 0.9)) if runs else None
    return figures


def _missed_runs(matched: Matched) -> list[int]:
    """Lengths of the runs of missed frames of clearly visible objects."""
    is_clear = (matched.hidden_fraction < 0.3) & (matched.height_px > 12) & (matched.outside_fraction < 0.3)
    order = np.lexsort((matched.frame, matched.user))
    runs, length, last = [], 0, -1
    for row in order[is_clear[order]].tolist():
        if matched.user[row] != last or matched.is_detected[row]:
            if length:
                runs.append(length)
            length = 0
        last = int(matched.user[row])
        length += not matched.is_detected[row]
    return [*runs, length] if length else runs
