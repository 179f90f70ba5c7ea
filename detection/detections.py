"""Detections: the boxes of one image as parallel arrays, without identities.

Boxes are in pixels of the detector's input image, x right, y down, with pixel centres at integers (OpenCV's
convention): a box that covers the pixel columns 3 to 5 has x1 = 2.5 and x2 = 5.5.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
import numpy.typing as npt

from track_range.detection.formats.supervision import read_supervision, supervision_boxes
from track_range.foundation.arrays import FloatArray, IntArray, Rows, check_shape, row_numbers

Descriptors = npt.NDArray[np.float32]
"""(N, D) appearance embeddings."""


@dataclass(frozen=True, slots=True)
class Detections:
    """The N detections of one image; N = 0 if there are none.

    Example:
        >>> import track_range as tr
        >>> boxes = tr.Detections.of([[100, 50, 180, 110], [10, 60, 30, 110]], [0.9, 0.4], [2, 0])
        >>> boxes.select(boxes.score > 0.5).xyxy_px.tolist()
        [[100.0, 50.0, 180.0, 110.0]]

    Attributes:
        xyxy_px: (N, 4) float64, left, top, right, bottom edge.
        score: (N,) float64 confidence in [0, 1].
        class_id: (N,) int64, index into `detection.classes.ROAD_CLASSES`.
        descriptor: (N, D) float32 appearance embeddings; D = 0 if there are none.
    """

    xyxy_px: FloatArray
    score: FloatArray
    class_id: IntArray
    descriptor: Descriptors

    def __post_init__(self) -> None:
        n = len(self.score)
        check_shape("xyxy_px", self.xyxy_px, (n, 4))
        check_shape("score", self.score, (n,))
        check_shape("class_id", self.class_id, (n,))
        check_shape("descriptor", self.descriptor, (n, None))

    def __len__(self) -> int:
        return len(self.score)

    @classmethod
    def of(cls, xyxy_px: npt.ArrayLike, score: npt.ArrayLike, class_id: npt.ArrayLike) -> Detections:
        """Detections without embeddings, from boxes (N, 4), scores (N,) and class ids (N,) as arrays or lists."""
        boxes = np.asarray(xyxy_px, np.float64).reshape(-1, 4)
        return cls(
            boxes,
            np.asarray(score, np.float64).reshape(-1),
            np.asarray(class_id, np.int64).reshape(-1),
            np.zeros((len(boxes), 0), np.float32),
        )

    @classmethod
    def empty(cls) -> Detections:
        """No detections."""
        return cls.of([], [], [])

    @classmethod
    def from_supervision(cls, boxes: Any, class_names: Sequence[str] | None = None) -> Detections:
        """Detections from supervision's `Detections`, or any object with its attributes `xyxy, confidence, class_id`.

        Boxes of classes that are not road classes are left out; see `formats.supervision.read_supervision`.
        """
        road_boxes = read_supervision(boxes, class_names)
        return cls.of(road_boxes.xyxy_px, road_boxes.score, road_boxes.class_id)

    def to_supervision(self) -> Any:
        """The boxes as supervision's `Detections` if that is installed, else as an object with the same attributes."""
        return supervision_boxes(self.xyxy_px, self.score, self.class_id)

    def select(self, index: Rows) -> Detections:
        """The detections that a mask (N,), an array or list of indices or a slice selects, in the order of the indices.

        Raises:
            IndexError: the mask has another length, or an index does not exist.
        """
        rows = row_numbers(index, len(self.score))
        return Detections(
            self.xyxy_px.take(rows, axis=0),
            self.score.take(rows),
            self.class_id.take(rows),
            self.descriptor.take(rows, axis=0),
        )
