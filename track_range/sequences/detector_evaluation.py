"""Average precision and speed of detectors on labelled images, side by side.

Every image is read once and goes through all detectors in turn, so that their times are of the same moments. Detectors
report every box of confidence 0.001 or more, as average precision needs; precision and recall are given at the working
confidence, the one of `--min-score`.
"""

from __future__ import annotations

import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np

from track_range.detection.classes import ROAD_CLASSES
from track_range.detection.detections import Detections
from track_range.detection.evaluation import MIN_BOXES, DetectionScores, evaluate_detections
from track_range.detection.formats.image_truth import ImageTruth
from track_range.detection.formats.kitti import LabelFileError
from track_range.detection.yolo.detector import YoloDetector, YoloSettings
from track_range.foundation.arrays import FloatArray, Image
from track_range.foundation.progress import FrameProgress, no_frame_progress
from track_range.run.detector_options import DetectorOptions, open_detector, thresholds
from track_range.sequences.labelled_images import LabelledFrames, LabelledSource

LOWEST_SCORE = 0.001
WORKING_SCORE = 0.25

PROTOCOL = (
    "AP as COCO's (101 points, at most 100 boxes per image and class), boxes of score 0.001 and more after the "
    "detector's own suppression; precision and recall at IoU 0.5 and the working score; ms per image, medians, "
    "all detectors in turn on each image"
)


@dataclass(slots=True)
class Candidate:
    """One detector under test, with all that it found and its (images, 3) times."""

    name: str
    detector: YoloDetector
    detections: list[Detections] = field(default_factory=list)
    times_ms: list[tuple[float, float, float]] = field(default_factory=list)

    def detect(self, image: Image) -> None:
        """Detect, keeping boxes and times."""
        began_s = time.perf_counter()
        self.detector.fill(image)
        filled_s = time.perf_counter()
        outputs = self.detector.infer()
        inferred_s = time.perf_counter()
        self.detections.append(self.detector.decode(outputs))
        done_s = time.perf_counter()
        self.times_ms.append((1e3 * (filled_s - began_s), 1e3 * (inferred_s - filled_s), 1e3 * (done_s - inferred_s)))

    def speed(self) -> dict[str, float]:
        """Median ms per stage, and images per second; the first image, on which buffers are made, is left out."""
        pre, inference, post = np.median(self.times_ms[1:] or self.times_ms, axis=0).tolist()
        total = pre + inference + post
        return {"pre_ms": pre, "inference_ms": inference, "post_ms": post, "total_ms": total, "fps": 1e3 / total}


def evaluate(
    candidates: Sequence[Candidate],
    frames: LabelledFrames,
    *,
    min_score: str | None,
    progress: FrameProgress = no_frame_progress,
    min_height_px: float = 0.0,
) -> dict[str, Any]:
    """Run every candidate over the labelled images; the figures of all, as `--json` keeps them.

    After an interrupt (Ctrl-C) the figures are of the images that are done.

    Raises:
        LabelFileError, VideoError: no image can be read.
    """
    truth: list[ImageTruth] = []
    is_complete = True
    try:
        with progress(frames.n_images) as advance:
            for image, labels in frames:
                for candidate in candidates:
                    candidate.detect(image)
                truth.append(labels)
                advance()
    except KeyboardInterrupt:
        if not truth:
            raise
        is_complete = False
    if not truth:
        raise LabelFileError(f"none of the labelled images can be read: {' '.join(frames.unreadable[:1])}")
    working_score = _working_score(min_score)
    scores = {
        each.name: evaluate_detections(
            each.detections[: len(truth)],
            truth,
            working_score=working_score,
            known_class_id=each.detector.known_class_id,
            min_height_px=min_height_px,
        )
        for each in candidates
    }
    return {
        "n_images": len(truth),
        "is_complete": is_complete,
        "min_height_px": min_height_px,
        "working_score": {name: float(working_score[i]) for i, name in enumerate(ROAD_CLASSES)},
        "protocol": PROTOCOL,
        "models": {each.name: _figures(each, scores) for each in candidates},
        "notes": [
            *_notes(candidates, scores, frames.unreadable),
            *([] if is_complete else [f"Stopped early, after {len(truth)} images."]),
        ],
    }


