"""Tracks: the boxes of one frame with identities, as parallel arrays."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field
from typing import Any

import numpy as np

from track_range.detection.classes import class_counts
from track_range.detection.supervision import read_supervision, supervision_boxes
from track_range.foundation.arrays import (
    BoolArray,
    FloatArray,
    IntArray,
    Rows,
    check_shape,
    row_numbers,
)


@dataclass(frozen=True, slots=True)
class Tracks:
    """The confirmed road users of one frame; N = 0 means none.

    Example:
        >>> import numpy as np, track_range as tr
        >>> box = np.array([[100.0, 50.0, 180.0, 110.0]])
        >>> tracks = tr.Tracks(np.array([7]), box, np.array([2]), np.array([0.9]), np.array([True]))
        >>> tracks, tracks.track_id.tolist()
        (Tracks(1 car), [7])

    Attributes:
        track_id: (N,) int64, >= 0, unique within a frame, the same for one road user in all frames.
        xyxy_px: (N, 4) float64 box, in the frame's pixels.
        class_id: (N,) int64, index into `ROAD_CLASSES`.
        score: (N,) float64 in [0, 1].
        observed: (N,) bool, False where the box is predicted, without a detection in this frame.
        other_class_id: (N,) int64, the class that the track may have instead; the same one if there
            is no doubt, as by default.
        other_probability: (N,) float64 probability of this class; 0 by default.
    """

    track_id: IntArray
    xyxy_px: FloatArray
    class_id: IntArray
    score: FloatArray
    observed: BoolArray
    other_class_id: IntArray = field(default_factory=lambda: np.zeros(0, np.int64))
    other_probability: FloatArray = field(default_factory=lambda: np.zeros(0))

    def __post_init__(self) -> None:
        n = len(self.track_id)
        if n and not len(self.other_probability):  # the default
            object.__setattr__(self, "other_class_id", self.class_id)
            object.__setattr__(self, "other_probability", np.zeros(n))
        check_shape("track_id", self.track_id, (n,))
        check_shape("xyxy_px", self.xyxy_px, (n, 4))
        check_shape("class_id", self.class_id, (n,))
        check_shape("score", self.score, (n,))
        check_shape("observed", self.observed, (n,))
        check_shape("other_class_id", self.other_class_id, (n,))
        check_shape("other_probability", self.other_probability, (n,))

    def __len__(self) -> int:
        return len(self.track_id)

    def __repr__(self) -> str:
        return f"Tracks({class_counts(self.class_id)})"

    @classmethod
    def empty(cls) -> Tracks:
        """No tracks."""
        ids = np.zeros(0, np.int64)
        return cls(ids, np.zeros((0, 4)), ids, np.zeros(0), np.zeros(0, np.bool_))

    @classmethod
    def from_supervision(cls, boxes: Any, class_names: Sequence[str] | None = None) -> Tracks:
        """Tracks from supervision's `Detections` with `tracker_id`, as returned by the trackers of
        other libraries.

        Boxes with a negative identity (not confirmed yet) are left out; other identities do not
        change. Raises ValueError: `tracker_id` is missing, or contains an identity twice.
        """
        xyxy_px, score, class_id, track_id = read_supervision(boxes, class_names)
        if track_id is None:
            raise ValueError("tracker_id: expected an identity for each box, got None")
        tracks = cls(track_id, xyxy_px, class_id, score, np.ones(len(track_id), np.bool_)).select(
            track_id >= 0
        )
        if len(np.unique(tracks.track_id)) < len(tracks):
            raise ValueError("tracker_id: expected each identity once in a frame, got duplicates")
        return tracks

    def to_supervision(self) -> Any:
        """`supervision.Detections` with `tracker_id`, or an equivalent object if supervision is not
        installed.
        """
        return supervision_boxes(self.xyxy_px, self.score, self.class_id, self.track_id)

    def select(self, rows: Rows) -> Tracks:
        """The rows that a mask (N,), an array or list of row numbers or a slice selects, in its
        order.

        Raises IndexError: the mask has another length, or a row does not exist.
        """
        rows = row_numbers(rows, len(self.track_id))
        return Tracks(*(getattr(self, name).take(rows, axis=0) for name in self.__slots__))
