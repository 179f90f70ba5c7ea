"""What looks and the camera's motion are worth to the tracker, online: simulated drives, MOT17-05 and KITTI's pictures.

Protocol, drives: the simulated street for `--seconds` at 10 Hz, 1000 x 320 px, KITTI's focal length, before a camera
that pitches (bumps, 0.45 deg rms of 0.8-3.5 Hz) and yaws (to and fro, up to 9-15 deg/s;
`benchmarks.inputs.looks_drives`); seeds 1 to `--drives`, even ones at 10 m/s in traffic, odd ones at 3 m/s past 30
people who cross each other. Boxes are the playback detector's (true boxes with jitter, misses, false alarms); road
users are hidden for 0.5-2 s again and again: the detector does not see them, the picture stays. All classes are
tracked and scored, all drives as one; who is hidden, or largely outside, does not count, for or against. `kept`: of
what was hidden on purpose, how much has the same identity in its last match of the second before and in its first of
the second after.

Protocol, others: MOT17-05-FRCNN with the vectors stored with it, by MOTChallenge's rules, no pictures; kitti_stereo's
two drives of 16 frames, their labels played back with five seeds and hidden for 0.5-0.8 s, scored as the drives.
Times: this thread's own, OpenCV and the network on one thread, median over all frames; the looks of strong boxes only.
"""

from __future__ import annotations

import argparse
import time
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import asdict, dataclass, field
from pathlib import Path
from typing import Any

import cv2
import numpy as np
from rich import box
from rich.console import Console
from rich.table import Table

from benchmarks.inputs.drives import REAL_DATA
from benchmarks.inputs.looks_drives import FPS, LooksDrive, class_ids, real, simulated
from benchmarks.inputs.tracking_sets import sequences_of
from track_range.detection.boxes import iou
from track_range.detection.detections import Descriptors
from track_range.detection.models.onnx_session import Runtime
from track_range.foundation.arrays import FloatArray, Image, IntArray
from track_range.sequences.tracking import track_sequence
from track_range.simulation.camera.playback import HIDDEN
from track_range.tracking.appearance import ColourLayout
from track_range.tracking.camera_motion import CameraMotion
from track_range.tracking.deepsort import AppearanceSettings, DeepSortSettings, DeepSortTracker
from track_range.tracking.evaluation import TrackingCounts, evaluate_tracks
from track_range.tracking.reid import ReidModel
from track_range.tracking.tracked_boxes import IgnoreRegions, TrackedBoxes
from track_range.tracking.tracker import AppearanceModel
from track_range.tracking.tracks import Tracks

NO_LOOKS = AppearanceSettings(max_cosine_distance=0.0)
REAL_SEEDS = range(5)
_MIN_IOU = 0.5
_FIGURES = {"hota": "HOTA", "idf1": "IDF1", "assa": "AssA", "deta": "DetA", "idsw": "IDsw"}
_APART = 100_000
"""Between frames, and identities, of one drive and the next."""

Figures = dict[str, Any]


@dataclass(slots=True)
class Timed:
    """A descriptor whose time per call is kept."""

    inner: AppearanceModel
    max_cosine_distance: float
    notes: tuple[str, ...] = ()
    times_ms: list[float] = field(default_factory=list)

    def embed(self, image: Image, xyxy_px: FloatArray) -> Descriptors:
        """As the inner one."""
        began_s = time.thread_time()
        found = self.inner.embed(image, xyxy_px)
        self.times_ms.append(1e3 * (time.thread_time() - began_s))
        return found


@dataclass(slots=True)
class Row:
    """One way to track, and what came of it so far.

    Attributes:
        is_camera_motion_compensated: see `DeepSortSettings`.
        descriptor: None = no looks.
        parts: tracks of each drive, as they came.
    """

    is_camera_motion_compensated: bool = False
    descriptor: Timed | None = None
    parts: list[list[Tracks]] = field(default_factory=list)

    def track(self, drive: LooksDrive) -> None:
        """With a new tracker."""
        looks = NO_LOOKS if self.descriptor is None else AppearanceSettings()
        settings = DeepSortSettings(is_camera_motion_compensated=self.is_camera_motion_compensated, appearance=looks)
        tracker = DeepSortTracker(settings, appearance_model=self.descriptor)
        frames = enumerate(zip(drive.found, drive.images, strict=True))
        self.parts.append([tracker.update(found, k / FPS, image) for k, (found, image) in frames])


