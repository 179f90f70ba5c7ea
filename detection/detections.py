"""Detections: the boxes of one image as parallel arrays, without identities.

Frame of all boxes: pixels of the image that was handed in, x right, y down, pixel centres at whole numbers
(OpenCV's convention), so a box that covers the pixel columns 3..5 wholly runs from x1 = 2.5 to x2 = 5.5.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
import numpy.typing as npt

from track_range.detection.formats.supervision import read_supervision, supervision_boxes
from track_range.foundation.arrays import BoolArray, FloatArray, IntArray, check_shape

Descriptors = npt.NDArray[np.float32]


@dataclass(frozen=True, slots=True)
class Detections:
    """What a detector saw in one image; N = 0 means that it saw nothing.

    Example:
        >>> import track_range as tr
        >>> boxes = tr.Detections.of([[100, 50, 180, 110], [10, 60, 30, 110]], [0.9, 0.4], [2, 0])
        >>> boxes.select(boxes.score > 0.5).xyxy_px.tolist()
        [[100.0, 50.0, 180.0, 110.0]]

    Attributes:
        xyxy_px: (N, 4) float64, left, top, right, bottom edge.
        score: (N,) float64 in [0, 1].
        class_id: (N,) int64, index into `detection.classes.ROAD_CLASSES`.
        descriptor: (N, D) float32 appearance vectors; D = 0 when there are none.
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
        """Detections without appearance, from anything that numpy can read as such arrays."""
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
        """Detections from supervision's `Detections`, or anything with its attributes `xyxy, confidence, class_id`.

        See `formats.supervision.read_supervision`: boxes of other classes than road users are left out.
        """
        found = read_supervision(boxes, class_names)
        return cls.of(found.xyxy_px, found.score, found.class_id)

    def to_supervision(self) -> Any:
        """Supervision's `Detections` where it is installed, else an object with the same attributes."""
        return supervision_boxes(self.xyxy_px, self.score, self.class_id)

    def select(self, keep: BoolArray | IntArray) -> Detections:
        """The rows that a mask or an index array names, in its order."""
        return Detections(self.xyxy_px[keep], self.score[keep], self.class_id[keep], self.descriptor[keep])
