"""Collision warnings on rendered drives with the packaged detector, and on real ones."""

from __future__ import annotations

import csv
from collections import Counter
from pathlib import Path
from typing import Any

import numpy as np

from benchmarks.boxes.true_boxes import TrueBoxes, true_boxes
from benchmarks.inputs.conflict_drives import COLLISIONS, FPS, ConflictDrive, conflict_drive
from track_range.detection.boxes import iou
from track_range.evaluation.events.contacts import read_contacts
from track_range.evaluation.events.scores import contact_scores, is_warning
from track_range.foundation.arrays import FloatArray
from track_range.results.events.event import Event
from track_range.run.option_types import RunKeywords
from track_range.run.run import Run
from track_range.simulation.world.scenarios import make_scenario
from track_range.stereo.rig_formats.reading import load_calibration

MIN_IOU = 0.3
"""Smallest overlap of a track with its object."""


def rendered_figures(cache: Path, scenario: str, seed: int, *, is_stereo: bool, width_px: int) -> dict[str, Any]:
    """Contacts with the lead of the first warning, false alarms, and errors of closing speeds of one drive."""
    drive = conflict_drive(cache, scenario, seed, width_px=width_px)
    scene = make_scenario(scenario, seed=seed, seconds=_seconds(drive))
    calibration, _ = load_calibration(drive.files.rig)
    true = true_boxes(scene, np.arange(round(_seconds(drive) * FPS)) / FPS, calibration.left)  # type: ignore[union-attr]
    user_of: dict[int, Counter[int]] = {}
    closing: list[tuple[float, ...]] = []
    speeds = _closing_speeds(drive.files.table)
    with run_of(drive, is_stereo=is_stereo) as run:
        for result in run:
            rows = np.flatnonzero(true.frame == result.index)
            users = _users(true, rows, result.tracks.xyxy_px)
            for row, user in enumerate(users):
                if user < 0 or not result.tracks.observed[row]:
                    continue
                user_of.setdefault(int(result.tracks.track_id[row]), Counter())[user] += 1
                truth = speeds.get((result.index, scene.road_users[user].track_id))
                if truth is not None and np.isfinite(result.closing_mps[row]):
                    class_id, height_m = int(result.tracks.class_id[row]), scene.road_users[user].size_hwl_m[0]
                    error = float(result.closing_mps[row]) - truth[1]
                    closing.append((class_id, truth[0], error, float(result.closing_sigma_mps[row]), height_m))
        events = run.events
    objects = [_object(event, user_of, scene) for event in events]
    scores = contact_scores(events, objects, read_contacts(drive.files.contacts), hours=_seconds(drive) / 3600)
    end_s = min((row["contact_s"] for row in scores["contacts"]), default=np.inf)
    return {
        "scenario": scenario,
        "seed": seed,
        "contacts": scores["contacts"],
        "false_warnings": [row for row in scores["false_warnings"] if row["warning_s"] <= end_s],
        "closing": np.array(closing, np.float64).reshape(-1, 5),
    }


def is_in_time(figures: dict[str, Any], lead_s: float) -> bool:
    """Whether the first warning of a drive's contact came at least `lead_s` before it."""
    return any(row["lead_s"] is not None and row["lead_s"] >= lead_s for row in figures["contacts"])


def is_collision(scenario: str) -> bool:
    """Whether a scenario has a contact."""
    return scenario in COLLISIONS


def real_warnings(**source: Any) -> list[Event]:
    """The warnings of a run with default options on a real recording."""
    left, *right = source.pop("videos")
    with Run.stereo(left, right[0], sgbm=False, **source) if right else Run.mono(left, **source) as run:
        for _ in run:
            pass
        return [event for event in run.events if is_warning(event)]


def run_of(drive: ConflictDrive, *, is_stereo: bool) -> Run:
    """A run on a rendered drive with its stored boxes."""
    files = drive.files
    options: RunKeywords = {
        "detector": drive.detector(),
        "ego_speed": files.ego_speed,
        "rig": files.rig,
        "sgbm": False,
    }
    return Run.stereo(files.left, files.right, **options) if is_stereo else Run.mono(files.left, **options)


def _seconds(drive: ConflictDrive) -> float:
    with np.load(drive.boxes) as stored:
        return float(stored["n_frames"]) / FPS


def _users(true: TrueBoxes, rows: Any, xyxy_px: FloatArray) -> list[int]:
    """The road user of each track box; -1 = none."""
    if not len(rows):
        return [-1] * len(xyxy_px)
    overlap = iou(xyxy_px, true.xyxy_px[rows])
    best = overlap.argmax(axis=1)
    users = true.user[rows[best]]
    is_same = overlap.max(axis=1, initial=0.0) >= MIN_IOU
    return [int(user) for user in np.where(is_same, users, -1)]


def _object(event: Event, user_of: dict[int, Counter[int]], scene: Any) -> int | None:
    """Id of the road user that the track of an event overlaps most often."""
    users = user_of.get(event.track_id)
    return None if not users else int(scene.road_users[users.most_common(1)[0][0]].track_id)


def _closing_speeds(path: Path) -> dict[tuple[int, int], tuple[float, float]]:
    """Distance and closing speed of truth.csv by frame and id."""
    with path.open(encoding="utf-8", newline="") as file:
        return {
            (int(row["frame"]), int(row["id"])): (float(row["distance_m"]), float(row["closing_mps"]))
            for row in csv.DictReader(file)
        }
