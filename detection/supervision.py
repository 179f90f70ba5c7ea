"""Conversion of boxes from and to supervision's `Detections` or objects with the same attributes.

supervision does not have to be installed. It uses the corner convention (the image's left edge is
0), while track-range has pixel centres at integers (the left edge is -0.5), so boxes are shifted by
half a pixel.
"""

import importlib.util
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any

import numpy as np
import numpy.typing as npt

from track_range.detection.boxes import HALF_PIXEL_PX
from track_range.detection.classes import COCO_CLASSES, ROAD_CLASSES, map_to_road_classes
from track_range.foundation.arrays import FloatArray, IntArray


@dataclass(frozen=True, slots=True)
class SupervisionBoxes:
    """Substitute for supervision's `Detections` with the same attributes, if supervision is not
    installed.
    """

    xyxy: npt.NDArray[np.float32]  # (N, 4) float32 boxes in pixels, corner convention
    confidence: npt.NDArray[np.float32]  # (N,) float32 in [0, 1]
    class_id: IntArray  # (N,) int, index into `ROAD_CLASSES`
    tracker_id: IntArray | None = None  # (N,) int, or None for detections without identities
    data: Mapping[str, Any] = field(default_factory=dict)  # `class_name`, (N,) str

    def __len__(self) -> int:
        return len(self.xyxy)


def read_supervision(
    boxes: Any, class_names: Sequence[str] | None = None
) -> tuple[FloatArray, FloatArray, IntArray, IntArray | None]:
    """The M boxes of road classes among `boxes`.

    `boxes` has `xyxy` (N, 4) and optionally `confidence`, `class_id`, `tracker_id` (N,) and `data`.
    The names of the class ids are `class_names`, else the names in `data["class_name"]`, else
    COCO's. ValueError for arrays of unequal length, or a class id without a name.

    The result is (M, 4) boxes with pixel centres at integers, (M,) confidence, 1 if the boxes have
    none, (M,) class id, and (M,) identities or None.
    """
    xyxy = np.asarray(boxes.xyxy, np.float64).reshape(-1, 4)
    n = len(xyxy)
    class_id = map_to_road_classes(_class_names(boxes, class_names, n))
    score = _column(boxes, "confidence", n)
    tracker_id = _column(boxes, "tracker_id", n)
    rows = np.flatnonzero(class_id >= 0)
    known = np.ones(len(rows)) if score is None else score[rows].astype(np.float64)
    numbers = None if tracker_id is None else tracker_id[rows].astype(np.int64)
    return xyxy[rows] - HALF_PIXEL_PX, known, class_id[rows], numbers


def supervision_boxes(
    xyxy_px: FloatArray, score: FloatArray, class_id: IntArray, tracker_id: IntArray | None = None
) -> Any:
    """The boxes (N, 4), pixel centres at integers, as supervision's `Detections` or, without it,
    `SupervisionBoxes`.
    """
    attributes: dict[str, Any] = {
        "xyxy": (xyxy_px + HALF_PIXEL_PX).astype(np.float32),
        "confidence": score.astype(np.float32),
        "class_id": class_id.astype(np.int64),
        "tracker_id": tracker_id,
        "data": {"class_name": np.array(ROAD_CLASSES)[class_id]},
    }
    if importlib.util.find_spec("supervision") is None:
        return SupervisionBoxes(**attributes)
    return importlib.import_module("supervision").Detections(**attributes)


def _class_names(boxes: Any, class_names: Sequence[str] | None, n: int) -> list[str]:
    named = (getattr(boxes, "data", None) or {}).get("class_name")
    if class_names is None and named is not None:
        if len(named) != n:
            raise ValueError(f"class_name: expected {n} names, got {len(named)}")
        return [str(name) for name in named]
    class_id = _column(boxes, "class_id", n)
    if class_id is None:
        raise ValueError("class_id: expected a class for each box, got None")
    names = COCO_CLASSES if class_names is None else class_names
    unknown = [int(i) for i in class_id if not 0 <= i < len(names)]
    if unknown:
        raise ValueError(
            f"class_id: expected 0 to {len(names) - 1}, got {unknown[0]}; specify class_names"
        )
    return [names[int(i)] for i in class_id]


def _column(boxes: Any, name: str, n: int) -> npt.NDArray[Any] | None:
    """(n,) values of an attribute; None if it is absent or None."""
    values = getattr(boxes, name, None)
    if values is None:
        return None
    column = np.asarray(values).reshape(-1)
    if len(column) != n:
        raise ValueError(f"{name}: expected {n} values, got {len(column)}")
    return column
