"""Errors of the packaged detector, of stereo and of tracks on rendered drives, and on drives
without images.

Boxes are matched to the truth one to one, IoU at least 0.4, at least 0.15 for objects lower than 10
px, which detectors enlarge. Tracks and detections are counted with a smaller IoU.
"""

from __future__ import annotations

from argparse import Namespace
from collections import Counter
from collections.abc import Iterable, Sequence
from dataclasses import dataclass, field
from itertools import pairwise

import numpy as np

from benchmarks.accuracy.warnings.warning_drives import matched_users, run_of
from benchmarks.boxes.box_drive import BoxDrive
from benchmarks.boxes.box_run import run_boxes, tracked
from benchmarks.boxes.true_boxes import TrueBoxes, true_boxes
from benchmarks.harness import Figures, median_or_none, option, quantile_or_none, workload
from benchmarks.inputs.drives import CACHE_OPTION, FPS, ConflictDrive, conflict_drive
from track_range.detection.boxes import iou
from track_range.detection.classes import ROAD_CLASS_OF, ROAD_CLASSES, SAME_OBJECT_GROUP
from track_range.detection.detections import Detections
from track_range.foundation.arrays import BoolArray, FloatArray, IntArray
from track_range.pipeline.frame_result import FrameResult
from track_range.simulation.render.renderer import kitti_like_rig
from track_range.simulation.world.scenarios import make_scenario
from track_range.simulation.world.scene import Scene

SCENARIOS = (
    *("rear-stationary", "crossing-adult", "rear-slower", "oncoming", "city"),
    *("crossing-child", "rear-braking", "curve-parked", "following", "overhead-sign"),
)
"""Scenario of the drive of each seed, by the last digit of the seed."""

WIDTH_PX, HEIGHT_PX = 620, 188
RIG = kitti_like_rig(width_px=WIDTH_PX, height_px=HEIGHT_PX)

MIN_IOU, MIN_IOU_SMALL, SMALL_PX = 0.4, 0.15, 10.0
"""Smallest IoU of a detected box with the true one; that of objects lower than `SMALL_PX`."""

# limits of the bins of heights, px, of images 620 px wide
HEIGHTS_PX = (4, 6, 8, 12, 16, 24, 40, 400)

TRACK_IOU, TRACK_IOU_SMALL = 0.3, 0.12
"""Smallest IoU of the box of a track, or of a counted detection, with its object; that of small
objects."""

LANE_M = 1.5  # largest lateral offset from the ego path of an object in the lane, m

STEADY_PX = 1.0
"""Largest standard deviation of a false track's disparities about a straight line that counts as
consistent, px."""

SCORES = (0.1, 0.2, 0.3, 0.5)  # lower limits
# longest gap, in frames, after which a track's change of object is one between neighbours
GAP_FRAMES = 3


@dataclass(frozen=True, slots=True)
class Matched:
    """True boxes of drives with the detection of each, and the boxes without an object."""

    user: IntArray  # (M,) number of the object, unique among the drives
    frame: IntArray  # (M,) frame
    class_id: IntArray  # (M,) true class
    height_px: FloatArray  # height_px, hidden_fraction, outside_fraction: (M,) of the true box
    hidden_fraction: FloatArray
    outside_fraction: FloatArray
    score: FloatArray  # (M,) of the detection; NaN = missed
    detected_class_id: IntArray  # (M,) class of the detection; -1 = missed
    # (M, 4) errors of centre x, centre y, log width, log height: centres relative to the height
    errors: FloatArray
    false_boxes: FloatArray  # (K, 7) drive, frame, box, score of boxes without an object
    false_class_id: IntArray  # (K,) their classes
    n_frames: int  # number of frames

    @property
    def is_detected(self) -> BoolArray:
        return np.isfinite(self.score)


def matched_boxes(
    scene: Scene, true: TrueBoxes, frames: Sequence[Detections], *, drive: int
) -> Matched:
    classes = np.array(
        [ROAD_CLASSES.index(ROAD_CLASS_OF[user.kitti_type.lower()]) for user in scene.road_users]
    )
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
            score[rows[row]], detected_class[rows[row]] = (
                boxes.score[column],
                boxes.class_id[column],
            )
            errors[rows[row]] = _errors(true.xyxy_px[rows[row]], boxes.xyxy_px[column])
        # a second box of an object is not a false box
        covered = overlap.max(axis=0, initial=0.0) >= MIN_IOU
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
    columns = {
        name: np.concatenate([getattr(part, name) for part in parts])
        for name in Matched.__dataclass_fields__
        if name != "n_frames"
    }
    return Matched(**columns, n_frames=sum(part.n_frames for part in parts))