def add_options(parser: argparse.ArgumentParser) -> None:
    """Options of this workload."""
    parser.add_argument("--data", type=Path, default=REAL_DATA, help="folder with mot, kitti_stereo and models")
    parser.add_argument("--drives", type=int, default=6, help="simulated ones; 0 = none")
    parser.add_argument("--seconds", type=float, default=12.0, help="length of each")
    parser.add_argument("--steady", action="store_true", help="the camera neither pitches nor yaws")
    parser.add_argument("--reid", type=Path, metavar="FILE", help="default: models/osnet_x0_25_msmt17.onnx of --data")


def measure(options: argparse.Namespace) -> Figures:
    """Run everything that there is data for, print the tables, and return their figures."""
    cv2.setNumThreads(1)
    reid = options.reid or options.data / "models" / "osnet_x0_25_msmt17.onnx"
    told: Figures = {"protocol": __doc__}
    if options.drives:
        seeds = range(1, options.drives + 1)
        drives = (simulated(seed, seconds=options.seconds, is_shaken=not options.steady) for seed in seeds)
        told["drives"] = _measured(drives, _rows(reid))
        _tell("Simulated drives, online", told["drives"])
    if vectors := _stored_vectors(options.data):
        told["mot17"] = vectors
        _tell("MOT17-05-FRCNN, stored vectors, online", vectors)
    if folders := sorted((options.data / "kitti_stereo").glob("0*")):
        told["kitti_stereo"] = _measured((each for folder in folders for each in real(folder, REAL_SEEDS)), _rows(reid))
        _tell("kitti_stereo 0003 and 0005, 16 frames each, online", told["kitti_stereo"])
    return told


def _rows(reid: Path) -> dict[str, Row]:
    def built_in() -> Timed:
        return _timed(ColourLayout())

    rows = {
        "motion": Row(),
        "motion, camera": Row(True),
        "motion, built-in looks": Row(descriptor=built_in()),
        "motion, camera, built-in looks": Row(True, built_in()),
    }
    if reid.is_file():
        rows["motion, camera, OSNet"] = Row(True, _timed(ReidModel(reid, Runtime(device="cpu", n_threads=1))))
    return rows


def _timed(descriptor: AppearanceModel) -> Timed:
    return Timed(descriptor, descriptor.max_cosine_distance)


def _measured(drives: Iterable[LooksDrive], rows: Mapping[str, Row]) -> dict[str, Figures]:
    """Every row on every drive, one drive in memory at a time."""
    truths, camera_ms, n_boxes = [], [], 0
    for drive in drives:
        print(f"{drive.name}: {len(drive.images)} frames, {len(drive.occlusions)} occlusions", flush=True)
        truths.append((drive.truth, drive.occlusions))
        camera_ms += _camera_ms(drive)
        n_boxes += sum(len(found) for found in drive.found)
        for row in rows.values():
            row.track(drive)
    truth, ignored, occlusions = _joined_truth(truths)
    found: dict[str, Figures] = {}
    for name, row in rows.items():
        results, is_observed = _joined_results(row.parts)
        scores = asdict(evaluate_tracks(truth, results, ignore=ignored))
        kept = _kept(truth, results.select(is_observed), occlusions)
        found[name] = {key: scores[key] for key in _FIGURES} | {
            "kept_pct": 100 * float(np.mean(kept)),
            "n_kept": int(np.sum(kept)),
            "n_occlusions": len(kept),
            "looks_ms": float(np.median(row.descriptor.times_ms)) if row.descriptor else None,
            "camera_ms": float(np.median(camera_ms)) if row.is_camera_motion_compensated else None,
            "boxes_per_frame": n_boxes / len(camera_ms),
        }
    return found


def _camera_ms(drive: LooksDrive) -> list[float]:
    camera, times_ms = CameraMotion(), []
    for image, found in zip(drive.images, drive.found, strict=True):
        began_s = time.thread_time()
        camera.update(image, found.xyxy_px)
        times_ms.append(1e3 * (time.thread_time() - began_s))
    return times_ms


