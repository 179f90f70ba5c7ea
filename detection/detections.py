"""Detections: the boxes of one image as parallel arrays, without identities.

Boxes are in pixels of the detector's input image, x right, y down, with pixel centres at integers
(OpenCV's convention): a box that covers the pixel columns 3 to 5 has x1 = 2.5 and x2 = 5.5.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any, Literal

import numpy as np
import numpy.typing as npt

from track_range.detection.classes import ROAD_CLASS_TABLE, ROAD_CLASSES, ROAD_OF_COCO, class_counts
from track_range.detection.supervision import read_supervision, supervision_boxes
from track_range.foundation.arrays import FloatArray, IntArray, Rows, check_shape, row_numbers

Descriptors = npt.NDArray[np.float32]  # (N, D) appearance embeddings

_CLASS_LIMITS, _SCORE_LIMITS = (
    (np.array(0), np.array(len(ROAD_CLASSES))),
    (np.array(0.0), np.array(1.0)),
)
"""Limits as arrays, since comparisons with numbers take twice the time."""


@dataclass(frozen=True, slots=True)
class Detections:
    """The N detections of one image; N = 0 if there are none.

    Example:
        >>> import track_range as tr
        >>> boxes = tr.Detections.of([[100, 50, 180, 110], [10, 60, 30, 110]], [0.9, 0.4], [2, 0])
        >>> boxes, boxes.select(boxes.score > 0.5).xyxy_px.tolist()
        (Detections(1 person, 1 car), [[100.0, 50.0, 180.0, 110.0]])

    `class_id`: (N,) int64, index into `ROAD_CLASSES`. COCO's ids differ: its id of a truck, 7, is a
    traffic sign here, which no check can detect. `from_coco` converts them.

    Raises ValueError: lengths differ, or a box, score or class id is not as described.
    """

    # (N, 4) float64, left, top, right, bottom edge; finite, left <= right and top <= bottom
    xyxy_px: FloatArray
    score: FloatArray  # (N,) float64 confidence in [0, 1]
    class_id: IntArray
    descriptor: Descriptors  # (N, D) float32 appearance embeddings; D = 0 if there are none
    # whether road users of all sizes were sought: in other frames, no small box is not a miss
    is_complete: bool = True

    def __post_init__(self) -> None:
        n = len(self.score)
        check_shape("xyxy_px", self.xyxy_px, (n, 4))
        check_shape("score", self.score, (n,))
        check_shape("class_id", self.class_id, (n,))
        check_shape("descriptor", self.descriptor, (n, None))
        if n:
            self._check_values()

    def _check_values(self) -> None:
        boxes, score, class_id = self.xyxy_px, self.score, self.class_id
        if class_id.dtype.kind not in "iu":
            raise ValueError(
                f"class_id: expected whole numbers, {ROAD_CLASS_TABLE}, got {class_id.dtype}"
            )
        is_valid = (
            class_id >= _CLASS_LIMITS[0],
            class_id < _CLASS_LIMITS[1],
            score >= _SCORE_LIMITS[0],
            score <= _SCORE_LIMITS[1],
            boxes[:, 0] <= boxes[:, 2],
            boxes[:, 1] <= boxes[:, 3],
        )
        # The search in bytes and the sum of squares take less than half the time of all() and
        # isfinite().
        if 0 not in b"".join(map(np.ndarray.tobytes, is_valid)) and np.vdot(boxes, boxes) < np.inf:
            return
        is_finite = np.isfinite(boxes).all(axis=1)
        for expected, values, rows in (
            (
                f"class_id: expected {ROAD_CLASS_TABLE} (COCO: Detections.from_coco)",
                class_id,
                is_valid[:2],
            ),
            ("score: expected a confidence from 0 to 1", score, is_valid[2:4]),
            (
                "xyxy_px: expected finite left <= right and top <= bottom",
                boxes,
                (*is_valid[4:], is_finite),
            ),
        ):
            if len(faults := np.flatnonzero(~np.all(rows, axis=0))):
                raise ValueError(f"{expected}, got {values[faults[0]].tolist()} in row {faults[0]}")

    def __len__(self) -> int:
        return len(self.score)

    def __repr__(self) -> str:
        return f"Detections({class_counts(self.class_id)})"

    @classmethod
    def of(
        cls, xyxy_px: npt.ArrayLike, score: npt.ArrayLike, class_id: npt.ArrayLike
    ) -> Detections:
        """Detections without embeddings, from boxes (N, 4), scores (N,) and class ids (N,) as
        arrays or lists.
        """
        boxes = np.asarray(xyxy_px, np.float64)
        if boxes.size and (not boxes.ndim or boxes.shape[-1] % 4):
            raise ValueError(
                f"xyxy_px: expected shape (N, 4), left, top, right, bottom edge, got {boxes.shape}"
            )
        boxes = boxes.reshape(-1, 4)
        return cls(
            boxes,
            np.asarray(score, np.float64).reshape(-1),
            _whole_numbers("class_id", class_id),
            np.zeros((len(boxes), 0), np.float32),
        )

    @classmethod
    def empty(cls) -> Detections:
        """No detections."""
        return cls.of([], [], [])

    @classmethod
    def from_coco(
        cls,
        xyxy_px: npt.ArrayLike,
        score: npt.ArrayLike,
        coco_class_id: npt.ArrayLike,
        *,
        n_ids: Literal[80, 91] = 80,
    ) -> Detections:
        """The detections of road classes from a network that was trained on COCO.

        Example:
            >>> import track_range as tr
            >>> tr.Detections.from_coco([[100, 50, 180, 110], [10, 60, 30, 110]], [0.9, 0.4], [7, 16])
            Detections(1 truck)

        Args:
            xyxy_px: (N, 4) boxes, see `Detections`.
            score: (N,) confidences.
            coco_class_id: (N,) COCO's class numbers: 0 person, 1 bicycle, 2 car, 3 motorcycle, 5
                bus, 7 truck, 9 traffic light, 11 stop sign; boxes of other classes are left out.
            n_ids: 91 = category ids as in COCO's annotations, which torchvision's and DETR's
                networks use: 1 person.

        Raises ValueError: a class number does not exist, or see `Detections`.
        """
        if n_ids not in ROAD_OF_COCO:
            raise ValueError(f"n_ids: expected {' or '.join(map(str, ROAD_OF_COCO))}, got {n_ids}")
        numbers, road = _whole_numbers("coco_class_id", coco_class_id), ROAD_OF_COCO[n_ids]
        if len(unknown := numbers[(numbers < 0) | (numbers >= n_ids)]):
            raise ValueError(
                f"coco_class_id: expected COCO's numbers from 0 to {n_ids - 1}, got {unknown[0]}"
            )
        class_id = road[numbers]
        return cls.of(xyxy_px, score, np.maximum(class_id, 0)).select(class_id >= 0)

    @classmethod
    def from_supervision(cls, boxes: Any, class_names: Sequence[str] | None = None) -> Detections:
        """Detections from supervision's `Detections`, or any object with its attributes `xyxy,
        confidence, class_id`.

        Boxes of classes that are not road classes are left out; see
        `supervision.read_supervision`.
        """
        return cls.of(*read_supervision(boxes, class_names)[:3])

    def to_supervision(self) -> Any:
        """The boxes as supervision's `Detections` if it is installed, else as an object with the
        same attributes.
        """
        return supervision_boxes(self.xyxy_px, self.score, self.class_id)

    def select(self, index: Rows) -> Detections:
        """The detections that a mask (N,), an array or list of indices or a slice selects, in the
        order of the indices.

        Raises IndexError: the mask has another length, or an index does not exist.
        """
        rows = row_numbers(index, len(self.score))
        return Detections(
            self.xyxy_px.take(rows, axis=0),
            self.score.take(rows),
            self.class_id.take(rows),
            self.descriptor.take(rows, axis=0),
            self.is_complete,
        )


def _whole_numbers(name: str, values: npt.ArrayLike) -> IntArray:
    """(N,) numbers, if they are whole; networks give class numbers as floats."""
    numbers = np.asarray(values).reshape(-1)
    if numbers.dtype.kind not in "biuf":
        raise ValueError(
            f"{name}: expected whole numbers, got {numbers[0]!r}; see tr.class_id(NAME)"
        )
    whole = numbers.astype(np.int64)
    if len(wrong := numbers[whole != numbers]):
        raise ValueError(f"{name}: expected whole numbers, got {wrong[0]}")
    return whole
