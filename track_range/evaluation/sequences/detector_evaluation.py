"""Comparison of average precision and speed of detectors on labelled images.

Every image is read once and processed by all detectors in turn, so that their times are measured
under the same conditions. Average precision uses all boxes of confidence 0.001 or more; precision
and recall are given at the working confidence, `--min-score`. Average precision and recall are also
evaluated by size of object, and the calibration of the scores is measured.
"""

import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np

from track_range.detection.classes import ROAD_CLASSES
from track_range.detection.detections import Detections
from track_range.detection.evaluation import MIN_BOXES, DetectionScores, evaluate_detections
from track_range.detection.evaluation.object_sizes import MIN_BIN_BOXES, SIZE_BINS, evaluate_by_size
from track_range.detection.evaluation.score_calibration import MIN_SCORE, evaluate_calibration
from track_range.detection.formats.image_labels.image_truth import ImageTruth
from track_range.detection.formats.tables.errors import LabelFileError
from track_range.detection.yolo.detector import YoloDetector, YoloSettings
from track_range.evaluation.sequences.labelled_images import LabelledFrames, LabelledSource
from track_range.foundation.arrays import FloatArray, Image
from track_range.foundation.files.input_files import counted
from track_range.foundation.progress import FrameProgress, no_frame_progress
from track_range.run.options.opened import DetectorOptions, open_detector, thresholds

LOWEST_SCORE = 0.001  # lowest confidence of the boxes for average precision, as usual for COCO
WORKING_SCORE = 0.25  # default confidence for precision and recall
PROTOCOL = (  # description of the measurement for the results
    "COCO AP (101 points, at most 100 boxes per image and class) of boxes with a score of at least "
    "0.001 after the detector's non-maximum suppression; precision and recall at IoU 0.5 and the "
    "confidence threshold; by size: labels and unmatched boxes outside a bin are ignored, sizes in "
    "pixels of the image, COCO's bins of area; calibration: boxes with a score of at least 0.05, "
    "matched at IoU 0.5, in 10 bins of the score; median ms per image, with all detectors run in "
    "turn on each image"
)
_DETAIL_NOTES = (  # explanations of the tables by size and of calibration
    f"By size: means over the classes with at least {MIN_BOXES} boxes, {MIN_BIN_BOXES} of them in "
    "the bin.",
    f"Calibration of scores of {MIN_SCORE} or more: ECE is the mean difference between score and "
    "precision in bins of the score, chance is the ECE to be expected for the same number of "
    "calibrated scores.",
)


@dataclass(slots=True)
class Candidate:
    """One evaluated detector, with its name in the tables and its results."""

    name: str
    detector: YoloDetector
    detections: list[Detections] = field(default_factory=list)  # of each image
    # pre-processing, inference, post-
    times_ms: list[tuple[float, float, float]] = field(default_factory=list)

    def detect(self, image: Image) -> None:
        """Detect in an image; store boxes and times."""
        began_s = time.perf_counter()
        self.detector.fill(image)
        filled_s = time.perf_counter()
        outputs = self.detector.infer()
        inferred_s = time.perf_counter()
        self.detections.append(self.detector.decode(outputs))
        done_s = time.perf_counter()
        self.times_ms.append(
            (1e3 * (filled_s - began_s), 1e3 * (inferred_s - filled_s), 1e3 * (done_s - inferred_s))
        )

    def speed(self) -> dict[str, float]:
        """Median ms per stage, and images per second; without the first image, for which buffers
        are allocated.
        """
        pre, inference, post = np.median(self.times_ms[1:] or self.times_ms, axis=0).tolist()
        total = pre + inference + post
        return {
            "pre_ms": pre,
            "inference_ms": inference,
            "post_ms": post,
            "total_ms": total,
            "fps": 1e3 / total,
        }