def _joined_truth(truths: Sequence[tuple[Any, IntArray]]) -> tuple[TrackedBoxes, IgnoreRegions, IntArray]:
    """All drives as one: who counts, where results do not count, and the occlusions."""
    apart = [_APART * i for i in range(len(truths))]
    labels = [each for each, _ in truths]
    frame, track_id = (
        np.concatenate([getattr(each, name) + offset for each, offset in zip(labels, apart, strict=True)])
        for name in ("frame", "track_id")
    )
    class_id, xyxy_px = (
        np.concatenate(parts) for parts in ([class_ids(e) for e in labels], [e.xyxy_px for e in labels])
    )
    counts = np.concatenate([each.occluded for each in labels]) < HIDDEN
    occlusions = np.concatenate([each + offset for (_, each), offset in zip(truths, apart, strict=True)])
    everyone = TrackedBoxes(frame, track_id, xyxy_px, class_id)
    return everyone.select(counts), IgnoreRegions(frame[~counts], xyxy_px[~counts]), occlusions


def _joined_results(parts: Sequence[Sequence[Tracks]]) -> tuple[TrackedBoxes, Any]:
    """All drives' tracks as one, and (N,) which boxes were detected."""
    placed = [(_APART * i, k, each) for i, frames in enumerate(parts) for k, each in enumerate(frames)]
    boxes = TrackedBoxes(
        np.concatenate([np.full(len(each), offset + k) for offset, k, each in placed]),
        np.concatenate([each.track_id + offset for offset, _, each in placed]),
        np.concatenate([each.xyxy_px for *_, each in placed]),
        np.concatenate([each.class_id for *_, each in placed]),
    )
    return boxes, np.concatenate([each.observed for *_, each in placed])


def _kept(truth: TrackedBoxes, results: TrackedBoxes, occlusions: IntArray) -> list[bool]:
    """Whether the identity after each occlusion is the one before it; who has none before or after lost it."""

    def first_match(track_id: int, frames: Iterable[int]) -> int | None:
        for frame in frames:
            wanted = truth.xyxy_px[(truth.frame == frame) & (truth.track_id == track_id)]
            rows = np.flatnonzero(results.frame == frame)
            if len(wanted) and len(rows):
                overlap = iou(wanted, results.xyxy_px[rows])[0]
                if overlap.max() >= _MIN_IOU:
                    return int(results.track_id[rows[overlap.argmax()]])
        return None

    second, kept = round(FPS), []
    for track_id, first, last in occlusions.tolist():
        before = first_match(track_id, range(first - 1, first - 1 - second, -1))
        kept.append(before is not None and before == first_match(track_id, range(last + 1, last + 1 + second)))
    return kept


def _stored_vectors(data: Path) -> dict[str, Figures]:
    """MOT17's rows; none where there are no vectors."""
    sequences = [each for each in sequences_of("mot17", data) if each.has_vectors]
    found: dict[str, Figures] = {}
    for name, looks in (("motion", NO_LOOKS), ("motion, stored vectors", AppearanceSettings())):
        counts = []
        for each in sequences:
            tracker = DeepSortTracker(DeepSortSettings(appearance=looks))
            done = track_sequence(each.found, tracker, n_frames=each.n_frames, fps=each.fps, is_online=True).frames
            frame = np.repeat(np.arange(len(done)), [len(tracks) for tracks in done])
            track_id = np.concatenate([tracks.track_id for tracks in done])
            counts.append(each.counts(frame, track_id, np.concatenate([tracks.xyxy_px for tracks in done])))
        if counts:
            scores = asdict(TrackingCounts.sum_of(counts).scores())
            found[name] = {key: scores[key] for key in _FIGURES}
    return found


_COLUMNS: Mapping[str, tuple[str, Callable[[Figures], str]]] = {
    "kept_pct": ("kept", lambda row: f"{row['kept_pct']:.1f} % ({row['n_kept']}/{row['n_occlusions']})"),
    "looks_ms": ("looks ms", lambda row: f"{row['looks_ms']:.2f}" if row["looks_ms"] is not None else "-"),
    "camera_ms": ("camera ms", lambda row: f"{row['camera_ms']:.2f}" if row["camera_ms"] is not None else "-"),
}


def _tell(title: str, rows: Mapping[str, Figures]) -> None:
    table = Table(title=title, box=box.SIMPLE_HEAD, padding=0, title_justify="left")
    more = {key: each for key, each in _COLUMNS.items() if key in next(iter(rows.values()))}
    for i, heading in enumerate(("tracker", *_FIGURES.values(), *(heading for heading, _ in more.values()))):
        table.add_column(heading, justify="right" if i else "left", no_wrap=True)
    for name, row in rows.items():
        figures = (f"{row[key]:.1f}" if isinstance(row[key], float) else str(row[key]) for key in _FIGURES)
        table.add_row(name, *figures, *(written(row) for _, written in more.values()))
    Console(width=120).print(table)
