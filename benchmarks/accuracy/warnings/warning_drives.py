"""Collision warnings on rendered drives, on real ones, and on drives without images.

Drives without images have alarms, lead times, closing speeds and probabilities of contact, with the
errors of `benchmarks/boxes`.
"""

from __future__ import annotations

import csv
import math
from collections import Counter
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
from scipy.stats import chi2

from benchmarks.boxes.box_drive import BoxDrive
from benchmarks.boxes.box_run import IDS_PER_DRIVE, Step, run_boxes, tracked
from benchmarks.boxes.true_boxes import TrueBoxes, closing_rates_mps, true_boxes
from benchmarks.harness import Figures, median_or_none, quantile_or_none
from benchmarks.inputs.drives import COLLISIONS, FPS, ConflictDrive, StoredDetector, conflict_drive
from track_range.detection.boxes import iou
from track_range.detection.classes import ROAD_CLASSES
from track_range.evaluation.events.scores import contact_scores, is_warning, read_contacts
from track_range.foundation.arrays import FloatArray, IntArray
from track_range.pipeline.frame_result import FrameResult
from track_range.ranging.warning.collision_warning import CollisionWarning
from track_range.ranging.warning.settings import WarningSettings
from track_range.ranging.warning.warnings import Warnings
from track_range.results.events.event import Event
from track_range.run.option_types import RunKeywords
from track_range.run.run import Run
from track_range.simulation.render.renderer import kitti_like_rig
from track_range.simulation.world.contacts import find_contacts
from track_range.simulation.world.scenarios import make_scenario
from track_range.simulation.world.scene import Scene
from track_range.stereo.rig_formats.reading import load_calibration

MIN_IOU = 0.3  # smallest overlap of a track with its object

HARMLESS_S, COLLISION_S = 20.0, 8.0  # length of a drive, s
WIDTH_PX, HEIGHT_PX = 620, 188  # size of the images, px: that of the fit

METHODS = {"mono": ("mono",), "stereo": ("stereo",), "fused": ("mono", "stereo")}
"""Ranging methods of each configuration."""

HARMLESS_HOURS = (
    "yielding",
    "curve-parked",
    "oncoming",
    "overhead-sign",
    "following",
    "queue",
    "city",
    "highway",
)
"""Scenarios of harmless driving."""

THRESHOLDS = (0.1, 0.2, 0.3, 0.4, 0.5, 0.7, 0.9, 0.97)
"""Thresholds of the curve, of `WarningSettings.on_probability`; that of people is lower by the
default difference."""

N_ERRORS = 10  # drives with different errors in each scene
SAME_ALARM_S = 3.0  # longest time between two alarms on one object that count as one
CLOSING_FRAMES = 5  # from one measurement of the errors of closing speeds to the next

_BINS = np.concatenate([[0, 0.01, 0.03], np.linspace(0.1, 1, 10)])