@workload(
    option("--seeds", default=tuple(range(20, 30)), metavar="N", help="other seeds"),
    option("--fit-seeds", default=tuple(range(10)), metavar="N", help="fitted seeds"),
    option("--errors", default=3, metavar="N", help="drives without images per scene"),
    CACHE_OPTION,
)
def box_errors(options: Namespace) -> Figures:
    figures: Figures = {}
    for name, seeds in (("fitted", options.fit_seeds), ("others", options.seeds)):
        parts = [_drive_errors(options, seed) for seed in seeds]
        for number, source in enumerate(("rendered", "model")):
            boxes = joined([part[number][0] for part in parts])
            tracks = sum((part[number][1] for part in parts), TrackErrors())
            for figure, value in {**_statistics(boxes), **tracks.figures()}.items():
                figures.setdefault(figure, {})[f"{source}, {name}"] = value
    return figures


def _drive_errors(
    options: Namespace, seed: int
) -> tuple[tuple[Matched, TrackErrors], tuple[Matched, TrackErrors]]:
    scenario = SCENARIOS[seed % 10]
    drive = conflict_drive(options.cache, scenario, seed, width_px=WIDTH_PX)
    times_s = np.arange(len(drive.boxes)) / FPS
    scene = make_scenario(scenario, seed=seed, seconds=drive.seconds)
    others = [
        BoxDrive(scene, times_s, RIG, seed=1000 * seed + number) for number in range(options.errors)
    ]
    rendered = matched_boxes(scene, others[0].true, drive.boxes, drive=seed)
    matched = [
        matched_boxes(
            scene, other.true, [frame.detections for frame in other], drive=1000 * seed + number
        )
        for number, other in enumerate(others)
    ]
    simulated = simulated_errors(scenario, seed, seconds=drive.seconds, n_errors=options.errors)
    return (rendered, rendered_errors(drive, scene)), (joined(matched), simulated)


def _statistics(matched: Matched) -> dict[str, float | None]:
    group = SAME_OBJECT_GROUP[matched.class_id]
    figures: dict[str, float | None] = {}
    for number, name in ((0, "person"), (2, "vehicle")):
        for low, high in pairwise(HEIGHTS_PX):
            rows = (group == number) & (matched.height_px >= low) & (matched.height_px < high)
            for label, is_hidden in (
                ("", matched.hidden_fraction <= 0.1),
                (" hidden", matched.hidden_fraction > 0.1),
            ):
                part = rows & is_hidden & (matched.outside_fraction < 0.3)
                if part.sum() >= 30:
                    figures[f"{name} {low}-{high} px{label}: rate"] = float(
                        matched.is_detected[part].mean()
                    )
            part = (
                rows
                & matched.is_detected
                & (matched.hidden_fraction < 0.3)
                & (matched.outside_fraction < 0.05)
            )
            if part.sum() >= 30:
                figures[f"{name} {low}-{high} px: median score"] = float(
                    np.median(matched.score[part])
                )
                spread = 1.4826 * np.median(
                    np.abs(matched.errors[part] - np.median(matched.errors[part], axis=0)), axis=0
                )
                for label, value in zip(
                    ("centre x", "centre y", "log width", "log height"), spread, strict=True
                ):
                    figures[f"{name} {low}-{high} px: sigma of {label}"] = float(value)
    runs = _missed_runs(matched)
    figures["runs of misses: mean, frames"] = float(np.mean(runs)) if runs else None
    figures["runs of misses: 90 %, frames"] = quantile_or_none(runs, 0.9)
    return figures


def _missed_runs(matched: Matched) -> list[int]:
    is_clear = (
        (matched.hidden_fraction < 0.3)
        & (matched.height_px > 12)
        & (matched.outside_fraction < 0.3)
    )
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


