"""Where the boxes of a run come from: a detector network, or a file of the user's own."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np

from track_range.detection.classes import road_class_ids
from track_range.detection.detections import Detections
from track_range.detection.detector import Detector, checked_detections
from track_range.detection.formats.detection_files import read_detections
from track_range.foundation.arrays import FloatArray, IntArray
from track_range.run.detector_options import DetectorOptions, open_detector
from track_range.run.settings import RunSettings
from track_range.stereo.geometry.frames import Frame


@dataclass(frozen=True, slots=True)
class BoxSource:
    """The first stage of a run.

    Attributes:
        detect: boxes of a frame.
        frames: (M,) frame numbers that a file of boxes has boxes for; empty for a detector.
        found: what settings.yaml should say of it.
        notes: sentences for the user, on what it is and, later, on what it did.
    """

    detect: Callable[[Frame], Detections]
    frames: IntArray
    found: dict[str, Any]
    notes: Callable[[], tuple[str, ...]]


def open_box_source(
    settings: RunSettings,
    rectified_boxes: Callable[[FloatArray], FloatArray],
    ready_model: Callable[[str], Path],
) -> BoxSource:
    """The detector or the file that the settings name; boxes of a file are taken to the frames' rectified pixels.

    `ready_model` finds the file that the detector's word means.

    Raises:
        ModelError, DownloadError, LabelFileError: it cannot be used.
        ClassNameError: a class in the settings is unknown.
    """
    class_id = tuple(int(i) for i in road_class_ids(settings.classes))
    if settings.detections is not None:
        return _recorded(settings.detections, class_id, rectified_boxes)
    path = ready_model(settings.detector or "")
    network = open_detector(path, detector_options(settings))
    detector: Detector = network
    session = network.session
    found = {
        "file": path.name,
        "sha256": session.sha256(),
        "family": network.model.family,
        "names": list(network.model.names),
        "device": session.device,
    }
    nothing = np.zeros(0, np.int64)
    return BoxSource(
        detect=lambda frame: detector.detect(frame.left),
        frames=nothing,
        found={"detector": found},
        notes=lambda: network.notes,
    )


def boxes_of(detector: Detector) -> BoxSource:
    """Boxes of a detector of the user's own, an object with `detect(image)`.

    `BoxSource.detect` raises DetectorError where that returns no `Detections`.
    """
    return BoxSource(
        detect=lambda frame: checked_detections(detector, detector.detect(frame.left)),
        frames=np.zeros(0, np.int64),
        found={"detector": {"class": f"{type(detector).__module__}:{type(detector).__qualname__}"}},
        notes=lambda: tuple(getattr(detector, "notes", ())),
    )


def detector_options(settings: RunSettings) -> DetectorOptions:
    """What a run's settings say of its detector."""
    return DetectorOptions(
        names=settings.names,
        anchors=settings.anchors,
        letterbox=settings.letterbox,
        min_score=settings.min_score,
        size_px=settings.size_px,
        threads=settings.threads,
        device=settings.device,
        classes=settings.classes,
    )


def _recorded(path: Path, class_id: tuple[int, ...], rectified_boxes: Callable[[FloatArray], FloatArray]) -> BoxSource:
    # MOTChallenge files name no class: a single --classes names it, else they are people, as MOTChallenge's are
    recorded = read_detections(path, unnamed_class_id=class_id[0] if len(class_id) == 1 else 0)
    if not recorded.is_rectified:
        boxes = recorded.detections
        recorded = replace(recorded, detections=replace(boxes, xyxy_px=rectified_boxes(boxes.xyxy_px)))

    def detect(frame: Frame) -> Detections:
        found = recorded.at(frame.index)
        return found.select(np.isin(found.class_id, class_id)) if class_id else found

    return BoxSource(detect, np.unique(recorded.frame), {"detections": path.name}, lambda: recorded.notes)