def evaluate(
    candidates: Sequence[Candidate],
    frames: LabelledFrames,
    *,
    min_score: str | None,
    progress: FrameProgress = no_frame_progress,
    min_height_px: float = 0.0,
    is_detailed: bool = False,
) -> dict[str, Any]:
    """Run all detectors on the labelled images; returns their results as plain values for JSON.

    After an interrupt (Ctrl-C), the results cover the finished images. `min_score` is a confidence
    threshold as in `--min-score`, None = `WORKING_SCORE`; objects below `min_height_px` are
    ignored; `is_detailed` adds the evaluation by size of object and the calibration of the scores.
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
        raise LabelFileError(
            f"no labelled image can be read; the first: {' '.join(frames.unreadable[:1])}"
        )
    least, by_class = thresholds(min_score, otherwise=WORKING_SCORE)
    working_score = YoloSettings(min_score=least, class_min_score=by_class).min_score_by_class()
    scores = {
        candidate.name: evaluate_detections(
            candidate.detections[: len(truth)],
            truth,
            working_score=working_score,
            known_class_id=candidate.detector.known_class_id,
            min_height_px=min_height_px,
        )
        for candidate in candidates
    }
    models = {candidate.name: _figures(candidate, scores) for candidate in candidates}
    if is_detailed:
        for candidate in candidates:
            models[candidate.name] |= _details(
                candidate, truth, working_score, min_height_px=min_height_px
            )
    return {
        "n_images": len(truth),
        "is_complete": is_complete,
        "min_height_px": min_height_px,
        "working_score": dict(zip(ROAD_CLASSES, working_score.tolist(), strict=True)),
        "protocol": PROTOCOL,
        "models": models,
        "notes": [
            *_notes(candidates, scores, frames.unreadable),
            *(_DETAIL_NOTES if is_detailed else ()),
            *(
                []
                if is_complete
                else [f"The evaluation was stopped early, after {counted(len(truth), 'image')}."]
            ),
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
    """Detailed `evaluate` on the images of `source`; the results also name images, labels, format
    and split.

    Raises LabelFileError, ImageFileError, VideoError, UsageError: images or labels cannot be used.
    """
    frames = source.open()
    figures = evaluate(
        candidates,
        frames,
        min_score=min_score,
        progress=progress,
        min_height_px=min_height_px,
        is_detailed=True,
    )
    split = source.split if source.manifest else None
    inputs = {
        "images": str(source.images),
        "labels": str(source.labels),
        "format": source.format,
        "split": split,
    }
    return {**inputs, **figures}


def _figures(candidate: Candidate, scores: dict[str, DetectionScores]) -> dict[str, Any]:
    """Results of one model: file, accuracy over its classes and over the classes averaged for all
    models, speed.
    """
    own = scores[candidate.name]
    shared = [
        i
        for i in own.by_class
        if all(i in row.by_class and row.by_class[i].is_averaged for row in scores.values())
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


def _details(
    candidate: Candidate,
    truth: Sequence[ImageTruth],
    working_score: FloatArray,
    *,
    min_height_px: float,
) -> dict[str, Any]:
    detections, known = candidate.detections[: len(truth)], candidate.detector.known_class_id
    by_size = {}
    for measure in SIZE_BINS:
        bins = evaluate_by_size(
            detections,
            truth,
            working_score=working_score,
            known_class_id=known,
            measure=measure,
            min_height_px=min_height_px,
        )
        by_size[measure] = [scores.as_dict() for scores in bins]
    calibration = evaluate_calibration(
        detections, truth, known_class_id=known, min_height_px=min_height_px
    )
    return {"by_size": by_size, "calibration": calibration.as_dict()}


def _input(detector: YoloDetector) -> str:
    """Width x height of the network's input, or its area or longer side if the size depends on the
    image.
    """
    height, width = detector.input_hw
    if None not in detector.session.input_shape[2:]:
        return f"{width}x{height}"
    return (
        f"{max(height, width)} open"
        if detector.area is None
        else f"{detector.area.value:.0f} px2 open"
    )


def open_candidates(
    models: Sequence[str], options: DetectorOptions, resolve: Callable[[str], Path]
) -> list[Candidate]:
    """Load the detectors to be evaluated; `resolve` gives the file of a model's name.

    Raises ModelError, DownloadError, ClassNameError, ConfigError: a model or an option cannot be
    used.
    """
    names = [Path(model).stem for model in models]
    unique = [
        name if names.count(name) == 1 else model for name, model in zip(names, models, strict=True)
    ]
    return [
        Candidate(name, open_detector(resolve(model), options, lowest_score=LOWEST_SCORE))
        for name, model in zip(unique, models, strict=True)
    ]


def _notes(
    candidates: Sequence[Candidate], scores: dict[str, DetectionScores], unreadable: Sequence[str]
) -> list[str]:
    notes = [note for candidate in candidates for note in candidate.detector.notes]
    few: dict[int, int] = {}
    for name, model_scores in scores.items():
        by_class = model_scores.by_class
        few |= {i: row.n_boxes for i, row in by_class.items() if 0 < row.n_boxes < MIN_BOXES}
        unknown = [
            ROAD_CLASSES[i] for i, row in by_class.items() if row.n_boxes and not row.is_known
        ]
        if unknown:
            notes.append(
                f"{name} does not detect {', '.join(unknown)}, excluded from its averages."
            )
    if few:
        classes = ", ".join(f"{ROAD_CLASSES[i]} ({n})" for i, n in few.items())
        notes.append(
            f"Classes with fewer than {MIN_BOXES} boxes are reported but excluded from "
            f"the mean: {classes}."
        )
    if unreadable:
        notes.append(f"Skipped {counted(len(unreadable), 'image')}; the first: {unreadable[0]}")
    return notes