@dataclass(slots=True)
class TrackErrors:
    """Sums over drives; `+` joins them."""

    seconds: float = 0.0  # duration
    # false_boxes, second_boxes: number of boxes without an object, and of further boxes of an
    # object, by `SCORES`
    false_boxes: FloatArray = field(default_factory=lambda: np.zeros(len(SCORES)))
    second_boxes: FloatArray = field(default_factory=lambda: np.zeros(len(SCORES)))
    # duration in s, fraction with a stereo distance, deviation of disparities in px, offset from
    # the ego path in m, largest probability of contact, of each track without an object
    false_tracks: list[list[float]] = field(default_factory=list)
    # n_tracks, n_mixed: number of tracks of objects; of those with several objects, three frames or
    # more of each
    n_tracks: int = 0
    n_mixed: int = 0
    # n_neighbours, n_later: number of changes of a track's object, without a gap and after one
    n_neighbours: int = 0
    n_later: int = 0
    n_switches: int = 0  # number of changes of an object's track
    # n_rows, n_second: number of objects' boxes with a track; with another one at the same time
    n_rows: int = 0
    n_second: int = 0
    # distance of the first tracked box of each person and vehicle
    starts_m: dict[str, list[float]] = field(default_factory=lambda: {"person": [], "vehicle": []})

    def __add__(self, other: TrackErrors) -> TrackErrors:
        values = {
            name: getattr(self, name) + getattr(other, name)
            for name in self.__slots__
            if name != "starts_m"
        }
        starts_m = {name: self.starts_m[name] + other.starts_m[name] for name in self.starts_m}
        return TrackErrors(**values, starts_m=starts_m)

    def figures(self) -> dict[str, float | None]:
        """Rates per frame, per hour and per object-hour."""
        hours, n_frames = self.seconds / 3600, self.seconds * FPS
        rows = np.array(self.false_tracks, np.float64).reshape(-1, 5)
        is_long = rows[:, 0] >= 1.0
        is_steady = is_long & (rows[:, 1] > 0.5) & (rows[:, 2] < STEADY_PX)
        is_in_lane = np.abs(rows[:, 3]) < LANE_M
        return {
            **{
                f"{name} boxes per frame, score > {limit}": n / n_frames
                for name, counts in (("false", self.false_boxes), ("second", self.second_boxes))
                for limit, n in zip(SCORES, counts, strict=True)
            },
            "false tracks per h": len(rows) / hours,
            "false tracks > 1 s per h": is_long.sum() / hours,
            "false tracks > 1 s per h, steady stereo": is_steady.sum() / hours,
            "false tracks > 1 s per h, in the lane": (is_long & is_in_lane).sum() / hours,
            "false tracks > 1 s per h, both": (is_steady & is_in_lane).sum() / hours,
            "false tracks per h, probability > 0.1": (rows[:, 4] > 0.1).sum() / hours,
            "tracks per h": self.n_tracks / hours,
            "tracks with several objects, %": 100 * self.n_mixed / max(self.n_tracks, 1),
            "tracks that change to a neighbour, per h": self.n_neighbours / hours,
            "tracks that change after a gap, per h": self.n_later / hours,
            "identity switches per object-hour": self.n_switches / max(self.n_rows, 1) * FPS * 3600,
            "objects with two tracks, %": 100 * self.n_second / max(self.n_rows, 1),
            **{
                f"first track of a {name}, median m": median_or_none(values)
                for name, values in self.starts_m.items()
            },
        }


def rendered_errors(drive: ConflictDrive, scene: Scene) -> TrackErrors:
    true = true_boxes(scene, np.arange(len(drive.boxes)) / FPS, RIG.left)
    with run_of(drive, is_stereo=True) as run:
        return _track_errors(scene, true, run, drive.boxes)


def simulated_errors(scenario: str, seed: int, *, seconds: float, n_errors: int) -> TrackErrors:
    """Errors on drives without images in the same scene."""
    scene, times_s = (
        make_scenario(scenario, seed=seed, seconds=seconds),
        np.arange(round(seconds * FPS)) / FPS,
    )
    errors = TrackErrors()
    for number in range(n_errors):
        drive = BoxDrive(scene, times_s, RIG, seed=1000 * seed + number)
        results = (step.result for step in run_boxes([drive], [tracked(drive)]))
        errors += _track_errors(scene, drive.true, results, [frame.detections for frame in drive])
    return errors


