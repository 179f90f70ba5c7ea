"""Tracks: the boxes of one frame with identities, as parallel arrays."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from track_range.foundation.arrays import BoolArray, FloatArray, IntArray, check_shape


@dataclass(frozen=True, slots=True)
class Tracks:
    """The confirmed road users of one frame; N = 0 means none.

    Attributes:
        track_id: (N,) int64, >= 1, unique within a frame, the same for one road user in all frames.
        xyxy_px: (N, 4) float64 box, in the frame's pixels.
        class_id: (N,) int64, index into `detection.classes.ROAD_CLASSES`.
        score: (N,) float64 in [0, 1].
        observed: (N,) bool, False where the box is predicted and no detection supports it in this frame.
    """

    track_id: IntArray
    xyxy_px: FloatArray
    class_id: IntArray
    score: FloatArray
    observed: BoolArray

    def __post_init__(self) -> None:
        n = len(self.track_id)
        check_shape("track_id", self.track_id, (n,))
        check_shape("xyxy_px", self.xyxy_px, (n, 4))
        check_shape("class_id", self.class_id, (n,))
        check_shape("score", self.score, (n,))
        check_shape("observed", self.observed, (n,))

    def __len__(self) -> int:
        return len(self.track_id)

    @classmethod
    def empty(cls) -> Tracks:
        """No tracks."""
        ids = np.zeros(0, np.int64)
        return cls(ids, np.zeros((0, 4)), ids, np.zeros(0), np.zeros(0, np.bool_))

    def select(self, keep: BoolArray | IntArray) -> Tracks:
        """The rows that a mask or an index array names, in its order."""
        return Tracks(
            self.track_id[keep], self.xyxy_px[keep], self.class_id[keep], self.score[keep], self.observed[keep]
        )
