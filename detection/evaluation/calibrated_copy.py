"""Copies of detectors with calibrated scores (`detection.models.score_outputs`), and of the attributes beside them."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from track_range.detection.classes import ROAD_CLASSES, map_to_road_classes
from track_range.detection.evaluation.score_fit import BACKGROUND_SCORE, LOWEST_SCORE, ScoreFit
from track_range.detection.models.onnx_session import ModelError
from track_range.detection.models.score_outputs import write_calibrated
from track_range.detection.yolo.detector import YoloDetector
from track_range.foundation.files.output_files import OutputError, write_bytes


def score_outputs(detector: YoloDetector) -> tuple[int, ...]:
    """Indices of the network's outputs that are class scores; ModelError if scores are not separate outputs."""
    if detector.model.score_outputs:
        return detector.model.score_outputs
    raise ModelError(
        f"{detector.session.path}: expected a detector with separate outputs of the class scores, such as RoadNet, "
        f"found {detector.model.layout}; export it with separate outputs if its exporter can."
    )


def check_attributes(model: Path, out: Path) -> bytes | None:
    """The attributes beside the model, `MODEL.yaml`, or None; OutputError if the copy at `out` has others already."""
    source, target = model.with_suffix(".yaml"), out.with_suffix(".yaml")
    content = source.read_bytes() if source.is_file() else None
    if target.is_file() and target.read_bytes() != content:
        raise OutputError(
            f"{target}: expected no file or the attributes of {model.name}, found others; choose another --out."
        )
    return content


def write_calibrated_copy(detector: YoloDetector, fit: ScoreFit, out: Path, *, images: Path) -> None:
    """Write a copy of a detector with the scores of a fit to `images`, and its attributes; else ModelError."""
    known = detector.known_class_id
    background = fit.probability(np.full(len(known), BACKGROUND_SCORE), known)
    if background.max() > LOWEST_SCORE:
        name = ROAD_CLASSES[known[background.argmax()]]
        raise ModelError(
            f"{images}: expected scores that are clearly higher for detections that match a label, but with those of "
            f"{name}, background would get {background.max():.2f}; check the labels, or give more images."
        )
    model = detector.session.path
    content = check_attributes(model, out)
    road_class = map_to_road_classes(detector.model.names)
    slope, offset = (  # classes that are no road classes have the shared coefficients
        np.where(road_class < 0, shared, own[road_class])
        for shared, own in zip(fit.shared, (fit.slope, fit.offset), strict=True)
    )
    write_calibrated(model, out, score_outputs=score_outputs(detector), slope=slope, offset=offset)
    if content is not None:
        write_bytes(out.with_suffix(".yaml"), content)