def rendered_figures(
    cache: Path, scenario: str, seed: int, *, is_stereo: bool, width_px: int
) -> Figures:
    """Contacts with the lead of the first warning, false alarms, and errors of closing speeds of
    one drive.
    """
    drive = conflict_drive(cache, scenario, seed, width_px=width_px)
    scene = make_scenario(scenario, seed=seed, seconds=drive.seconds)
    calibration, _ = load_calibration(drive.files.rig)
    true = true_boxes(scene, np.arange(len(drive.boxes)) / FPS, calibration.left)  # type: ignore[union-attr]
    user_of: dict[int, Counter[int]] = {}
    closing: list[tuple[float, ...]] = []
    speeds = _closing_speeds(drive.files.table)
    with run_of(drive, is_stereo=is_stereo) as run:
        for result in run:
            rows = np.flatnonzero(true.frame == result.index)
            users, _ = matched_users(true, rows, result.tracks.xyxy_px, np.full(len(rows), MIN_IOU))
            for row, user in enumerate(users.tolist()):
                if user < 0 or not result.tracks.observed[row]:
                    continue
                user_of.setdefault(int(result.tracks.track_id[row]), Counter())[user] += 1
                truth = speeds.get((result.index, scene.road_users[user].track_id))
                if truth is not None and np.isfinite(result.closing_mps[row]):
                    class_id, height_m = (
                        int(result.tracks.class_id[row]),
                        scene.road_users[user].size_hwl_m[0],
                    )
                    error = float(result.closing_mps[row]) - truth[1]
                    closing.append(
                        (class_id, truth[0], error, float(result.closing_sigma_mps[row]), height_m)
                    )
        events = run.events
    objects = [_object(event, user_of, scene) for event in events]
    scores = contact_scores(
        events, objects, read_contacts(drive.files.contacts), hours=drive.seconds / 3600
    )
    end_s = min((row["contact_s"] for row in scores["contacts"]), default=np.inf)
    return {
        "scenario": scenario,
        "seed": seed,
        "contacts": scores["contacts"],
        "false_warnings": [row for row in scores["false_warnings"] if row["warning_s"] <= end_s],
        "closing": np.array(closing, np.float64).reshape(-1, 5),
    }


def real_warnings(**source: Any) -> list[Event]:
    """The warnings of a run with default options on a real recording."""
    left, *right = source.pop("videos")
    with (
        Run.stereo(left, right[0], sgbm=False, **source)
        if right
        else Run.mono(left, **source) as run
    ):
        for _ in run:
            pass
        return [event for event in run.events if is_warning(event)]


def run_of(drive: ConflictDrive, *, is_stereo: bool) -> Run:
    files, boxes = drive.files, StoredDetector(drive.boxes)
    options: RunKeywords = {
        "detector": boxes,
        "ego_speed": files.ego_speed,
        "rig": files.rig,
        "sgbm": False,
    }
    return (
        Run.stereo(files.left, files.right, **options)
        if is_stereo
        else Run.mono(files.left, **options)
    )


def matched_users(
    true: TrueBoxes, rows: IntArray, xyxy_px: FloatArray, min_iou: FloatArray
) -> tuple[IntArray, FloatArray]:
    """(K,) object of each box, -1 = none, and its IoU relative to the smallest one of a match with
    the rows (R,).
    """
    if not len(rows) or not len(xyxy_px):
        return np.full(len(xyxy_px), -1), np.zeros(len(xyxy_px))
    overlap = iou(xyxy_px, true.xyxy_px[rows]) / min_iou
    return np.where(
        overlap.max(axis=1) >= 1, true.user[rows[overlap.argmax(axis=1)]], -1
    ), overlap.max(axis=1)


def _object(event: Event, user_of: dict[int, Counter[int]], scene: Any) -> int | None:
    """Id of the road user that the track of an event overlaps most often."""
    users = user_of.get(event.track_id)
    return None if not users else int(scene.road_users[users.most_common(1)[0][0]].track_id)


def _closing_speeds(path: Path) -> dict[tuple[int, int], tuple[float, float]]:
    """Distance and closing speed of truth.csv by frame and id."""
    with path.open(encoding="utf-8", newline="") as file:
        return {
            (int(row["frame"]), int(row["id"])): (
                float(row["distance_m"]),
                float(row["closing_mps"]),
            )
            for row in csv.DictReader(file)
        }


@dataclass(frozen=True, slots=True)
class SceneDrives:
    """Drives with different errors in the scene of a scenario and seed, and the frames and tracks
    of each.
    """

    scenario: str
    seed: int
    scene: Scene
    drives: list[BoxDrive]
    tracks: list[list[Step]]
    contact_s: dict[int, float]  # time of the contact by id of the road user
    is_real: bool  # whether the contacts happen, without braking or with it
    end_s: float  # time of the first contact, or of the last frame; later frames do not count
    # (N + 1,) id of each road user; the last one, -1, is that of false boxes (row -1)
    object_id: IntArray
    closing_mps: FloatArray  # (N, T) true closing speeds

    @property
    def hours(self) -> float:
        return len(self.drives) * self.end_s / 3600


