"""Effect of appearance and camera motion on online tracking of simulated drives."""

from __future__ import annotations

import time
from argparse import Namespace
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import asdict, dataclass, field
from pathlib import Path
from typing import Any

import cv2
import numpy as np

from benchmarks.harness import Figures, option, workload
from benchmarks.inputs.appearance_drives import FPS, AppearanceDrive, class_ids, simulated
from benchmarks.inputs.drives import REAL_DATA
from track_range.detection.boxes import iou
from track_range.detection.detections import Descriptors
from track_range.detection.models.onnx_session import Runtime
from track_range.foundation.arrays import FloatArray, Image, IntArray
from track_range.simulation.camera.playback import HIDDEN
from track_range.tracking.appearance.embeddings import ColourLayout
from track_range.tracking.appearance.reid import ReidModel
from track_range.tracking.camera_motion import CameraMotion
from track_range.tracking.deepsort import (
    ROAD,
    ROAD_COLOURS,
    AppearanceSettings,
    DeepSortSettings,
    DeepSortTracker,
)
from track_range.tracking.evaluation.scores import evaluate_tracks
from track_range.tracking.evaluation.tracked_boxes import IgnoreRegions, TrackedBoxes
from track_range.tracking.registry import AppearanceModel
from track_range.tracking.tracks import Tracks

NO_APPEARANCE = AppearanceSettings(max_cosine_distance=0.0)  # settings for tracking by motion only
_MIN_IOU = 0.5  # smallest IoU of a track with the true box for the `kept` figure
_METRICS = ("hota", "idf1", "assa", "deta", "idsw")
_DRIVE_OFFSET = 100_000  # difference of frame numbers and identities between one drive and the next


@dataclass(slots=True)
class TimedModel:
    """An appearance model that records the thread time of each of its calls."""

    inner: AppearanceModel
    max_cosine_distance: float
    notes: tuple[str, ...] = ()
    times_ms: list[float] = field(default_factory=list)

    def embed(self, image: Image, xyxy_px: FloatArray) -> Descriptors:
        start_s = time.thread_time()
        embeddings = self.inner.embed(image, xyxy_px)
        self.times_ms.append(1e3 * (time.thread_time() - start_s))
        return embeddings


@dataclass(slots=True)
class Row:
    """A tracker configuration and its tracks so far, of each drive frame by frame; without a model,
    motion only.
    """

    is_camera_motion_compensated: bool = False
    model: TimedModel | None = None
    gating_threshold: float = AppearanceSettings().gating_threshold
    parts: list[list[Tracks]] = field(default_factory=list)

    def track(self, drive: AppearanceDrive) -> None:
        settings = DeepSortSettings(
            is_camera_motion_compensated=self.is_camera_motion_compensated,
            appearance=NO_APPEARANCE
            if self.model is None
            else AppearanceSettings(gating_threshold=self.gating_threshold),
        )
        tracker = DeepSortTracker(settings, appearance_model=self.model)
        frames = enumerate(zip(drive.detected, drive.images, strict=True))
        self.parts.append(
            [tracker.update(detections, k / FPS, image) for k, (detections, image) in frames]
        )


@workload(
    option("--data", default=REAL_DATA, help="folder with models"),
    option("--drives", default=6, help="number of simulated drives"),
    option("--first-seed", default=1, help="seed of the first drive"),
    option("--seconds", default=12.0, help="length of a simulated drive"),
    option("--steady", default=False, help="simulated camera without pitch and yaw"),
    option(
        "--reid",
        type=Path,
        metavar="FILE",
        help="re-identification network (default: OSNet x0.25 in --data)",
    ),
)
def appearance(options: Namespace) -> Figures:
    cv2.setNumThreads(1)
    reid = options.reid or options.data / "models" / "osnet_x0_25_msmt17.onnx"
    seeds = range(options.first_seed, options.first_seed + options.drives)
    drives = (
        simulated(seed, seconds=options.seconds, is_shaken=not options.steady) for seed in seeds
    )
    return {"drives": _measured(drives, _rows(reid))}


def _rows(reid: Path) -> dict[str, Row]:
    def timed(model: AppearanceModel) -> TimedModel:
        return TimedModel(model, model.max_cosine_distance)

    rows = {
        "motion": Row(),
        "motion, camera": Row(True),
        "motion, built-in appearance": Row(model=timed(ColourLayout())),
        "motion, camera, built-in appearance": Row(True, timed(ColourLayout())),
        "the same as --tracker road has it": Row(
            True, timed(ColourLayout(ROAD_COLOURS)), ROAD.appearance.gating_threshold
        ),
    }
    if reid.is_file():
        rows["motion, camera, OSNet"] = Row(
            True, timed(ReidModel(reid, Runtime(device="cpu", n_threads=1)))
        )
    return rows


