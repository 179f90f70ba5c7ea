"""Where the boxes of a run come from: a detector network, or a file of the user's own."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np

from detection.classes import road_class_ids
from detection.detection_files import read_detections
from detection.detections import Detections, FloatArray, IntArray
from detection.detector import Detector
from detection.onnx_session import ModelError
from detection.yolo import YoloDetector, YoloSettings
from stereo.frames import Frame
from track_range.config import ConfigError, RunSettings


@dataclass(frozen=True, slots=True)
class BoxSource:
    """The first stage of a run.

    Attributes:
        detect: boxes of a frame.
        frames: (M,) frame numbers that a file of boxes has boxes for; empty for a detector.
        found: what settings.yaml should say of it.
        notes: sentences for the user.
    """

    detect: Callable[[Frame], Detections]
    frames: IntArray
    found: dict[str, Any]
    notes: tuple[str, ...]


def open_box_source(settings: RunSettings, rectified_boxes: Callable[[FloatArray], FloatArray]) -> BoxSource:
    """The detector or the file that the settings name; boxes of a file are taken to the frames' rectified pixels.

    Raises:
        ModelError, LabelFileError: it cannot be used.
        ClassNameError: a class in the settings is unknown.
    """
    class_id = tuple(int(i) for i in road_class_ids(settings.classes))
    if settings.detections is not None:
        return _recorded(settings.detections, class_id, rectified_boxes)
    path = Path(settings.detector or "")
    if not path.is_file():
        raise ModelError(
            f"{path}: no such model file; --detector wants an ONNX file, such as YOLOv5's official export "
            "(no detector is packaged yet)."
        )
    network = YoloDetector(
        path,
        YoloSettings(class_id=class_id, size_px=settings.size_px),
        names=_names(settings.names),
        device=settings.device,
        n_threads=settings.threads,
    )
    detector: Detector = network
    found = {"file": path.name, "sha256": network.sha256(), "names": list(network.names), "device": network.device}
    nothing = np.zeros(0, np.int64)
    return BoxSource(lambda frame: detector.detect(frame.left), nothing, {"detector": found}, network.notes)


def _recorded(path: Path, class_id: tuple[int, ...], rectified_boxes: Callable[[FloatArray], FloatArray]) -> BoxSource:
    # MOTChallenge files name no class: a single --classes names it, else they are people, as MOTChallenge's are
    recorded = read_detections(path, unnamed_class_id=class_id[0] if len(class_id) == 1 else 0)
    if not recorded.is_rectified:
        boxes = recorded.detections
        recorded = replace(recorded, detections=replace(boxes, xyxy_px=rectified_boxes(boxes.xyxy_px)))

    def detect(frame: Frame) -> Detections:
        found = recorded.at(frame.index)
        return found.select(np.isin(found.class_id, class_id)) if class_id else found

    return BoxSource(detect, np.unique(recorded.frame), {"detections": path.name}, recorded.notes)


def _names(option: str | None) -> tuple[str, ...]:
    """Class names from `a,b,c` or from a file with one per line."""
    if option is None:
        return ()
    path = Path(option)
    if "," in option or not path.suffix:
        return tuple(name.strip() for name in option.split(","))
    try:
        return tuple(line.strip() for line in path.read_text(encoding="utf-8").splitlines() if line.strip())
    except (OSError, UnicodeDecodeError) as error:
        raise ConfigError(f"--names {option}: no readable text file with one name per line.") from error