def scene_drives(scenario: str, seed: int, n_errors: int) -> SceneDrives:
    """The drives of a scenario and seed; the same arguments give the same drives."""
    seconds = COLLISION_S if scenario in COLLISIONS else HARMLESS_S
    scene = make_scenario(scenario, seed=seed, seconds=seconds)
    contacts = find_contacts(scene, seconds)
    contact_s = {contact.track_id: contact.contact_s for contact in contacts}
    is_real = all(contact.is_real for contact in contacts)
    times_s = np.arange(round(seconds * FPS)) / FPS
    rig = kitti_like_rig(width_px=WIDTH_PX, height_px=HEIGHT_PX)
    first = BoxDrive(scene, times_s, rig, seed=1000 * seed)
    others = [
        BoxDrive(scene, times_s, rig, seed=1000 * seed + number, like=first)
        for number in range(1, n_errors)
    ]
    drives = [first, *others]
    end_s = min(contact_s.values(), default=seconds) if is_real else seconds
    object_id = np.array([user.track_id for user in scene.road_users] + [-1])
    tracks, closing_mps = [tracked(drive) for drive in drives], closing_rates_mps(scene, times_s)
    return SceneDrives(
        scenario, seed, scene, drives, tracks, contact_s, is_real, end_s, object_id, closing_mps
    )


@dataclass(frozen=True, slots=True)
class SceneFigures:
    """Figures of the drives of one scene."""

    scenario: str  # scenario, seed: the scene
    seed: int
    hours: float  # duration of its drives
    # (A, 5) drive, threshold index, road user (-1 = a false box), time, lead to its contact (NaN =
    # none)
    alarms: FloatArray
    n_contacts: int  # number of contacts in all drives
    # (C, 5) class, distance, error of the closing speed, its standard deviation, height of the
    # object
    closing: FloatArray
    # (B, 3) by bin: number, sum of probabilities, number of contacts within the horizon
    probability: FloatArray

    @classmethod
    def of_json(cls, values: Mapping[str, Any]) -> SceneFigures:
        """The figures from JSON values."""
        arrays = {
            name: np.array(values[name], np.float64).reshape(-1, n_columns)
            for name, n_columns in (("alarms", 5), ("closing", 5), ("probability", 3))
        }
        return cls(**{**values, **arrays})


class WarningCurve(CollisionWarning):
    """Collision warnings with several thresholds, then, as returned, with the default settings:
    `warnings`.
    """

    def __init__(self, thresholds: Sequence[float]) -> None:
        super().__init__()
        default = WarningSettings()
        lower = default.on_probability - default.person_probability
        self._all = []
        for threshold in thresholds:
            person, off = max(threshold - lower, 0.05), min(default.off_probability, threshold / 2)
            settings = replace(
                default, on_probability=threshold, person_probability=person, off_probability=off
            )
            self._all.append(CollisionWarning(settings))
        self._all.append(CollisionWarning())
        self.warnings: list[Warnings] = []

    def update(self, *args: Any, **options: Any) -> Warnings:
        self.warnings = [warning.update(*args, **options) for warning in self._all]
        return self.warnings[-1]