def evaluate_source(
    candidates: Sequence[Candidate],
    source: LabelledSource,
    *,
    min_score: str | None,
    progress: FrameProgress = no_frame_progress,
    min_height_px: float = 0.0,
) -> dict[str, Any]:
    """As `evaluate`, with where images and labels came from.

    Raises:
        LabelFileError, ImageFileError, VideoError, UsageError: images or labels cannot be used.
    """
    about = {
        "images": str(source.images),
        "labels": str(source.labels),
        "format": source.format,
        "split": source.split if source.manifest else None,
    }
    frames = source.open()
    figures = evaluate(candidates, frames, min_score=min_score, progress=progress, min_height_px=min_height_px)
    return {**about, **figures}


def _figures(candidate: Candidate, scores: dict[str, DetectionScores]) -> dict[str, Any]:
    """One model's entry: what it is, accuracy over its own classes and those that all candidates average, speed."""
    own = scores[candidate.name]
    shared = [
        i for i in own.by_class if all(i in each.by_class and each.by_class[i].is_averaged for each in scores.values())
    ]
    session = candidate.detector.session
    common = {key: own.mean(key, shared) if shared else None for key in ("ap50", "ap50_95")}
    return {
        "file": str(session.path),
        "sha256": session.sha256(),
        "size_mb": session.path.stat().st_size / 1e6,
        "family": candidate.detector.model.family,
        "input": _input(candidate.detector),
        "device": session.device,
        **own.as_dict(),
        "common": {**common, "classes": [ROAD_CLASSES[i] for i in shared]},
        "speed": candidate.speed(),
    }


def _input(detector: YoloDetector) -> str:
    """Width and height of the network's input; the longer side where each image has its own."""
    height, width = detector.input_hw
    is_open = None in detector.session.input_shape[2:]
    return f"{max(height, width)} open" if is_open else f"{width}x{height}"


def open_candidates(models: Sequence[str], options: DetectorOptions, resolve: Callable[[str], Path]) -> list[Candidate]:
    """The detectors under test, all loaded before the first image; `resolve` gives the file of a name.

    Raises:
        ModelError, DownloadError, ClassNameError, ConfigError: one of them cannot be used.
    """
    names = [Path(model).stem for model in models]
    unique = [name if names.count(name) == 1 else model for name, model in zip(names, models, strict=True)]
    return [
        Candidate(name, open_detector(resolve(model), options, lowest_score=LOWEST_SCORE))
        for name, model in zip(unique, models, strict=True)
    ]


def _working_score(option: str | None) -> FloatArray:
    least, by_class = thresholds(option, otherwise=WORKING_SCORE)
    return YoloSettings(min_score=least, class_min_score=by_class).min_score_by_class()


def _notes(candidates: Sequence[Candidate], scores: dict[str, DetectionScores], unreadable: Sequence[str]) -> list[str]:
    notes = [note for each in candidates for note in each.detector.notes]
    for name, each in scores.items():
        unknown = [ROAD_CLASSES[i] for i, told in each.by_class.items() if told.n_boxes and not told.is_known]
        if unknown:
            notes.append(f"{name} has no class for: {', '.join(unknown)}; not averaged for it.")
    few = {
        i: told.n_boxes for each in scores.values() for i, told in each.by_class.items() if 0 < told.n_boxes < MIN_BOXES
    }
    if few:
        listed = ", ".join(f"{ROAD_CLASSES[i]} ({n})" for i, n in few.items())
        notes.append(f"Under {MIN_BOXES} boxes, reported but not averaged: {listed}.")
    if unreadable:
        notes.append(f"{len(unreadable)} images left out, the first: {unreadable[0]}")
    return notes
