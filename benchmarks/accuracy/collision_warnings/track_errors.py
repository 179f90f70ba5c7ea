"""Errors of tracks, of rendered drives and of drives without images: false tracks, identity switches, first distances.

Tracks and detections are compared with the true boxes by IoU; small true boxes, which detectors enlarge, need less.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterable, Sequence
from dataclasses import dataclass, field
from itertools import pairwise
from pathlib import Path

import numpy as np

from benchmarks.accuracy.collision_warnings.rendered import run_of
from benchmarks.boxes.box_drive import BoxDrive
from benchmarks.boxes.box_run import run_boxes, tracked
from benchmarks.boxes.true_boxes import TrueBoxes, true_boxes
from benchmarks.inputs.conflict_drives import FPS, conflict_drive, stored_boxes
from track_range.detection.boxes import iou
from track_range.detection.detections import Detections
from track_range.foundation.arrays import FloatArray, IntArray
from track_range.pipeline.frame_result import FrameResult
from track_range.simulation.render.renderer import kitti_like_rig
from track_range.simulation.world.scenarios import make_scenario
from track_range.simulation.world.scene import Scene

WIDTH_PX, HEIGHT_PX = 620, 188
"""Size of the images, px."""

MIN_IOU, MIN_IOU_SMALL, SMALL_PX = 0.3, 0.12, 10.0
"""Smallest IoU of a box with its object; that of objects lower than `SMALL_PX`."""

LANE_M = 1.5
"""Largest lateral offset from the ego path of an object in the lane, m."""

STEADY_PX = 1.0
"""Largest standard deviation of a false track's disparities about a straight line that counts as consistent, px."""

SCORES = (0.1, 0.2, 0.3, 0.5)
"""Lower limits of scores."""

GAP_FRAMES = 3
"""Longest gap, in frames, after which a track's change of object is one between neighbours."""


@dataclass(slots=True)
class TrackErrors:
    """Sums over drives; `+` joins them.

    Attributes:
        seconds: duration.
        false_boxes, second_boxes: number of boxes without an object, and of further boxes of an object, by `SCORES`.
        false_tracks: duration in s, fraction with a stereo distance, deviation of disparities in px, offset from the
            ego path in m, largest probability of contact, of each track without an object.
        n_tracks, n_mixed: number of tracks of objects; of those with several objects, three frames or more of each.
        n_neighbours, n_later: number of changes of a track's object, without a gap and after one.
        n_switches: number of changes of an object's track.
        n_rows, n_second: number of objects' boxes with a track; with another one at the same time.
        starts_m: distance of the first tracked box of each person and vehicle.
    """

    seconds: float = 0.0
    false_boxes: FloatArray = field(default_factory=lambda: np.zeros(len(SCORES)))
    second_boxes: FloatArray = field(default_factory=lambda: np.zeros(len(SCORES)))
    false_tracks: list[list[float]] = field(default_factory=list)
    n_tracks: int = 0
    n_mixed: int = 0
    n_neighbours: int = 0
    n_later: int = 0
    n_switches: int = 0
    n_rows: int = 0
    n_second: int = 0
    starts_m: dict[str, list[float]] = field(default_factory=lambda: {"person": [], "vehicle": []})

    def __add__(self, other: TrackErrors) -> TrackErrors:
        """The sums of both."""
        values = {name: getattr(self, name) + getattr(other, name) for name in self.__slots__ if name != "starts_m"}
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
                f"false boxes per frame, score > {s}": n / n_frames
                for s, n in zip(SCORES, self.false_boxes, strict=True)
            },
            **{
                f"second boxes per frame, score > {s}": n / n_frames
                for s, n in zip(SCORES, self.second_boxes, strict=True)
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
                f"first track of a {name}, median m": float(np.median(values)) if values else None
                for name, values in self.starts_m.items()
            },
        }


def rendered_errors(cache: Path, scenario: str, seed: int) -> TrackErrors:
    """Errors on a rendered drive with the packaged detector."""
    drive = conflict_drive(cache, scenario, seed, width_px=WIDTH_PX)
    boxes = stored_boxes(drive.boxes)
    scene = make_scenario(scenario, seed=seed, seconds=len(boxes) / FPS)
    true = true_boxes(scene, np.arange(len(boxes)) / FPS, kitti_like_rig(width_px=WIDTH_PX, height_px=HEIGHT_PX).left)
    with run_of(drive, is_stereo=True) as run:
        return _errors(scene, true, run, boxes)


def simulated_errors(scenario: str, seed: int, *, seconds: float, n_errors: int) -> TrackErrors:
    """Errors on drives without images in the same scene."""
    scene, times_s = make_scenario(scenario, seed=seed, seconds=seconds), np.arange(round(seconds * FPS)) / FPS
    rig = kitti_like_rig(width_px=WIDTH_PX, height_px=HEIGHT_PX)
    errors = TrackErrors()
    for number in range(n_errors):
        drive = BoxDrive(scene, times_s, rig, seed=1000 * seed + number)
        results = (step.result for step in run_boxes([drive], [tracked(drive)]))
        errors += _errors(scene, drive.true, results, [frame.detections for frame in drive])
    return errors


def _errors(scene: Scene, true: TrueBoxes, results: Iterable[FrameResult], boxes: Sequence[Detections]) -> TrackErrors:
    """Errors of one drive."""
    errors = TrackErrors(seconds=len(boxes) / FPS)
    is_person = np.array([user.kitti_type in ("Pedestrian", "Cyclist", "Motorcycle") for user in scene.road_users])
    by_track: dict[int, list[tuple[float, ...]]] = {}
    track_of: dict[int, int] = {}
    for result in results:
        rows = np.flatnonzero(true.frame == result.index)
        detections, tracks = boxes[result.index], result.tracks
        _count_boxes(errors, _users(true, rows, detections.xyxy_px)[0], detections.score)
        stereo_m, warnings = result.ranges["stereo"].distance_m, result.warnings
        nan = np.full(len(tracks), np.nan)
        probability, offset_m = (warnings.probability, warnings.path_offset_m) if warnings else (nan, nan)
        users, overlap = _users(true, rows, tracks.xyxy_px)
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


def _users(true: TrueBoxes, rows: IntArray, xyxy_px: FloatArray) -> tuple[IntArray, FloatArray]:
    """(K,) object of each box, -1 = none, and the IoU relative to the smallest one of a match."""
    if not len(rows) or not len(xyxy_px):
        return np.full(len(xyxy_px), -1), np.zeros(len(xyxy_px))
    limit = np.where(true.height_px[rows] < SMALL_PX, MIN_IOU_SMALL, MIN_IOU)
    overlap = iou(xyxy_px, true.xyxy_px[rows]) / limit
    return np.where(overlap.max(axis=1) >= 1, true.user[rows[overlap.argmax(axis=1)]], -1), overlap.max(axis=1)


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
                float(np.median(offset_m[np.isfinite(offset_m)])) if np.isfinite(offset_m).any() else np.inf,
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
    """Robust standard deviation of disparities about a straight line over time, px; infinite for less than 4."""
    if len(frame) < 4:
        return np.inf
    rig = kitti_like_rig(width_px=WIDTH_PX, height_px=HEIGHT_PX)
    disparity_px = rig.left.fx_px * rig.baseline_m / distance_m
    line = np.polyfit(frame, disparity_px, 1)
    return float(1.4826 * np.median(np.abs(disparity_px - np.polyval(line, frame))))