def drive_figures(
    scene: SceneDrives, *, methods: str = "fused", thresholds: Sequence[float] = ()
) -> SceneFigures:
    """Figures of the drives of a scene with one set of ranging methods (a key of `METHODS`)."""
    curve = WarningCurve(thresholds)
    alarms: list[tuple[float, ...]] = []
    closing: list[FloatArray] = []
    probability = np.zeros((len(_BINS) - 1, 3))
    was_active: list[set[int]] = [set() for _ in range(len(thresholds) + 1)]
    for step in run_boxes(scene.drives, scene.tracks, methods=METHODS[methods], warning=curve):
        result = step.result
        if result.time_s > scene.end_s:
            break
        track_id, objects = result.tracks.track_id, scene.object_id[step.user]
        for number, warnings in enumerate(curve.warnings):
            now = set(track_id[warnings.active].tolist())
            for started in sorted(now - was_active[number]):
                row = int(np.flatnonzero(track_id == started)[0])
                lead_s = scene.contact_s.get(int(objects[row]), math.nan) - result.time_s
                alarms.append(
                    (started // IDS_PER_DRIVE, number, float(objects[row]), result.time_s, lead_s)
                )
            was_active[number] = now
        if result.index % CLOSING_FRAMES == 0:
            closing.append(_closing_errors(scene, result, step.user, step.true_m))
        if scene.is_real:
            _add_probabilities(
                probability, result.warnings, objects, scene.contact_s, result.time_s
            )
    merged, n_contacts = (
        _merged(np.array(alarms, np.float64).reshape(-1, 5)),
        len(scene.drives) * len(scene.contact_s),
    )
    errors = np.concatenate(closing)
    return SceneFigures(
        scene.scenario, scene.seed, scene.hours, merged, n_contacts, errors, probability
    )


def _closing_errors(
    scene: SceneDrives, result: FrameResult, user: IntArray, true_m: FloatArray
) -> FloatArray:
    """(C, 5) class, distance, error of the closing speed, its standard deviation, height, of road
    users at 5-45 m.
    """
    rows = np.flatnonzero(
        (user >= 0) & np.isfinite(result.closing_mps) & (true_m > 5) & (true_m < 45)
    )
    columns = np.stack(
        [
            result.tracks.class_id[rows],
            true_m[rows],
            result.closing_mps[rows] - scene.closing_mps[user[rows], result.index],
            result.closing_sigma_mps[rows],
            scene.scene.size_hwl_m()[user[rows], 0],
        ],
        axis=1,
    )
    return np.asarray(columns.round(3))


def _add_probabilities(
    counts: FloatArray,
    warnings: Warnings,
    objects: IntArray,
    contact_s: dict[int, float],
    time_s: float,
) -> None:
    horizon_s = WarningSettings().horizon_s
    rows = np.flatnonzero(np.isfinite(warnings.probability) & (objects >= 0))
    lead = np.array([contact_s.get(int(number), math.inf) - time_s for number in objects[rows]])
    p = warnings.probability[rows]
    index = np.clip(np.digitize(p, _BINS) - 1, 0, len(_BINS) - 2)
    n_bins = len(_BINS) - 1
    counts[:, 0] += np.bincount(index, minlength=n_bins)
    counts[:, 1] += np.bincount(index, p, minlength=n_bins)
    counts[:, 2] += np.bincount(index, lead <= horizon_s, minlength=n_bins)


def _merged(alarms: FloatArray) -> FloatArray:
    """The alarms without those that follow one on the same road user in the same drive within
    `SAME_ALARM_S`.
    """
    last_s: dict[tuple[float, ...], float] = {}
    rows = []
    for row in alarms[np.argsort(alarms[:, 3], kind="stable")]:
        key = tuple(row[:3])
        if row[2] < 0 or row[3] - last_s.get(key, -math.inf) > SAME_ALARM_S:
            rows.append(row)
        last_s[key] = row[3]
    return np.array(rows).reshape(-1, 5)


def alarm_figures(scenes: Sequence[SceneFigures], threshold: int = -1) -> Figures:
    """Hits, lead times and false alarms per hour at one threshold (index; -1 = default
    settings).
    """
    n_thresholds = int(max((scene.alarms[:, 1].max(initial=0) for scene in scenes), default=0))
    index = n_thresholds if threshold < 0 else threshold
    leads: list[float] = []
    leads_by_scenario: dict[str, list[float]] = {}
    n_false, hours = 0, 0.0
    by_scenario: dict[str, int] = {}
    for scene in scenes:
        part = scene.alarms[scene.alarms[:, 1] == index]
        is_false = np.isnan(part[:, 4])
        n_false += int(is_false.sum())
        by_scenario[scene.scenario] = by_scenario.get(scene.scenario, 0) + int(is_false.sum())
        hours += scene.hours
        first: dict[float, float] = {}
        for drive, lead in part[~is_false][:, [0, 4]].tolist():
            first[drive] = max(first.get(drive, -math.inf), lead)
        own = [*first.values(), *[0.0] * (scene.n_contacts - len(first))]
        leads += own
        if own:
            leads_by_scenario.setdefault(scene.scenario, []).extend(own)
    return {
        "hours": round(hours, 3),
        "false_alarms": n_false,
        "false_alarms_per_hour": round(n_false / hours, 2) if hours else None,
        "false_alarms_per_hour_95": poisson_bounds(n_false, hours) if hours else None,
        "false_alarms_by_scenario": by_scenario,
        "contacts": len(leads),
        "median_lead_s": median_or_none(leads),
        "lead_10_pct_s": quantile_or_none(leads, 0.1),
        "fraction_with_2_1_s": _in_time(leads),
        "by_scenario": {
            name: {
                "contacts": len(own),
                "median_lead_s": median_or_none(own),
                "fraction_with_2_1_s": _in_time(own),
            }
            for name, own in leads_by_scenario.items()
        },
    }


def _in_time(leads_s: Sequence[float]) -> float | None:
    return round(float(np.mean(np.array(leads_s) >= 2.1)), 3) if leads_s else None


def poisson_bounds(n: int, hours: float) -> list[float]:
    """The 95 % interval of the rate per hour of n events in the given time (Garwood, 1936)."""
    low = chi2.ppf(0.025, 2 * n) / 2 if n else 0.0
    high = chi2.ppf(0.975, 2 * n + 2) / 2
    return [round(float(low / hours), 2), round(float(high / hours), 2)]


def closing_figures(rows: FloatArray, nearest_m: float = 10.0, farthest_m: float = 40.0) -> Figures:
    """Median absolute error and bias of the closing speed by class; tall vehicles are trucks and
    buses over 2.5 m.
    """
    rows = rows[(rows[:, 1] >= nearest_m) & (rows[:, 1] <= farthest_m)]
    groups = {name: rows[rows[:, 0] == number] for number, name in enumerate(ROAD_CLASSES[:6])}
    groups["tall vehicles"] = rows[rows[:, 4] > 2.5]
    return {
        name: {
            "n": len(part),
            "median_abs_mps": round(float(np.median(np.abs(part[:, 2]))), 3),
            "bias_mps": round(float(np.median(part[:, 2])), 3),
            "within_1_sigma": round(float(np.mean(np.abs(part[:, 2]) < part[:, 3])), 3),
        }
        for name, part in groups.items()
        if len(part) >= 20
    }


def reliability(counts: FloatArray) -> Figures:
    """Reliability diagram: number of tracks and frames, mean probability and fraction of contacts
    by bin.

    `error` is the mean absolute difference over all tracks and frames; those below and above a
    probability of 0.1 follow separately, since nearly all are far below it.
    """
    counts = counts[counts[:, 0] >= 20]
    n, total, hits = counts.T
    predicted, observed = total / n, hits / n
    gap, is_high = np.abs(predicted - observed), predicted > 0.1
    return {
        "bins": [
            {"n": int(k), "predicted": round(float(p), 3), "observed": round(float(o), 3)}
            for k, p, o in zip(n, predicted, observed, strict=True)
        ],
        "error": _mean_gap(gap, n),
        "error_below_0.1": _mean_gap(gap[~is_high], n[~is_high]),
        "error_above_0.1": _mean_gap(gap[is_high], n[is_high]),
    }


def _mean_gap(gap: FloatArray, n: FloatArray) -> float | None:
    return round(float((gap * n).sum() / n.sum()), 4) if len(n) else None