def _track_errors(
    scene: Scene, true: TrueBoxes, results: Iterable[FrameResult], boxes: Sequence[Detections]
) -> TrackErrors:
    errors = TrackErrors(seconds=len(boxes) / FPS)
    is_person = np.array(
        [user.kitti_type in ("Pedestrian", "Cyclist", "Motorcycle") for user in scene.road_users]
    )
    by_track: dict[int, list[tuple[float, ...]]] = {}
    track_of: dict[int, int] = {}
    for result in results:
        rows = np.flatnonzero(true.frame == result.index)
        detections, tracks = boxes[result.index], result.tracks
        min_iou = np.where(true.height_px[rows] < SMALL_PX, TRACK_IOU_SMALL, TRACK_IOU)
        _count_boxes(
            errors, matched_users(true, rows, detections.xyxy_px, min_iou)[0], detections.score
        )
        stereo_m, warnings = result.ranges["stereo"].distance_m, result.warnings
        nan = np.full(len(tracks), np.nan)
        probability, offset_m = (
            (warnings.probability, warnings.path_offset_m) if warnings else (nan, nan)
        )
        users, overlap = matched_users(true, rows, tracks.xyxy_px, min_iou)
        seen: set[int] = set()
        for row in np.argsort(-overlap, kind="stable").tolist():
            if not tracks.observed[row]:
                continue
            user, track_id = int(users[row]), int(tracks.track_id[row])
            values = (result.index, user, stereo_m[row], offset_m[row], probability[row])
            by_track.setdefault(track_id, []).append(values)
            if user < 0:
                continue
            errors.n_rows += user not in seen
            errors.n_second += user in seen
            if user in seen:
                continue
            seen.add(user)
            if user not in track_of:
                at_m = float(true.distance_m[rows[true.user[rows] == user]][0])
                errors.starts_m["person" if is_person[user] else "vehicle"].append(at_m)
            errors.n_switches += track_of.get(user, track_id) != track_id
            track_of[user] = track_id
    for track in by_track.values():
        _count_track(errors, np.array(track, np.float64))
    return errors


def _count_boxes(errors: TrackErrors, users: IntArray, score: FloatArray) -> None:
    """Count the boxes of a frame without an object, and all but the best of each object."""
    is_second = np.zeros(len(users), bool)
    order = np.argsort(-score, kind="stable")
    _, first = np.unique(users[order], return_index=True)
    is_second[order] = True
    is_second[order[first]] = False
    for number, limit in enumerate(SCORES):
        errors.false_boxes[number] += ((users < 0) & (score > limit)).sum()
        errors.second_boxes[number] += ((users >= 0) & is_second & (score > limit)).sum()


def _count_track(errors: TrackErrors, track: FloatArray) -> None:
    """Count one track: (K, 5) frame, object, stereo distance, offset, probability."""
    frame, user, stereo_m, offset_m, probability = track.T
    if np.mean(user < 0) > 0.5:
        has_stereo = np.isfinite(stereo_m)
        errors.false_tracks.append(
            [
                (frame[-1] - frame[0] + 1) / FPS,
                has_stereo.mean(),
                _deviation_px(frame[has_stereo], stereo_m[has_stereo]),
                float(np.median(offset_m[np.isfinite(offset_m)]))
                if np.isfinite(offset_m).any()
                else np.inf,
                float(np.max(probability, initial=0.0, where=np.isfinite(probability))),
            ]
        )
        return
    frame, user = frame[user >= 0], user[user >= 0]
    errors.n_tracks += 1
    errors.n_mixed += sum(n >= 3 for n in Counter(user.tolist()).values()) >= 2
    starts = np.flatnonzero(np.diff(user, prepend=-1))
    for start, end in pairwise([*starts.tolist(), len(user)]):
        if start and end - start >= 3:
            is_later = frame[start] - frame[start - 1] > GAP_FRAMES
            errors.n_later += bool(is_later)
            errors.n_neighbours += not is_later


def _deviation_px(frame: FloatArray, distance_m: FloatArray) -> float:
    """Robust standard deviation of disparities about a straight line over time, px; infinite for
    less than 4.
    """
    if len(frame) < 4:
        return np.inf
    disparity_px = RIG.left.fx_px * RIG.baseline_m / distance_m
    line = np.polyfit(frame, disparity_px, 1)
    return float(1.4826 * np.median(np.abs(disparity_px - np.polyval(line, frame))))
