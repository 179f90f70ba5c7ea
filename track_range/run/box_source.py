"""Source of the boxes of a run: a detector network, a detector object, or a file of recorded detections."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np

from track_range.detection.classes import ROAD_CLASSES, road_class_ids
from track_range.detection.detections import Detections
from track_range.detection.detector import Detector, checked_detections
from track_range.detection.formats.detection_files import read_detections
from track_range.detection.yolo.detector import YoloDetector
from track_range.foundation.arrays import FloatArray, IntArray
from track_range.run.options.detector_options import DetectorOptions, open_detector
from track_range.run.settings import RunSettings
from track_range.stereo.geometry.frames import Frame

CANDIDATE_SCORE = np.where(np.isin(ROAD_CLASSES, ("person", "bicycle")), 0.02, 0.1)
"""(8,) minimum confidence of the candidates for anonymization by road class: low for people, since the regions of false
detections are small, and the default of tracking for vehicles."""


@dataclass(frozen=True, slots=True)
class BoxSource:
    """Detection stage of a run.

    Attributes:
        detect: returns the boxes of a frame.
        candidates: returns all boxes of the frame last passed to `detect`, also with low scores and of classes that are
            not tracked, for anonymization.
        frames: (M,) frame numbers with recorded boxes; empty for a detector.
        description: properties for the section `found` of settings.yaml.
        notes: returns the messages for the user so far.
    """

    detect: Callable[[Frame], Detections]
    candidates: Callable[[Frame], Detections]
    frames: IntArray
    description: dict[str, Any]
    notes: Callable[[], tuple[str, ...]]


def open_box_source(
    settings: RunSettings,
    rectified_boxes: Callable[[FloatArray], FloatArray],
    ready_model: Callable[[str], Path],
    *,
    size_px: tuple[int, int] | None = None,
    opened: Callable[[Path, DetectorOptions], YoloDetector] = open_detector,
) -> BoxSource:
    """The detector or the recorded detections of the settings.

    Args:
        settings: of the run.
        rectified_boxes: converts (N, 4) boxes of the recorded images to rectified pixels.
        ready_model: returns the file of a model by name or path, downloading it first if necessary.
        size_px: (width, height) of the recorded images, which YOLO labels need; None = unknown.
        opened: returns the detector of a file and options.

    Raises:
        ModelError, DownloadError, LabelFileError: the detector or the file cannot be used.
        ClassNameError: a class in the settings is unknown.
    """
    class_id = tuple(int(i) for i in road_class_ids(settings.classes))
    if settings.detections is not None:
        return _recorded(settings.detections, class_id, rectified_boxes, size_px)
    path = ready_model(settings.detector or "")
    network = opened(path, DetectorOptions.of(settings))
    detector: Detector = network
    session = network.session
    description = {
        "file": path.name,
        "sha256": session.sha256(),
        "family": network.model.family,
        "names": list(network.model.names),
        "device": session.device,
    }
    return BoxSource(
        detect=lambda frame: detector.detect(frame.left),
        candidates=lambda frame: network.candidates(CANDIDATE_SCORE),
        frames=np.zeros(0, np.int64),
        description={"detector": description},
        notes=lambda: network.notes,
    )


def boxes_of(detector: Detector) -> BoxSource:
    """Source of the boxes of a detector object with `detect(image)`.

    Its `detect` raises DetectorError if the object does not return `Detections`.
    """
    last = Detections.empty()

    def detect(frame: Frame) -> Detections:
        nonlocal last
        last = checked_detections(detector, detector.detect(frame.left))
        return last

    return BoxSource(
        detect=detect,
        candidates=lambda frame: last,
        frames=np.zeros(0, np.int64),
        description={"detector": {"class": f"{type(detector).__module__}:{type(detector).__qualname__}"}},
        notes=lambda: tuple(getattr(detector, "notes", ())),
    )


def _recorded(
    path: Path,
    class_id: tuple[int, ...],
    rectified_boxes: Callable[[FloatArray], FloatArray],
    size_px: tuple[int, int] | None,
) -> BoxSource:
    # MOTChallenge files have no classes: a single one in --classes applies, else person, as in MOTChallenge
    recorded = read_detections(path, default_class_id=class_id[0] if len(class_id) == 1 else 0, size_px=size_px)
    if not recorded.is_rectified:
        boxes = recorded.detections
        xyxy_px = rectified_boxes(boxes.xyxy_px)
        shown = np.flatnonzero(np.isfinite(xyxy_px).all(axis=1))  # of wide lenses only a part of the field of view
        boxes = replace(boxes, xyxy_px=xyxy_px).select(shown)
        recorded = replace(recorded, frame=recorded.frame[shown], detections=boxes)

    def detect(frame: Frame) -> Detections:
        detections = recorded.at(frame.index)
        return detections.select(np.isin(detections.class_id, class_id)) if class_id else detections

    return BoxSource(
        detect=detect,
        candidates=lambda frame: recorded.at(frame.index),
        frames=np.unique(recorded.frame),
        description={"detections": path.name},
        notes=lambda: recorded.notes,
    )
