"""Networks that people own, each with what is right: the classes of its boxes, or the sentence that
names the choice."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import numpy as np
import pytest

from track_range.detection.classes import CLASS_LISTS, ROAD_CLASSES
from track_range.detection.models.onnx_session import ModelError
from track_range.detection.yolo.detector import YoloDetector
from track_range.detection.yolo.metadata import ModelOptions

FOUR = {"car": 0.9, "truck": 0.85, "person": 0.8, "motorcycle": 0.7}


@dataclass(frozen=True, kw_only=True)
class Case:
    """A network, which finds the same boxes in every image, and their scores by class."""

    name: str
    file: str
    classes: dict[str, float]
    side_px: int = 320
    names: str = ""  # a list of names, or a file with names
    layout: str | None = None
    note: str = ""


CASES = (
    Case(
        name="det_effdet_labels_from_1",
        file="effdet.onnx",
        classes=FOUR,
        names="coco-ids",
    ),
    Case(
        name="det_names_plural",
        file="m.onnx",
        classes={"car": 0.9, "person": 0.9, "bus": 0.9},
    ),
    Case(name="det_tf2_eight_outputs", file="tf2.onnx", classes=FOUR),
    Case(name="det_tf2_eight_outputs", file="tf2.onnx", classes=FOUR, layout="tf-detections"),
    Case(name="det_tv_background_name", file="tv.onnx", classes=FOUR),
    Case(name="det_tv_background_name", file="tv.onnx", classes=FOUR, names="categories.txt"),
    Case(
        name="det_two_heads",
        file="dual.onnx",
        classes={"car": 0.9},
        side_px=96,
        note="output0, output1",
    ),
)


def names_of(case: Case, folder: Path) -> tuple[str, ...] | None:
    if not case.names:
        return None
    file = folder / case.names
    return CLASS_LISTS.get(case.names) or tuple(file.read_text().splitlines())


@pytest.mark.parametrize("case", CASES, ids=lambda case: f"{case.name}-{case.names or case.layout}")
def test_boxes_have_the_right_classes(shared_data: Path, case: Case) -> None:
    folder = shared_data / "cases" / case.name
    options = ModelOptions(names=names_of(case, folder), layout=case.layout)
    detector = YoloDetector(folder / case.file, options=options)
    image = np.zeros((case.side_px, case.side_px, 3), np.uint8)
    detections = detector.detect(image)
    found = zip(detections.class_id, detections.score, strict=True)
    assert {ROAD_CLASSES[i]: pytest.approx(score, abs=0.01) for i, score in found} == case.classes
    assert case.note in " ".join(detector.notes)


def test_rows_without_names_and_without_a_zero_are_a_question(shared_data: Path) -> None:
    path = shared_data / "cases" / "det_effdet_labels_from_1" / "effdet.onnx"
    with pytest.raises(ModelError, match="--names coco or --names coco-ids"):
        YoloDetector(path).detect(np.zeros((320, 320, 3), np.uint8))