def _measured(drives: Iterable[AppearanceDrive], rows: Mapping[str, Row]) -> dict[str, Figures]:
    """Figures of all rows over all drives, with one drive in memory at a time."""
    truths, camera_ms, n_boxes = [], [], 0
    for drive in drives:
        print(
            f"{drive.name}: {len(drive.images)} frames, {len(drive.occlusions)} occlusions",
            flush=True,
        )
        truths.append((drive.truth, drive.occlusions))
        camera_ms += _camera_ms(drive)
        n_boxes += sum(len(detections) for detections in drive.detected)
        for row in rows.values():
            row.track(drive)
    truth, ignored, occlusions = _combined_truth(truths)
    figures: dict[str, Figures] = {}
    for name, row in rows.items():
        results, is_observed = _combined_results(row.parts)
        scores = asdict(evaluate_tracks(truth, results, ignore=ignored))
        is_kept = _is_kept(truth, results.select(is_observed), occlusions)
        figures[name] = {key: scores[key] for key in _METRICS} | {
            "kept_pct": 100 * float(np.mean(is_kept)),
            "n_kept": int(np.sum(is_kept)),
            "n_occlusions": len(is_kept),
            "appearance_ms": float(np.median(row.model.times_ms)) if row.model else None,
            "camera_ms": float(np.median(camera_ms)) if row.is_camera_motion_compensated else None,
            "boxes_per_frame": n_boxes / len(camera_ms),
        }
    return figures


def _camera_ms(drive: AppearanceDrive) -> list[float]:
    camera, times_ms = CameraMotion(), []
    for image, detections in zip(drive.images, drive.detected, strict=True):
        start_s = time.thread_time()
        camera.update(image, detections.xyxy_px)
        times_ms.append(1e3 * (time.thread_time() - start_s))
    return times_ms


def _combined_truth(
    truths: Sequence[tuple[Any, IntArray]],
) -> tuple[TrackedBoxes, IgnoreRegions, IntArray]:
    """Scored boxes, ignored regions and occlusions (N, 3) of all drives together."""
    offsets = [_DRIVE_OFFSET * i for i in range(len(truths))]
    labels = [drive_labels for drive_labels, _ in truths]
    frame, track_id = (
        np.concatenate(
            [getattr(part, name) + offset for part, offset in zip(labels, offsets, strict=True)]
        )
        for name in ("frame", "track_id")
    )
    class_id = np.concatenate([class_ids(part) for part in labels])
    xyxy_px = np.concatenate([part.xyxy_px for part in labels])
    is_scored = np.concatenate([part.occluded for part in labels]) < HIDDEN
    occlusions = np.concatenate(
        [part + offset for (_, part), offset in zip(truths, offsets, strict=True)]
    )
    boxes = TrackedBoxes(frame, track_id, xyxy_px, class_id)
    return (
        boxes.select(is_scored),
        IgnoreRegions(frame[~is_scored], xyxy_px[~is_scored]),
        occlusions,
    )


def _combined_results(parts: Sequence[Sequence[Tracks]]) -> tuple[TrackedBoxes, Any]:
    """Tracks of all drives together, and (N,) whether each box was detected."""
    items = [
        (_DRIVE_OFFSET * i, k, tracks)
        for i, frames in enumerate(parts)
        for k, tracks in enumerate(frames)
    ]
    boxes = TrackedBoxes(
        np.concatenate([np.full(len(tracks), offset + k) for offset, k, tracks in items]),
        np.concatenate([tracks.track_id + offset for offset, _, tracks in items]),
        np.concatenate([tracks.xyxy_px for *_, tracks in items]),
        np.concatenate([tracks.class_id for *_, tracks in items]),
    )
    return boxes, np.concatenate([tracks.observed for *_, tracks in items])


def _is_kept(truth: TrackedBoxes, results: TrackedBoxes, occlusions: IntArray) -> list[bool]:
    """Whether the identities before and after each occlusion are the same; False if there is
    none.
    """

    def first_match(track_id: int, frames: Iterable[int]) -> int | None:
        for frame in frames:
            true_px = truth.xyxy_px[(truth.frame == frame) & (truth.track_id == track_id)]
            rows = np.flatnonzero(results.frame == frame)
            if len(true_px) and len(rows):
                overlap = iou(true_px, results.xyxy_px[rows])[0]
                if overlap.max() >= _MIN_IOU:
                    return int(results.track_id[rows[overlap.argmax()]])
        return None

    second, is_kept = round(FPS), []
    for track_id, first, last in occlusions.tolist():
        before = first_match(track_id, range(first - 1, first - 1 - second, -1))
        is_kept.append(
            before is not None
            and before == first_match(track_id, range(last + 1, last + 1 + second))
        )
    return is_kept
